"""Levels in the cost model, in scene.glb and in the decision whether they are worth it."""

import dataclasses
import json

import numpy as np
import pytest
from farfield.detail import worth
from farfield.detail.model import no_levels
from farfield.detail.worth import reason_to_skip, triangle_share
from farfield.errors import SettingsInvalid
from farfield.evaluation.level import read_boxes, read_levels
from farfield.geometry.cells import build_cells
from farfield.hierarchy.build import build_hierarchy
from farfield.placementdb.read import Placement
from farfield.placementdb.write import build_files
from farfield.rendertime.cost import build_cost_model, least_cost, object_cost, object_level, prices
from farfield.scene.read import read_scene
from farfield.scene.write import write_glb
from farfield.settings import DetailSettings, Settings
from farfield.viewspace.cost import view_objects
from farfield.viewspace.split import find_problem_views
from farfield.visibility.model import VisibleSets
from placements import made_up
from towns import town


def naive_level(model, o, box, cell):
    """Return the level of object o by the least distance over all pairs of points, axis by axis."""
    away = [max(0.0, box[0][k] - cell[1][k], cell[0][k] - box[1][k]) for k in range(3)]
    level = 0
    for k in range(model.level_row[o], model.level_row[o + 1]):
        if float(np.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2)) >= model.level_from[k]:
            level += 1
    return level


@pytest.mark.parametrize("budget", ["12000 triangles", "2 ms", "300 calls"])
def test_objects_cost_what_their_level_costs(curved, levels_at, budget):
    levels, settings = levels_at()
    settings = dataclasses.replace(settings, budget=budget)
    model = build_cost_model(curved, levels, settings=settings)
    plain = build_cost_model(curved, settings=settings)
    per_call, per_triangle = prices(settings)
    used = set()
    for cell in build_cells(curved.view_boxes, curved.cell_m).cell_box:
        level = object_level(model, curved.object_box, cell)
        pixels = object_cost(plain, curved.object_box, cell) - plain.object_fixed
        for o, cost in enumerate(object_cost(model, curved.object_box, cell).tolist()):
            assert level[o] == naive_level(model, o, curved.object_box[o], cell)
            m = curved.object_mesh[o]
            n = curved.object_triangles[o] if not level[o] else levels.triangles[levels.row[m] + level[o] - 1]
            assert cost == np.ceil(curved.object_calls[o] * per_call + n * per_triangle) + pixels[o]
            used.add(int(level[o]))
    assert len(used) > 2
    assert (least_cost(model) <= plain.object_fixed).all()


def test_nothing_costs_more_in_a_cell_than_in_the_node_that_holds_it(curved, levels_at):
    levels, settings = levels_at()
    model, cells = build_cost_model(curved, levels, settings=settings), build_cells(curved.view_boxes, curved.cell_m)
    for node in range(1, len(cells.axis)):
        inner = object_cost(model, curved.object_box, cells.box[node])
        assert (inner <= object_cost(model, curved.object_box, cells.box[cells.parent[node]])).all()


def test_without_levels_nothing_changes(curved, options):
    none, plain = (build_cost_model(curved, levels, settings=options) for levels in (no_levels(), None))
    for field in dataclasses.fields(none):
        np.testing.assert_array_equal(getattr(none, field.name), getattr(plain, field.name))
    assert write_glb(curved, no_levels().of_meshes()) == write_glb(curved)
    assert (object_level(none, curved.object_box, curved.view_boxes[0]) == 0).all()


def test_problem_views_are_those_of_the_levels_costs(curved, levels_at):
    levels, settings = levels_at()
    visible = VisibleSets(mode="off", row=np.zeros(0, np.int64), object=np.zeros(0, np.int32))
    views = [
        find_problem_views(curved, build_hierarchy(curved), model, visible, settings=settings, node=0)
        for model in (build_cost_model(curved, levels, settings=settings), build_cost_model(curved, settings=settings))
    ]
    model, cells = build_cost_model(curved, levels, settings=settings), build_cells(curved.view_boxes, curved.cell_m)
    assert 0 < len(views[0].cell) < len(views[1].cell)
    for v in range(0, len(views[0].cell), 7):
        objects, costs = view_objects(views[0], v)
        expected = object_cost(model, curved.object_box, cells.cell_box[views[0].cell[v]])
        np.testing.assert_array_equal(costs, expected[objects])
        assert views[0].cost[v] == costs.sum()


def test_scene_glb_holds_the_levels_and_reads_as_the_same_scene(curved, levels_at, options, tmp_path):
    levels, _ = levels_at()
    path = tmp_path / "scene.glb"
    path.write_bytes(write_glb(curved, levels.of_meshes()))
    again = read_scene(path, settings=options)
    for field in dataclasses.fields(curved):
        if field.name == "object_look":  # of the file that was submitted; the one we write is drawn, not judged
            continue
        np.testing.assert_array_equal(getattr(again, field.name), getattr(curved, field.name), err_msg=field.name)
    stated = read_levels(path)
    assert set(read_boxes(path)) == set(range(curved.n_objects))
    for o, m in enumerate(curved.object_mesh):
        assert stated.get(o, []) == levels.triangles[levels.row[m] : levels.row[m + 1]].tolist()
    text = path.read_bytes()
    document = json.loads(text[20 : 20 + int.from_bytes(text[12:16], "little")])
    for mesh in document["meshes"]:
        for level in mesh.get("extras", {}).get("levels", []):
            for of, part in zip(mesh["primitives"], document["meshes"][level]["primitives"], strict=True):
                assert part["attributes"] == of["attributes"] and part["indices"] != of["indices"]


def test_the_reader_chooses_as_the_cost_model_does(tmp_path):
    made = made_up(detail=True, wide=False)
    for name, content in build_files(**made).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(content)
    placement, found = Placement.open(tmp_path), []
    for cell, box in enumerate(made["cells"].cell_box):
        found.append(placement.levels_in(cell))
        np.testing.assert_array_equal(found[-1], object_level(made["model"], made["scene"].object_box, box))
    assert set(np.concatenate(found).tolist()) >= {0, 1, 2}


def share(scene, settings):
    per_call, per_triangle = prices(settings)
    return reason_to_skip(scene, settings=settings, per_call=per_call, per_triangle=per_triangle)


def test_levels_are_left_out_where_triangles_are_not_what_is_spent(curved, options, monkeypatch):
    auto = dataclasses.replace(options, detail=DetailSettings(mode="auto"))
    change = lambda **more: dataclasses.replace(auto, **more)  # noqa: E731
    assert share(curved, auto) is None
    assert "draw calls" in share(curved, change(budget="20 calls"))
    few = dataclasses.replace(curved, object_triangles=np.minimum(curved.object_triangles, 100))
    assert "triangles are 3 % of what the fullest views cost" in share(few, change(budget="5 ms"))
    assert share(curved, change(budget="5 ms")) is None
    assert triangle_share(curved, auto, per_call=1.0, per_triangle=0.0) == 0
    assert triangle_share(curved, auto, per_call=0.0, per_triangle=1.0) == 1
    assert "fewer than 24 triangles hold 100 %" in share(town(20), Settings(budget="100 triangles"))
    assert share(curved, change(detail=DetailSettings(mode="off"))).startswith("detail.mode is off")
    assert share(curved, change(budget="20 calls", detail=DetailSettings(mode="on"))) is None
    monkeypatch.setattr(worth, "library", lambda: None)
    assert "almeshopt" in share(curved, auto)
    with pytest.raises(SettingsInvalid, match="almeshopt"):
        share(curved, options)
