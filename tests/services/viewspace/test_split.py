"""Problem views: none is missed, none costs more than its bound, shards and scale change nothing."""

import dataclasses

import numpy as np
import pytest
from farfield.geometry.camera import Camera, camera_frame
from farfield.geometry.cells import build_cells, find_cell
from farfield.geometry.frusta import boxes_in_frustum, view_frustum_normals
from farfield.geometry.intervals import find_interval
from farfield.hierarchy.build import build_hierarchy
from farfield.rendertime.cost import build_cost_model, object_cost
from farfield.settings import CameraSettings, Settings, ViewSpaceSettings
from farfield.viewspace.cost import cluster_cost, cluster_costs, view_objects
from farfield.viewspace.split import find_problem_views, merge_problem_views, plan_subtrees, summary
from farfield.visibility.model import VisibleSets
from naive import rendertime as naive_pixels
from naive import viewspace as naive
from towns import town

OFF = VisibleSets(mode="off", row=np.zeros(0, np.int64), object=np.zeros(0, np.int32))
NARROW = CameraSettings(fov_deg=45.0, width=720, height=720)


def settings_for(budget, *, camera=NARROW, interval_deg=11.25):
    return Settings(budget=budget, camera=camera, view_space=ViewSpaceSettings(interval_deg=interval_deg))


def found(scene, settings, *, visible=OFF, nodes=None):
    model = build_cost_model(scene, settings=settings)
    hierarchy = build_hierarchy(scene)
    nodes = plan_subtrees(build_cells(scene.view_boxes, scene.cell_m)) if nodes is None else nodes
    parts = [find_problem_views(scene, hierarchy, model, visible, settings=settings, node=k) for k in nodes]
    return model, merge_problem_views(parts[::-1])


def same(a, b, names):
    for name in names:
        x, y = getattr(a, name), getattr(b, name)
        assert np.asarray(x).dtype == np.asarray(y).dtype
        np.testing.assert_array_equal(x, y, err_msg=name)


VIEWS = ("cell", "interval", "cost", "row", "run", "before", "list", "list_row", "list_object", "list_through")


@pytest.mark.parametrize("interval_deg", [90.0, 45.0, 22.5])
@pytest.mark.parametrize("budget", ["9 calls", "1.11 ms"])
def test_agrees_with_plain_loops(interval_deg, budget):
    scene = town(50, seed=3, view_m=20)
    settings = settings_for(budget, interval_deg=interval_deg)
    cells = build_cells(scene.view_boxes, scene.cell_m)
    rng = np.random.default_rng(0)
    for mode in ("off", "given"):
        visible, sets = OFF, [set(range(50))] * cells.n_cells
        if mode == "given":
            sets = [set(np.flatnonzero(rng.random(50) < 0.8).tolist()) for _ in range(cells.n_cells)]
            row = np.cumsum([0, *map(len, sets)]).astype(np.int64)
            visible = VisibleSets(
                mode="given", row=row, object=np.concatenate([sorted(s) for s in sets]).astype(np.int32)
            )
        model, views = found(scene, settings, visible=visible)
        camera = Camera(fov_deg=model.fov_deg, width=model.width, height=model.height)
        expected = []
        for cell in range(cells.n_cells):
            box = cells.cell_box[cell]
            cost = object_cost(model, scene.object_box, box)
            of_cell = naive.problem_views(
                scene.object_box, cost, box, visible=sets[cell], n=round(90 / interval_deg), camera=camera,
                target=model.target,
            )  # fmt: skip
            expected += [(cell, interval, *of_cell[interval]) for interval in sorted(of_cell)]
        assert expected
        assert [(int(c), int(i)) for c, i in zip(views.cell, views.interval)] == [e[:2] for e in expected]
        assert views.cost.tolist() == [e[2] for e in expected]
        for v, (cell, _, _, objects) in enumerate(expected):
            shown, costs = view_objects(views, v)
            assert shown.tolist() == objects
            np.testing.assert_array_equal(costs, object_cost(model, scene.object_box, cells.cell_box[cell])[objects])
            runs = views.run[views.row[v] : views.row[v + 1]]
            assert (runs[:, 0] < runs[:, 1]).all() and (runs[1:, 0] > runs[:-1, 1]).all()


@pytest.mark.parametrize(
    ("camera", "budget", "view_m"),
    [
        (NARROW, "60 calls", 64),
        (CameraSettings(fov_deg=45.0, width=1280, height=720), "1.9 ms", 64),
        (CameraSettings(fov_deg=110.0, width=1600, height=900), "120 calls", 64),
        (CameraSettings(fov_deg=5.0, width=640, height=640), "1.1 ms", 200),
    ],
)
def test_no_view_costs_more_than_its_bound(camera, budget, view_m):
    """Random cameras in the view space; among the houses (view_m 200) cells touch objects and stand inside them."""
    scene = town(400, view_m=view_m)
    settings = settings_for(budget, camera=camera)
    model, views = found(scene, settings)
    assert len(views.cell)
    cells, n = build_cells(scene.view_boxes, scene.cell_m), 8
    cam = Camera(fov_deg=camera.fov_deg, width=camera.width, height=camera.height)
    at = {key: v for v, key in enumerate(zip(views.cell.tolist(), views.interval.tolist()))}
    rng = np.random.default_rng(1)
    problems = 0
    for k in range(1200):
        eye = rng.uniform(*scene.view_boxes[0])
        direction = rng.normal(size=3) * ([1, 0.3, 1] if k % 2 else [0.2, 1, 0.2])
        if k % 50 == 0:
            direction = np.array([0.0, rng.choice([-1, 1]), 0.0])
        cell, interval = find_cell(cells, scene.view_boxes, eye), find_interval(direction, n)
        normals = view_frustum_normals(direction, cam)
        shown = np.flatnonzero(boxes_in_frustum(normals, 0.0, scene.object_box, np.stack([eye, eye])))
        frame = camera_frame(direction)
        cost = int(model.object_fixed[shown].sum())
        if model.per_pixel > 0 and k % 4 == 0:  # else only the fixed part: clipping is slow
            pixels = [naive_pixels.box_pixels(scene.object_box[o], eye, frame, cam) for o in shown]
            cost += sum(int(np.ceil(model.per_pixel * min(p, cam.width * cam.height))) for p in pixels)
        assert cost <= views.cell_cost[cell]
        v = at.get((cell, interval))
        if v is None:
            assert cost <= views.worst_nonproblem <= model.target, f"{eye=} {direction=}"
        else:
            problems += 1
            assert cost <= views.cost[v]
            assert np.isin(shown, view_objects(views, v)[0]).all()
    assert problems > 20


