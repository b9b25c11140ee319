"""`farfield keys`: a way in for who is at the machine, and nothing secret but once."""

import json
from pathlib import Path

import pytest
from farfield.cli.main import main
from farfield.store import audit, tenants
from farfield.store.engine import open_engine
from farfield_workers.serve import migrate


@pytest.fixture
def data(tmp_path, monkeypatch):
    monkeypatch.delenv("FARFIELD_DATABASE_URL", raising=False)
    engine = open_engine(f"sqlite:///{tmp_path / 'farfield.sqlite'}")
    migrate(engine, Path(__file__).parents[3] / "migrations")
    yield tmp_path, engine
    engine.dispose()


def run(data, capsys, *words):
    assert main(["keys", *words, "--data", str(data[0]), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_keys_are_made_listed_rotated_and_revoked(data, capsys):
    made = run(
        data, capsys, "create", "--name", "ci", "--tenant", "harbour", "--scopes", "submit, read", "--expires", "90d"
    )
    caller = tenants.caller_of_key(data[1], made["key"])
    assert (caller.scopes, caller.operator) == ({"read", "submit"}, False)
    (listed,) = run(data, capsys, "list", "--tenant", "harbour")["keys"]
    assert (listed["name"], listed["state"], listed["tenant"]) == ("ci", "valid", "harbour")
    assert made["key"].split("_")[2] not in json.dumps(listed)
    fresh = run(data, capsys, "rotate", made["id"])
    assert tenants.caller_of_key(data[1], made["key"]) is None
    assert tenants.caller_of_key(data[1], fresh["key"]).scopes == caller.scopes
    run(data, capsys, "revoke", fresh["id"])
    assert {key["state"] for key in run(data, capsys, "list")["keys"]} == {"expired", "revoked"}
    entries = audit.page(data[1], "*", before=None, limit=9)
    assert [e.action for e in entries] == [f"farfield keys {a}" for a in ("revoke", "rotate", "create")]


def test_the_operators_key_is_the_default(data, capsys):
    made = run(data, capsys, "create", "--name", "us", "--scopes", "admin")
    assert tenants.caller_of_key(data[1], made["key"]).operator


@pytest.mark.parametrize("words", [("--scopes", "root"), ("--scopes", ","), ("--expires", "soon")])
def test_nonsense_is_refused(data, capsys, words):
    assert main(["keys", "create", "--name", "n", *words, "--data", str(data[0])]) == 2
    assert "SettingsInvalid" in capsys.readouterr().err


def test_a_bucket_without_an_address_is_refused_before_anything_is_migrated(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("FARFIELD_DATABASE_URL", f"sqlite:///{tmp_path / 'farfield.sqlite'}")
    monkeypatch.delenv("FARFIELD_ARTIFACTS", raising=False)
    assert main(["migrate", "--make-bucket"]) == 3
    assert "FARFIELD_ARTIFACTS" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_key_is_refused_by_name(data, capsys):
    assert main(["keys", "revoke", "0" * 32, "--data", str(data[0])]) == 3
    assert "KeyNotFound" in capsys.readouterr().err
