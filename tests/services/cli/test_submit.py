"""`farfield submit` refuses before it sends anything."""

import pytest
from farfield.cli.main import main


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "api-key").write_text("ff_secret\n")
    (tmp_path / "level.glb").write_bytes(b"glTF")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("FARFIELD_KEY", raising=False)


def test_the_key_of_this_machine_is_not_sent_to_another(folder, capsys):
    assert main(["submit", "level.glb", "--url", "http://farfield.invalid"]) == 2
    assert "--key-file" in capsys.readouterr().err
