"""GET /v1/placements/{id}/gltf: what the command line writes, for jobs and folders, in a process that loads no renderer."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
from farfield.client import Client, Refused
from farfield.columns import files_parts
from farfield.errors import ServiceError
from farfield.export.gltf import export_gltf
from farfield.export.select import select_all, select_cell
from farfield.placementdb.read import Placement
from farfield.store.artifacts import LocalArtifacts
from farfield_api.settings import EXPORT

GOLDEN = Path(__file__).parents[1] / "golden" / "placementdb"


@pytest.fixture
def real(service, worker, monkeypatch):
    """A job whose placement is the golden one, exported by the real command; its id."""
    job = service.create()
    worker()
    files = {f"placement/{p.relative_to(GOLDEN).as_posix()}": p.read_bytes() for p in GOLDEN.rglob("*") if p.is_file()}
    digest = LocalArtifacts(service.settings.artifacts).put(
        b"".join(files_parts({"scene.glb": b"glTF", "base.ffc": b"", **files}))
    )
    from farfield_api.routes import placements

    known = placements.jobs.artifact_of
    monkeypatch.setattr(
        placements.jobs, "artifact_of", lambda engine, id, stage: digest if id == job else known(engine, id, stage)
    )
    state = service.client.app.state
    state.farfield = replace(state.farfield, settings=replace(service.settings, export_command=EXPORT))
    return job


def test_a_job_exports_what_the_command_line_writes_and_leaves_no_file(service, real, tmp_path):
    placement = Placement.open(GOLDEN)
    before = sorted(service.settings.artifacts.rglob("*"))
    cell = next(iter(select_all(placement).cells))
    for query, selection, images in (
        ("", select_all(placement), "png"), (f"?cell={cell}&images=webp", select_cell(placement, cell), "webp"),
    ):  # fmt: skip
        path = f"/v1/placements/{real}/gltf{query}"
        answer = service.client.get(path)
        assert answer.status_code == 200, answer.text
        export_gltf(placement, selection, tmp_path / "own.glb", images=images)
        assert answer.content == (tmp_path / "own.glb").read_bytes()
        assert answer.headers["content-type"] == "model/gltf-binary"
        assert int(answer.headers["content-length"]) == len(answer.content)
    assert sorted(service.settings.artifacts.rglob("*")) == before
    for query, code in (("?cell=999", "SettingsInvalid"), ("?position=1e9,0,0&direction=1,0,0", "OutsideViewSpace"),
                        ("?position=0,0,0", "SettingsInvalid")):  # fmt: skip
        refused = service.client.get(f"/v1/placements/{real}/gltf{query}")
        assert (refused.status_code, refused.json()["code"]) == (422, code), refused.text
        assert str(service.settings.artifacts) not in refused.text
    assert sorted(service.settings.artifacts.rglob("*")) == before


def test_an_export_is_made_once_for_whoever_has_it(service, monkeypatch):
    first = service.client.get("/v1/placements/town/gltf")
    assert first.content == b'glTF{"version": 1}'
    same = {"if-none-match": first.headers["etag"]}
    from farfield_api.routes import placements

    monkeypatch.setattr(placements, "export", None)  # whoever asks for it now fails
    kept = service.client.get("/v1/placements/town/gltf", headers=same)
    assert (kept.status_code, kept.content) == (304, b"")
    monkeypatch.undo()
    assert service.client.get("/v1/placements/town/gltf?images=webp", headers=same).status_code == 200
    (service.settings.placements["town"] / "placement" / "manifest.json").write_text('{"version": 22}')
    assert service.client.get("/v1/placements/town/gltf", headers=same).content == b'glTF{"version": 22}'


def test_the_client_writes_the_export_or_nothing(service, tmp_path):
    """The toy's answer, and one that ends early, through the client's own connection."""
    client = Client("http://127.0.0.1", service.key, http=service.client)
    out = tmp_path / "town.glb"
    assert client.export_gltf("town", out, cell=3) == out.stat().st_size
    assert out.read_bytes() == b'glTF{"version": 1}'
    with pytest.raises(Refused) as refused:
        client.export_gltf("town", out, cell=99)
    assert refused.value.code == "SettingsInvalid"

    def cut(request):
        def some():
            yield b"glTF"
            raise httpx.RemoteProtocolError("the line ended")

        return httpx.Response(200, content=some())

    broken = Client(
        "http://127.0.0.1", "key", http=httpx.Client(transport=httpx.MockTransport(cut), base_url="http://127.0.0.1")
    )
    with pytest.raises(ServiceError):
        broken.export_gltf("town", out)
    assert out.read_bytes() == b'glTF{"version": 1}'
    assert list(tmp_path.glob("*.part")) == []


def test_who_waits_or_asks_wrongly_is_told(service):
    job = service.create()
    assert service.client.get(f"/v1/placements/{job}/gltf").json()["code"] == "JobNotFinished"
    assert service.client.get("/v1/placements/nobody/gltf").json()["code"] == "PlacementNotFound"
    for query in (
        "cell=-1",
        "cell=x",
        "images=gif",
        "position=1,2",
        "position=1,2,nan",
        "cell=1&position=1,2,3",
        "direction=--out,0,0",
    ):
        assert service.client.get(f"/v1/placements/town/gltf?{query}").status_code == 422, query
    refused = service.client.get("/v1/placements/town/gltf?cell=99")
    assert refused.json()["code"] == "SettingsInvalid"
    assert "/" not in refused.json()["detail"]


def test_the_export_loads_neither_numba_nor_a_renderer(tmp_path):
    """As in the API's image, where they are not installed."""
    code = f"""
import sys
for name in ("numba", "moderngl", "scipy", "OpenGL"):
    sys.modules[name] = None  # an import of it fails
from farfield.cli.main import main
sys.exit(main({["export", "gltf", "--json", "--out", str(tmp_path / "x.glb"), str(GOLDEN)]!r}))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=os.environ, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["bytes"] == (tmp_path / "x.glb").stat().st_size