def test_scaling_by_a_power_of_two_changes_no_bit():
    for budget in ("40 calls", "1.5 ms"):
        scene = town(150, view_m=40)
        _, views = found(scene, settings_for(budget))
        for factor in (2.0**-11, 2.0**9):
            scaled = dataclasses.replace(
                scene, object_box=scene.object_box * factor, view_boxes=scene.view_boxes * factor,
                cell_m=scene.cell_m * factor,
            )  # fmt: skip
            _, again = found(scaled, settings_for(budget))
            assert len(views.cell)
            same(views, again, (*VIEWS, "cell_cost", "worst_nonproblem"))


def test_any_cut_into_shards_gives_the_same_views():
    scene = town(200, view_m=100)
    settings = settings_for("40 calls")
    cells = build_cells(scene.view_boxes, scene.cell_m)
    _, whole = found(scene, settings, nodes=[0])
    assert len(plan_subtrees(cells)) > 1
    for nodes in (plan_subtrees(cells), cells.leaf.tolist()):
        _, views = found(scene, settings, nodes=nodes)
        same(whole, views, VIEWS)
    assert summary(whole)["problem_views"] == len(whole.cell) > 0


def test_subtrees_hold_every_cell_once():
    for size, cell in ((10.0, 16.0), (300.0, 16.0), (900.0, 8.0)):
        cells = build_cells(np.array([[[0.0, 0, 0], [size, 2, size]]]), cell)
        nodes = plan_subtrees(cells)
        held = np.concatenate([np.arange(cells.start[k], cells.stop[k]) for k in nodes])
        np.testing.assert_array_equal(held, np.arange(cells.n_cells))
        assert max(cells.stop[k] - cells.start[k] for k in nodes) <= 64


def test_a_scene_within_budget_has_no_problem_views():
    scene = town(50)
    model, views = found(scene, settings_for("50 calls"))
    assert len(views.cell) == len(views.run) == len(views.list_object) == 0
    assert views.row.tolist() == [0]
    assert views.worst_nonproblem == 50
    assert (views.cell_cost == 50).all()
    assert model.target == 50


def test_cluster_costs_are_sums():
    scene = town(120, view_m=40)
    model, views = found(scene, settings_for("1.4 ms"))
    cells = build_cells(scene.view_boxes, scene.cell_m)
    rng = np.random.default_rng(8)
    v = rng.integers(0, len(views.cell), 200)
    a, b = np.sort(rng.integers(0, 121, (2, 200)), axis=0)
    expected = [
        naive.cluster_cost(views, object_cost(model, scene.object_box, cells.cell_box[views.cell[k]]), k, i, j)
        for k, i, j in zip(v, a, b)
    ]
    assert cluster_costs(views, v, a, b).tolist() == expected
    assert [cluster_cost(views, int(k), int(i), int(j)) for k, i, j in zip(v, a, b)] == expected
    assert cluster_costs(views, v, 0, 120).tolist() == views.cost[v].tolist()


def test_a_node_costs_what_its_cells_see_together():
    """With visible sets a budget that all cells of a subtree meet ends the descent there, whatever else stands around."""
    scene = town(50, seed=3, view_m=64)
    cells = build_cells(scene.view_boxes, scene.cell_m)
    assert cells.n_cells > 3
    sets = [np.array([c % 7, 10 + c % 3, 40]) for c in range(cells.n_cells)]
    union = np.unique(np.concatenate(sets))
    visible = VisibleSets(
        mode="sampled",
        row=np.cumsum([0, *map(len, sets)]).astype(np.int64),
        object=np.concatenate(sets).astype(np.int32),
    )
    _, views = found(scene, settings_for(f"{len(union)} calls"), visible=visible, nodes=[0])
    assert len(views.cell) == 0
    assert (views.cell_cost == len(union)).all() and views.worst_nonproblem == len(union)
    _, views = found(scene, settings_for(f"{len(union) - 1} calls"), visible=visible, nodes=[0])
    assert len(views.cell) == 0 and views.cell_cost.max() < len(union), "a child was not looked at with its own union"
    _, views = found(scene, settings_for("2 calls"), visible=visible, nodes=[0])
    for v in range(len(views.cell)):
        assert np.isin(view_objects(views, v)[0], sets[views.cell[v]]).all()
    _, everything = found(scene, settings_for(f"{len(union)} calls"), nodes=[0])
    assert len(everything.cell)
