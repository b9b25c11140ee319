"""`farfield place` from file to files: right verdicts, the same bytes however many workers, and what others rely on."""

import json
from pathlib import Path

import numpy as np
import pytest
from browser.levels import box_level
from farfield.placementdb.read import Placement

REPORT = {
    "verdict", "budget", "objects", "triangles", "cells", "problem_views", "hopeless_views", "candidates", "impostors",
    "bytes", "file_bytes", "video_bytes", "lower_bound_bytes", "bound", "stages", "seed", "settings",
}  # fmt: skip


@pytest.fixture(scope="module")
def row(tmp_path_factory):
    """A level of 24 boxes in a row along x, and settings: the view space lies before its near end."""
    folder = tmp_path_factory.mktemp("row")
    low = np.stack([np.arange(24) * 6.0, np.zeros(24), np.zeros(24)], 1)
    (folder / "row.glb").write_bytes(box_level(np.stack([low, low + np.array([4.0, 5.0, 4.0])], 1)))
    settings = (
        "[view_space]\ncell_m = 8.0\nboxes = [[[-24.0, 1.0, -4.0], [-8.0, 2.0, 4.0]]]\n"
        '[camera]\nfov_deg = 45.0\nwidth = 640\nheight = 360\n[visibility]\nmode = "off"\n'
    )
    (folder / "row.toml").write_text(settings)
    return folder / "row.glb", folder / "row.toml"


def test_the_cut_out_is_placed_within_its_budget(placed):
    folder, report = placed
    assert report["verdict"] == "valid"
    assert report.keys() >= REPORT
    assert 300 < report["objects"] < 600
    assert report["impostors"] > 10 and report["problem_views"] > 100 and report["bytes"] > 0
    assert report == json.loads((folder / "report.json").read_text())
    assert sorted(p.name for p in folder.iterdir()) == ["base.ffc", "placement", "report.json", "scene.glb"]
    assert all(stage.keys() >= {"name", "seconds", "peak_bytes", "skipped"} for stage in report["stages"])
    assert Placement.open(folder).check() > 3


def test_one_worker_gives_the_bytes_of_two(placed, level, run, files_of, tmp_path):
    folder, report = placed
    scene, settings = level
    ran = run("place", scene, "--settings", settings, "--workers", 1, "--json", "--out", tmp_path)
    assert ran.code == 0, ran.err
    expected, got = files_of(folder / "placement"), files_of(tmp_path / "placement")
    assert got.keys() == expected.keys()
    assert not [name for name in got if got[name] != expected[name]]
    assert (tmp_path / "scene.glb").read_bytes() == (folder / "scene.glb").read_bytes()
    measured = {"stages", "seconds", "peak_bytes", "verified"}
    assert {k: v for k, v in ran.document.items() if k not in measured} == {
        k: v for k, v in report.items() if k not in measured
    }


def test_verify_finds_no_view_over_budget(placed, run):
    folder, report = placed
    ran = run("verify", folder, "--views", 3000, "--seed", 5, "--json")
    assert ran.code == 0, ran.err
    found = ran.document
    assert (found["views"], found["over_budget"], found["over_bound"], found["outside_view_cell"]) == (3000, 0, 0, 0)
    assert 0 < found["worst_ratio"] <= 1
    assert found["in_problem_views"] > 100
    assert found["worst_view"]["cost"] <= report["budget_amount"]


def test_reports_and_inspections_speak_of_the_same_objects(placed, level, run):
    folder, report = placed
    scene, settings = level
    assert run("report", folder, "--json").document == report
    inspected = run("inspect", scene, "--settings", settings, "--json").document
    assert [o["id"] for o in inspected["objects"]] == list(range(report["objects"]))
    placement = Placement.open(folder)
    boxes = np.array([o["box"] for o in inspected["objects"]])
    np.testing.assert_allclose(placement.index["object_box"] + placement.origin_m, boxes, atol=1e-6)
    assert inspected["warnings"] == report["warnings"]


