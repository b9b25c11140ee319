"""Candidates against the plain loops, and what every consumer relies on."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from farfield.candidates.generate import UNFIT, directions, generate, merge, merged_parts, plan_shards, refit
from farfield.candidates.model import BOX, SHAFT
from farfield.columns import pack_dataclass
from farfield.geometry.cells import build_cells
from farfield.hierarchy.build import build_hierarchy
from farfield.impostor.cells import contains
from farfield.impostor.plan import plan_layers
from farfield.rendertime.cost import build_cost_model, impostor_cost
from farfield.settings import CameraSettings, PlacementSettings, Settings, ViewSpaceSettings
from farfield.viewspace.cost import cluster_cost
from farfield.viewspace.split import find_problem_views
from farfield.visibility.model import VisibleSets
from naive import candidates as naive
from towns import town

SMALL = CameraSettings(fov_deg=60, width=320, height=180)


def stages(scene, settings):
    hierarchy = build_hierarchy(scene)
    model = build_cost_model(scene, settings=settings)
    off = VisibleSets(mode="off", row=np.zeros(0, np.int64), object=np.zeros(0, np.int32))
    views = find_problem_views(scene, hierarchy, model, off, settings=settings, node=0)
    assert len(views.cell) > 10
    return scene, hierarchy, model, build_cells(scene.view_boxes, scene.cell_m), views


def some(budget="40 calls", n=120, kinds="shafts+boxes", **more):
    settings = Settings(
        budget=budget, camera=SMALL, view_space=ViewSpaceSettings(interval_deg=22.5),
        placement=PlacementSettings(candidates=kinds),
    )  # fmt: skip
    return stages(town(n, view_m=48, **more), settings), settings


@pytest.mark.parametrize(
    "budget, kinds, triangles",
    [("20 calls", "shafts+boxes", 12), ("20 calls", "shafts", 12), ("20 calls", "boxes", 12),
     ("8000 triangles", "shafts+boxes", 600), ("1.3 ms", "shafts+boxes", 12)],
)  # fmt: skip
def test_same_candidates_as_the_plain_loops(budget, kinds, triangles):
    given, settings = some(budget, n=48, kinds=kinds, triangles=triangles)
    _, hierarchy, model, cells, views = given
    nodes = (3, 24)
    found = generate(*given[:4], views, settings=settings, nodes=nodes)
    expected = naive.candidates(hierarchy, model, cells, views, settings, nodes)
    assert len(expected) > 10
    np.testing.assert_array_equal(found.cluster, [row[0] for row in expected])
    np.testing.assert_array_equal(found.kind, [row[1] for row in expected])
    np.testing.assert_array_equal(found.view_cell, [row[2] for row in expected])
    np.testing.assert_array_equal(found.bytes, [row[3] for row in expected])
    np.testing.assert_array_equal(found.layers, [row[4] for row in expected])
    np.testing.assert_array_equal(found.cost, [row[5] for row in expected])
    for i, row in enumerate(expected):
        entries = slice(found.row[i], found.row[i + 1])
        assert list(zip(found.view[entries].tolist(), found.saved[entries].tolist(), strict=True)) == row[6]


@pytest.mark.parametrize("budget, triangles", [("40 calls", 12), ("1.4 ms", 12), ("12000 triangles", 600)])
def test_what_placement_and_bake_rely_on(budget, triangles):
    given, settings = some(budget, triangles=triangles)
    _, hierarchy, model, cells, views = given
    found = merge([generate(*given[:4], views, settings=settings, nodes=s) for s in plan_shards(hierarchy)])
    assert len(found.cluster) > 100
    assert {SHAFT, BOX} == set(found.kind)
    assert (found.saved > 0).all()
    assert (np.diff(found.row) > 0).all()
    keys = [(int(c), int(k), tuple(v)) for c, k, v in zip(found.cluster, found.kind, found.view_cell, strict=True)]
    assert keys == sorted(set(keys))
    for i in np.random.default_rng(0).permutation(len(found.cluster))[:150]:
        view = found.view[found.row[i] : found.row[i + 1]]
        assert (np.diff(view) > 0).all()
        served = np.unique(views.cell[view])
        box = hierarchy.box[found.cluster[i]]
        assert contains(found.kind[i], found.view_cell[i], cells.cell_box[served]).all()
        plan = plan_layers(int(found.kind[i]), found.view_cell[i], box, settings=settings)
        assert len(plan.plane) == found.layers[i]
        assert plan.bytes == found.bytes[i]
        assert found.cost[i] >= impostor_cost(model, triangles=2 * len(plan.plane), pixels=0)
        a, b = int(hierarchy.start[found.cluster[i]]), int(hierarchy.stop[found.cluster[i]])
        saved = [cluster_cost(views, int(v), a, b) - found.cost[i] for v in view]
        np.testing.assert_array_equal(found.saved[found.row[i] : found.row[i + 1]], saved)


def test_every_cell_that_an_impostor_could_help_is_helped():
    given, settings = some()
    _, hierarchy, model, cells, views = given
    found = generate(*given[:4], views, settings=settings, nodes=(0, len(hierarchy.start)))
    owner = np.repeat(found.cluster, np.diff(found.row))
    helped = {(int(c), int(v)) for c, v in zip(owner, views.cell[found.view], strict=True)}
    ancestors = lambda c: [] if c < 0 else [c, *ancestors(int(hierarchy.parent[c]))]  # noqa: E731
    for c in range(0, len(hierarchy.start), 7):
        for cell in range(cells.n_cells):
            *_, cost = refit(hierarchy.box[c], cells.cell_box[[cell]], model=model, settings=settings)
            a, b = int(hierarchy.start[c]), int(hierarchy.stop[c])
            if any(cluster_cost(views, int(v), a, b) > cost for v in np.flatnonzero(views.cell == cell)):
                assert any((x, cell) in helped for x in ancestors(c)), (c, cell)


def test_shards_and_blocks_do_not_show(monkeypatch):
    given, settings = some()
    shards = plan_shards(given[1])
    assert [a for a, _ in shards[1:]] == [b for _, b in shards[:-1]]
    assert shards[0][0] == 0
    assert shards[-1][1] == len(given[1].start)
    whole = merge([generate(*given[:4], given[4], settings=settings, nodes=s) for s in shards])
    monkeypatch.setattr("farfield.candidates.generate.BLOCK_PAIRS", 1)
    again = merge([generate(*given[:4], given[4], settings=settings, nodes=s) for s in shards])
    assert pack_dataclass(whole) == pack_dataclass(again)
    parts = [generate(*given[:4], given[4], settings=settings, nodes=s) for s in shards]
    assert b"".join(merged_parts(parts)) == pack_dataclass(whole)
    assert b"".join(merged_parts([])) == pack_dataclass(merge([]))


def test_clusters_that_cannot_be_baked_are_no_candidates():
    scene = town(120, view_m=48)
    replaceable = np.ones(120, bool)
    replaceable[::3] = False
    settings = Settings(budget="40 calls", camera=SMALL, view_space=ViewSpaceSettings(interval_deg=22.5))
    given = stages(dataclasses.replace(scene, object_replaceable=replaceable), settings)
    found = generate(*given[:4], given[4], settings=settings, nodes=(0, len(given[1].start)))
    assert len(found.cluster)
    assert given[1].replaceable[found.cluster].all()


def test_no_problem_view_or_no_shard_gives_no_candidates():
    given, settings = some()
    views = given[4]
    none = dataclasses.replace(
        views, cell=views.cell[:0], interval=views.interval[:0], cost=views.cost[:0], row=views.row[:1],
        run=views.run[:0], before=views.before[:0], list=views.list[:0],
    )  # fmt: skip
    empty = generate(*given[:4], none, settings=settings, nodes=(0, 30))
    assert len(empty.cluster) == 0
    np.testing.assert_array_equal(empty.row, [0])
    assert pack_dataclass(merge([])) == pack_dataclass(empty)
    assert pack_dataclass(merge([empty, empty])) == pack_dataclass(empty)


def test_refit_to_fewer_cells_and_to_impossible_ones():
    given, settings = some()
    _, hierarchy, model, cells, views = given
    found = generate(*given[:4], views, settings=settings, nodes=(0, len(hierarchy.start)))
    rng = np.random.default_rng(0)
    better = 0
    for i in rng.permutation(len(found.cluster))[:100]:
        served = np.unique(views.cell[found.view[found.row[i] : found.row[i + 1]]])
        some_of = rng.permutation(served)[: max(1, len(served) // 3)]
        box = hierarchy.box[found.cluster[i]]
        kind, cell, size, layers, cost = refit(box, cells.cell_box[some_of], model=model, settings=settings)
        assert contains(kind, cell, cells.cell_box[some_of]).all()
        assert layers == len(plan_layers(kind, cell, box, settings=settings).plane)
        assert cost < UNFIT
        better += size < found.bytes[i]
    assert better > 50
    touching = hierarchy.box[0][None]
    assert refit(hierarchy.box[0], touching, model=model, settings=settings)[2] == UNFIT


def test_raw_directions_cover_the_sphere():
    d = directions()
    assert len(d) > 300
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1)
    points = np.random.default_rng(0).normal(size=(2000, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    assert np.degrees(np.arccos((points @ d.T).max(1))).max() < 11.25 * 0.75


def test_density_offers_fewer_or_more_and_picks_as_the_twin_does():
    given, settings = some("20 calls")
    hierarchy, counts = given[1], []
    for density in (0.05, 0.3, 1.0, 5.0, 50.0):
        at = replace(settings, placement=replace(settings.placement, density=density))
        counts.append(sum(len(generate(*given, settings=at, nodes=s).cluster) for s in plan_shards(hierarchy)))
    assert counts[0] < counts[1] < counts[2] < counts[3] == counts[4], counts  # then all that help are offered
    at = replace(settings, placement=replace(settings.placement, density=0.05))
    nodes = plan_shards(hierarchy)[0]
    found, expected = generate(*given, settings=at, nodes=nodes), naive.candidates(*given[1:], at, nodes)
    np.testing.assert_array_equal(found.view_cell, [row[2] for row in expected])
    np.testing.assert_array_equal(found.bytes, [row[3] for row in expected])
