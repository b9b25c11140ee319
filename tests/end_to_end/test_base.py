"""`farfield place --from DIR`: what still holds is kept as it is, file by file, and the result is proved like any other."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest

from .test_cache import FIRST, SETTINGS, level

PROOF_OFF = '[proof]\nmode = "off"\n'


@pytest.fixture(scope="module")
def first(run, tmp_path_factory) -> Path:
    """A folder with a level of 24 boxes in a row, the same with one moved, settings, and the placement of the former."""
    folder = tmp_path_factory.mktemp("base")
    (folder / "row.glb").write_bytes(level())
    (folder / "moved.glb").write_bytes(level(0.5))
    (folder / "row.toml").write_text(SETTINGS.format(**FIRST) + PROOF_OFF)
    ran = run(
        "place",
        folder / "row.glb",
        "--settings",
        folder / "row.toml",
        "--workers",
        1,
        "--json",
        "--out",
        folder / "out",
    )
    assert ran.code in (0, 4), ran.err
    assert ran.document["base"] is None
    return folder


def on_base(run, first: Path, scene: str, out: Path, *more):
    words = (first / scene, "--settings", first / "row.toml", "--from", first / "out", "--json", "--out", out)
    return run("place", *words, *(more or ("--workers", 1)))


def pages(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "placement" / "pages").iterdir()}


def test_one_box_moved_is_placed_on_what_still_holds(first, run, files_of, tmp_path):
    ran = on_base(run, first, "moved.glb", tmp_path / "out")
    assert ran.code in (0, 4), ran.err
    base = json.loads((first / "out" / "placement" / "manifest.json").read_text())
    told = ran.document["base"]
    assert told["manifest_sha256"] == base["manifest_sha256"] == ran.document["settings"]["placement"]["base"]
    assert told["impostors_kept"] > 0 and told["impostors_built"] > 0
    assert ran.document["verified"]["verdict"] == "valid" and ran.document["lower_bound_bytes"] is None
    assert {s["name"]: s["skipped"] for s in ran.document["stages"]}["bound"].startswith("there are no candidates")
    shown = run("report", tmp_path / "out").out
    assert f"placed on {base['manifest_sha256'][:16]}: {told['impostors_kept']} of its impostors stand" in shown
    kept, now = pages(first / "out"), pages(tmp_path / "out")
    assert kept.items() & now.items() and now.keys() - kept.keys()
    verified = run("verify", tmp_path / "out", "--views", 2000, "--json")
    assert verified.document["over_budget"] == verified.document["over_bound"] == 0
    assert verified.document["outside_view_cell"] == 0
    other = on_base(run, first, "moved.glb", tmp_path / "two", "--workers", 2)
    assert other.code in (0, 4), other.err
    assert files_of(tmp_path / "two" / "placement") == files_of(tmp_path / "out" / "placement")


def test_an_unchanged_level_bakes_nothing_and_can_replace_its_own_base(first, run, tmp_path):
    shutil.copytree(first / "out", tmp_path / "out")
    words = (first / "row.glb", "--settings", first / "row.toml", "--workers", 1, "--json")
    ran = run("place", *words, "--from", tmp_path / "out", "--out", tmp_path / "out")
    assert ran.code in (0, 4), ran.err
    assert ran.document["base"]["impostors_built"] == 0
    assert {s["name"]: s["skipped"] for s in ran.document["stages"]}["bake"] == "the base has baked every impostor"
    assert pages(tmp_path / "out") == pages(first / "out")


def test_a_base_that_does_not_fit_is_refused(first, run, tmp_path):
    def refused(*words) -> str:
        ran = run("place", first / "moved.glb", "--workers", 1, "--out", tmp_path / "out", *words)
        assert ran.code in (2, 3), (ran.code, ran.err)
        return " ".join(ran.err.split())

    settings = tmp_path / "other.toml"
    settings.write_text(SETTINGS.format(**FIRST | {"pixel_error": 2.0}) + PROOF_OFF)
    assert "quality.pixel_error = 1.0, not 2.0" in refused("--settings", settings, "--from", first / "out")
    settings.write_text(SETTINGS.format(**FIRST | {"budget": "16 ms"}) + PROOF_OFF)
    assert "the unit of budget" in refused("--settings", settings, "--from", first / "out")
    settings.write_text(SETTINGS.format(**FIRST) + f'base = "{hashlib.sha256(b"").hexdigest()}"\n' + PROOF_OFF)
    assert "placement.base" in refused("--settings", settings)

    damaged = tmp_path / "damaged"
    shutil.copytree(first / "out", damaged)
    (damaged / "base.ffc").unlink()
    assert "base.ffc is missing" in refused("--settings", first / "row.toml", "--from", damaged)
    other = run(
        "place", first / "moved.glb", "--settings", first / "row.toml", "--workers", 1, "--out", tmp_path / "moved"
    )
    assert other.code in (0, 4), other.err
    shutil.copy(tmp_path / "moved" / "base.ffc", damaged / "base.ffc")
    assert "base.ffc is altered or damaged" in refused("--settings", first / "row.toml", "--from", damaged)
    assert not (tmp_path / "out" / "report.json").exists()