def test_within_budget_everywhere_ends_after_problem_views(row, run, tmp_path):
    scene, settings = row
    ran = run("place", scene, "--settings", settings, "--budget", "1000 calls", "--json", "--out", tmp_path)
    assert ran.code == 0, ran.err
    report = ran.document
    assert (report["verdict"], report["problem_views"], report["impostors"], report["bytes"]) == ("valid", 0, 0, 0)
    skipped = {stage["name"]: stage["skipped"] for stage in report["stages"]}
    assert skipped["viewspace"] is None
    assert "within the budget" in skipped["candidates"]
    assert skipped["bake"]
    found = run("verify", tmp_path, "--views", 200, "--json")
    assert found.code == 0, found.err
    assert found.document["over_budget"] == found.document["in_problem_views"] == 0
    placement = Placement.open(tmp_path)
    shown = placement.lookup([-9.0, 1.5, 0.0], [1.0, 0.0, 0.0])
    assert shown.problem_view is None and len(shown.impostors) == 0
    assert shown.objects.tolist() == list(range(24))


def test_hopeless_views_are_reported_and_the_exit_code_says_so(row, run, tmp_path):
    """No frame costs nothing here: every view that sees an object is hopeless, and verify has nothing to object."""
    scene, settings = row
    ran = run("place", scene, "--settings", settings, "--budget", "0 calls", "--json", "--out", tmp_path)
    assert ran.code == 4, ran.err
    report = ran.document
    assert report["verdict"] == "infeasible"
    assert report["hopeless_views"] == report["problem_views"] > 0
    assert report["smallest_budget"]["amount"] > 0
    assert report["culprits"] and report["hopeless"]
    found = run("verify", tmp_path, "--views", 300, "--json")
    assert found.code == 0, found.err
    assert found.document["over_budget"] == 0 and found.document["in_hopeless_views"] > 0


def test_placing_anew_leaves_nothing_of_the_old_result(row, run, files_of, tmp_path):
    scene, settings = row
    for budget in ("12 calls", "1000 calls"):
        ran = run("place", scene, "--settings", settings, "--budget", budget, "--json", "--out", tmp_path)
        assert ran.code == 0, ran.err
    placement = Placement.open(tmp_path)
    assert len(placement.impostors) == 0
    assert len(files_of(tmp_path / "placement")) == placement.check()


def corrupt_glb(folder: Path) -> Path:
    path = folder / "corrupt.glb"
    path.write_bytes(b"glTF" + bytes(40))
    return path


def empty_obj(folder: Path) -> Path:
    path = folder / "empty.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    return path


def far_index(folder: Path) -> Path:
    path = folder / "far.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    return path


def not_finite(folder: Path) -> Path:
    path = folder / "nan.obj"
    path.write_text("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n")
    return path


def missing(folder: Path) -> Path:
    return folder / "nothing.glb"


@pytest.mark.parametrize(
    ("make", "name"),
    [(corrupt_glb, "SceneUnreadable"), (empty_obj, "SceneEmpty"), (far_index, "SceneIndexOutOfRange"),
     (not_finite, "SceneNotFinite"), (missing, "SceneNotAFile")],
)  # fmt: skip
def test_a_level_that_cannot_be_used_is_refused_by_name(make, name, run, tmp_path):
    ran = run("place", make(tmp_path), "--json", "--out", tmp_path / "out")
    assert ran.code == 3
    assert ran.err.startswith(f"{name}: ")
    assert len(ran.err.splitlines()) >= 2, "the message and what to do"
    assert "Traceback" not in ran.err and ran.out == ""
    assert not (tmp_path / "out" / "placement").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [(["--budget", "16 parsecs"], "budget"), (["--workers", "0"], "--workers"), (["--settings", "none.toml"], "none.toml")],
)  # fmt: skip
def test_bad_settings_are_bad_use(words, says, row, run, tmp_path):
    ran = run("place", row[0], "--out", tmp_path / "out", *words)
    assert ran.code == 2
    assert says in ran.err and "Traceback" not in ran.err and ran.out == ""


def test_other_verbs_keep_to_the_exit_codes(placed, row, run, tmp_path):
    assert run("place", row[0]).code == 2, "no --out"
    assert run("turn").code == 2
    for verb in ("verify", "report"):
        ran = run(verb, tmp_path / "nothing", "--json")
        assert ran.code == 3 and "Traceback" not in ran.err and ran.out == "", verb
    ran = run("layers", "--cell", "box", "--t0", 10, "--depth", -1, "--w", 4, "--res", 64, "--json")
    assert ran.code == 3 and "Traceback" not in ran.err
    ran = run(
        "layers", "--cell", "box", "--t0", 40, "--depth", "inf", "--w", 4, "--res", 64, "--n", 5, "--m", 5, "--json"
    )
    assert ran.code == 0, ran.err
    assert ran.document["layers"][-1]["far"] == "inf"
    assert len(ran.document["layers"]) == ran.document["count"]
