"""`farfield experiment compare` on a small town, every row in a real browser: half a minute of processor, so with --accept."""

import argparse
import csv
import json
from pathlib import Path
from typing import Any

import pytest
from farfield.experiment import compare
from farfield.experiment.browser import find_browser, find_pages
from farfield.experiment.document import Job
from farfield.experiment.files import write
from farfield.scene.write import write_glb
from farfield.settings import from_mapping
from towns import town

SETTINGS = {
    "budget": "14 calls",
    "camera": {"width": 160, "height": 90},
    "visibility": {"mode": "off"},
    "view_space": {"cell_m": 12.0, "boxes": [[[-12.0, 1.0, -12.0], [12.0, 3.0, 12.0]]]},
    "placement": {"far_m": 20.0},
}
GIVEN = argparse.Namespace(frames=6, passes=1, pictures=2, boxes=None, gpu=False)


@pytest.fixture(scope="module")
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    if not request.config.getoption("--accept"):
        pytest.skip("nine browsers and six placements: make accept, or pytest with --accept")
    if find_browser() is None:
        pytest.skip("no chromium on this machine")
    if find_pages() is None:
        pytest.skip("the pages are not built: make setup")
    out = tmp_path_factory.mktemp("compare")
    (out / "town.glb").write_bytes(write_glb(town(40, view_m=24)))
    job = Job(
        scene=out / "town.glb", settings=from_mapping(SETTINGS), cache=out / "cache", workers=1,
        command="farfield experiment compare town.glb",
    )  # fmt: skip
    write(compare.build(job, GIVEN), out / "out")
    return out / "out"


@pytest.fixture(scope="module")
def rows(folder: Path) -> dict[str, dict[str, Any]]:
    document = json.loads((folder / "report.json").read_text())
    assert document["defects"] == []  # what a way counts itself is what reached WebGL
    (section,) = document["sections"]
    assert section["missing"] is None
    by_label = {row["way"]: row for row in section["rows"]}
    return {way.key: by_label[way.label] for way in compare.WAYS}


def test_every_row_is_drawn_for_the_same_frames(rows: dict[str, dict[str, Any]]) -> None:
    failed = {key: row["said"] for key, row in rows.items() if "frames" not in row}
    assert not failed
    assert {row["frames"] for row in rows.values()} == {GIVEN.frames}


def test_geometry_differs_from_itself_by_nothing(rows: dict[str, dict[str, Any]]) -> None:
    assert rows["geometry"]["worst_flip"] == 0
    assert rows["batched"]["worst_flip"] < 0.01  # the same triangles in another arithmetic
    assert 0 < rows["octahedral"]["worst_flip"] < 0.2  # pictures of 64 texels, but of the right things


def test_rows_do_what_they_are_named_after(rows: dict[str, dict[str, Any]]) -> None:
    over = {key: row["over"] for key, row in rows.items()}
    assert over["geometry"] > 0  # else nothing is shown by the rest
    assert over["farfield"] == 0
    assert rows["batched"]["worst_calls"] == 1
    assert rows["batched"]["worst_parts"] >= rows["geometry"]["worst_calls"]  # by spheres: never fewer
    assert rows["octahedral"]["worst_calls"] < rows["geometry"]["worst_calls"]
    assert rows["octahedral"]["resident_mb"] > rows["geometry"]["resident_mb"]
    assert "impostors" in rows["farfield"]["said"] and not rows["farfield"]["said"].startswith("0 ")
    assert rows["geometry"]["seconds"] == 0 < rows["farfield"]["seconds"]


def test_rows_that_beat_ours_are_told(folder: Path, rows: dict[str, dict[str, Any]]) -> None:
    (section,) = json.loads((folder / "report.json").read_text())["sections"]
    assert "geometry, frustum culling" in section["text"]  # needs no preprocessing and no files
    told = list(csv.DictReader((folder / "compare.csv").open(encoding="utf-8")))
    assert [row["way"] for row in told] == [way.label for way in compare.WAYS]


def test_every_way_draws_a_placement_of_the_same_camera_and_view_space() -> None:
    settings = from_mapping(SETTINGS)
    made = compare.variants(settings)
    assert {way.placed for way in compare.WAYS} == set(made)
    assert {(v.camera, v.view_space, v.quality) for v in made.values()} == {
        (settings.camera, settings.view_space, settings.quality)
    }
    assert made["paper"].placement.view_cells == "raw" and made["visibility"].visibility.mode != "off"
    assert compare.percentile([5.0, 1.0, 4.0, 2.0, 3.0], 0.5) == 3.0


def test_without_a_browser_the_page_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare, "find_browser", lambda: None)
    (tmp_path / "town.glb").write_bytes(b"no level")
    job = Job(scene=tmp_path / "town.glb", settings=from_mapping(SETTINGS), cache=tmp_path, workers=1, command="")
    (section,) = compare.build(job, GIVEN)["sections"]
    assert "Chromium" in section["missing"]
