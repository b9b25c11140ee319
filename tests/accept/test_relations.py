"""The relations of tests/end_to_end/test_relations.py on real levels, and with what their cells can see."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cutout import ROOT, city_cutout
from farfield.scene.read import read_scene
from farfield.scene.write import write_glb
from farfield.settings import from_mapping, to_mapping
from farfield.stability.level import street
from farfield.stability.relations import differences, served
from farfield.stability.run import run
from farfield.stages import Stage
from relations import edited, shuffled_nodes

SCENES = Path(os.environ.get("FARFIELD_SCENES", ROOT.parent / "shared" / "scenes"))
STAGES = (Stage.RENDERTIME, Stage.HIERARCHY, Stage.VISIBILITY, Stage.VIEWSPACE, Stage.CANDIDATES, Stage.PLACEMENT)


def level_of(name, folder):
    """Return a flat GLB of the level, whose splits are done, and settings that take a minute."""
    if name == "city":
        path, _ = city_cutout()
        box = [[[-40.0, 25.0, -40.0], [40.0, 40.0, 40.0]]]
        wish = {"budget": "150 calls", "view_space": {"cell_m": 32.0, "boxes": box}}
    else:
        path = SCENES / "kenney-city" / "scene.glb"
        wish = {"budget": "40 calls", "view_space": {"cell_m": 1.0, "boxes": [[[-7.0, 0.15, -1.0], [-3.0, 0.2, 1.0]]]}}
    if not path.exists():
        pytest.skip(f"{path} is not there (FARFIELD_SCENES)")
    settings = from_mapping({**wish, "camera": {"width": 640, "height": 360}, "visibility": {"mode": "off"}})
    (folder / "flat.glb").write_bytes(write_glb(read_scene(path, settings=settings)))
    return folder / "flat.glb", settings


@pytest.fixture(scope="module", params=["city", "toy"])
def placed(request, tmp_path_factory):
    path, settings = level_of(request.param, tmp_path_factory.mktemp("real"))
    found = run(path, settings)
    assert len(found.get(Stage.PLACEMENT).cluster) > 5
    return path, settings, found


def test_scaling_by_a_power_of_two(placed):
    path, settings, plain = placed
    values = to_mapping(settings)
    values["scene"]["unit_m"] = 0.125
    values["view_space"]["cell_m"] *= 0.125
    values["view_space"]["boxes"] = (np.array(values["view_space"]["boxes"]) * 0.125).tolist()
    scaled = run(path, from_mapping(values))
    for stage in STAGES:
        assert differences(plain.get(stage), scaled.get(stage), length_factor=0.125) == []


def test_permuting_the_objects(placed, tmp_path):
    path, settings, plain = placed
    (tmp_path / "shuffled.glb").write_bytes(edited(path.read_bytes(), shuffled_nodes))
    shuffled = run(tmp_path / "shuffled.glb", settings)
    assert [s for s in plain.artifacts if plain.artifacts[s] != shuffled.artifacts[s]] == []


def test_moving_the_level_by_more_than_ten_million(placed, tmp_path):
    """By 2**24 m. Node translations are rounded to 2**-29 m there, which decides nothing on levels without ties."""
    path, settings, plain = placed

    def move(document):
        document["nodes"].append({"children": document["scenes"][0]["nodes"], "translation": [2.0**24, 0, -(2.0**24)]})
        document["scenes"][0]["nodes"] = [len(document["nodes"]) - 1]

    (tmp_path / "moved.glb").write_bytes(edited(path.read_bytes(), move))
    values = to_mapping(settings)
    boxes = np.array(values["view_space"]["boxes"]) + np.array([2.0**24, 0, -(2.0**24)])
    values["view_space"]["boxes"] = boxes.tolist()
    moved = run(tmp_path / "moved.glb", from_mapping(values))
    one, other = plain.get(Stage.VIEWSPACE), moved.get(Stage.VIEWSPACE)
    for column in ("cell", "interval", "cost"):
        np.testing.assert_array_equal(getattr(one, column), getattr(other, column))
    assert served(plain) == served(moved)


def test_a_larger_budget_has_no_more_problem_views_and_no_more_hopeless_ones(placed):
    path, settings, plain = placed
    amount = int(settings.budget.split()[0])
    larger = run(path, replace(settings, budget=f"{amount * 5 // 4} calls"))
    views = [set(zip(v.cell.tolist(), v.interval.tolist())) for v in (r.get(Stage.VIEWSPACE) for r in (plain, larger))]
    assert views[1] <= views[0]
    assert larger.get(Stage.PLACEMENT).hopeless.sum() <= plain.get(Stage.PLACEMENT).hopeless.sum()


@pytest.mark.parametrize("mode", ["sampled", "conservative"])
def test_what_cells_can_see_keeps_the_relations(tmp_path, mode):
    level = street(120, seed=2)
    wish = {"budget": "34 calls", "visibility__mode": mode, "visibility__rays": 20_000}
    plain = run(level.write(tmp_path / "a.glb"), level.settings(**wish))
    hidden = np.diff(plain.get(Stage.VISIBILITY).row)
    assert (hidden < 120).all() and (hidden > 10).all()
    shuffled = run(replace(level, order=range(119, -1, -1)).write(tmp_path / "b.glb"), level.settings(**wish))
    assert shuffled.artifacts == plain.artifacts
    scaled = run(tmp_path / "a.glb", replace(level, unit_m=2.0**5).settings(**wish))
    for stage in STAGES:
        assert differences(plain.get(stage), scaled.get(stage), length_factor=2.0**5) == []
