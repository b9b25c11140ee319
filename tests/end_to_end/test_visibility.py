"""Visible sets through the whole job: the same bytes for one worker and two, and no view over what they promise."""

import tomllib

import numpy as np
import pytest
from farfield.executor import Executor
from farfield.placementdb.read import Placement
from farfield.settings import from_mapping
from farfield.stability.level import street
from farfield.stability.run import run as stages
from farfield.stages import Stage

SETTINGS = """budget = "24 calls"
[camera]
width = 320
height = 180
[view_space]
cell_m = 2.0
boxes = [[[-24.0, 1.0, -4.0], [-8.0, 2.0, 4.0]]]
interval_deg = 22.5
[visibility]
mode = "sampled"
missed_ppm = 3000.0
rays = 5000
"""


@pytest.fixture(scope="module")
def placed(run, tmp_path_factory):
    """The folder of a job run by two workers, and its report."""
    folder = tmp_path_factory.mktemp("seen")
    level = street(70, far=60.0)
    level.box[0] = [[-100.0, -1.0, -100.0], [100.0, 0.0, 100.0]]
    scene = level.write(folder / "houses.glb")
    (folder / "seen.toml").write_text(SETTINGS)
    ran = run("place", scene, "--settings", folder / "seen.toml", "--workers", 2, "--json", "--out", folder / "out")
    assert ran.code == 0, ran.err
    return folder, ran.document


def test_two_workers_and_one_process_find_the_same_bytes(placed):
    folder, _ = placed
    settings = from_mapping(tomllib.loads(SETTINGS))
    alone = stages(folder / "houses.glb", settings, until=Stage.VISIBILITY, order=lambda shards: shards[::-1])
    with Executor(folder / "houses.glb", settings, folder, workers=2, progress=lambda *of: None) as executor:
        for stage in Stage:
            shards = executor.run(stage).shards
            if stage == Stage.VISIBILITY:
                break
        assert shards > 1
        assert bytes(executor.artifact(Stage.VISIBILITY)) == alone.artifacts[Stage.VISIBILITY]
    visible, placement = alone.get(Stage.VISIBILITY), Placement.open(folder / "out")
    for k, entry in enumerate(placement.manifest["chunks"]):
        chunk = placement.chunk(k)
        for cell in range(*entry["cells"]):
            a, b = chunk["visible_row"][chunk["cell_visible"][cell - entry["cells"][0]] :][:2]
            held = visible.object[visible.row[cell] : visible.row[cell + 1]]
            np.testing.assert_array_equal(chunk["visible_object"][a:b], held)


def test_the_report_and_the_files_say_what_was_done(placed):
    folder, report = placed
    seen = report["visibility"]
    assert seen["mode"] == "sampled" and seen["rule"] == "sky" and seen["rays"] > 0
    assert 0 < seen["missed_ppm_upper"] < 5000 and seen["views"] > 100 and seen["p99_ppm"] <= seen["worst_ppm"]
    assert 1 < seen["mean_objects"] < 70, "houses hide houses"
    placement = Placement.open(folder / "out")
    assert placement.manifest["visibility"] == "sampled"
    sizes = []
    for cell, node in enumerate(placement.index["cell_node"]):
        middle = placement.index["node_box"][node].mean(0) + placement.origin_m
        v = placement.lookup(middle, [1.0, 0.0, 0.0])
        assert v.cell == cell
        replaced = sum(len(placement.impostors[int(i)].objects) for i in v.impostors)
        sizes.append(len(v.objects) + replaced)
    assert np.mean(sizes) < 70
    assert report["verified"]["over_bound"] == report["verified"]["over_budget"] == 0


def test_auto_says_why_it_skips_and_asks_again_for_another_level(tmp_path):
    """In the open everything is seen; from behind a wall hardly anything is."""
    wish = {
        "view_space": {"cell_m": 8.0, "boxes": [[[-24.0, 1.0, -4.0], [-8.0, 2.0, 4.0]]]},
        "visibility": {"rays": 1000},
    }
    level = street(12, far=160.0)
    found = stages(level.write(tmp_path / "open.glb"), from_mapping(wish), until=Stage.VISIBILITY)
    visible = found.get(Stage.VISIBILITY)
    walled = street(70, far=160.0)
    walled.box[0] = [[-2.0, 0.0, -60.0], [0.0, 50.0, 60.0]]
    hidden = stages(walled.write(tmp_path / "wall.glb"), from_mapping(wish), until=Stage.VISIBILITY).get(
        Stage.VISIBILITY
    )
    assert visible.mode == "off" and visible.row.size == 0
    assert hidden.mode == "sampled" and hidden.seen_share < 0.7
    assert len(hidden.object) < 10 * (len(hidden.row) - 1)
