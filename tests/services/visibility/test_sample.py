"""Sampled visible sets: walks agree with plain loops, sets hold what dense views see, what is stated holds."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from blocks import block, sheet
from blocks import scene as level_of
from farfield.columns import pack_dataclass, unpack_dataclass
from farfield.geometry.cells import build_cells
from farfield.scene.model import BLEND, MASK
from farfield.settings import Settings, VisibilitySettings
from farfield.visibility import kernels, sample
from farfield.visibility.auto import WORTH, measure, reason_to_skip
from farfield.visibility.confidence import most_missed, upper_ppm
from farfield.visibility.free import build_pool, choose_rule, is_free, places_of, whole
from farfield.visibility.merge import merge
from farfield.visibility.model import Sightings
from farfield.visibility.rays import Rays
from farfield.visibility.sample import Sampler, plan_shards, sample_cells, see, view_directions
from naive import visibility as naive
from scipy.stats import beta
from towns import town

QUICK = Settings(visibility=VisibilitySettings(mode="sampled", missed_ppm=2000.0, rays=20_000))


@pytest.fixture(scope="module", autouse=True)
def _fewer_held_out():
    """A quarter of the held-out rays: made-up towns are small and their bounds loose."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sample, "HELD_OUT", 2**16)
        patch.setattr(sample, "HELD_OUT_TRIES", 2**18)
        patch.setattr(sample, "VIEW_TRIES", 256)
        yield


def cells_of(scene):
    return build_cells(scene.view_boxes, scene.cell_m)


def sets_of(visible):
    return [set(visible.object[a:b].tolist()) for a, b in pairwise(visible.row)]


def unit(v):
    return v / np.sqrt((v * v).sum(-1, keepdims=True))


def grounded(scene, *, half_m=200.0):
    """Return the scene with one more object: a square of ground at y = 0 under all houses."""
    n, y, t = scene.n_objects, len(scene.position), len(scene.index)
    corners = np.array(
        [[-half_m, 0, -half_m], [-half_m, 0, half_m], [half_m, 0, half_m], [half_m, 0, -half_m]], np.float32
    )
    matrix = np.zeros((1, 3, 4))
    matrix[0, :, :3] = np.eye(3)
    join = np.concatenate
    return dataclasses.replace(
        scene,
        position=join([scene.position, corners]),
        normal=join([scene.normal, np.tile(np.array([[0, 1, 0]], np.float32), (4, 1))]),
        uv=join([scene.uv, np.zeros((4, 2), np.float32)]), color=join([scene.color, np.ones((4, 4), np.float32)]),
        index=join([scene.index, np.array([[0, 1, 2], [0, 2, 3]], np.int32) + y]).astype(np.int32),
        primitive_triangle=join([scene.primitive_triangle, [t + 2]]),
        primitive_vertex=join([scene.primitive_vertex, [y + 4]]),
        primitive_material=join([scene.primitive_material, [0]]).astype(np.int32),
        mesh_primitive=join([scene.mesh_primitive, [len(scene.primitive_material) + 1]]),
        object_mesh=join([scene.object_mesh, [len(scene.mesh_primitive) - 1]]).astype(np.int32),
        object_matrix=join([scene.object_matrix, matrix]),
        object_box=join([scene.object_box, np.stack([corners.min(0), corners.max(0)])[None].astype(np.float64)]),
        object_triangles=join([scene.object_triangles, [2]]), object_calls=join([scene.object_calls, [1]]),
        object_bytes=join([scene.object_bytes, [168]]), object_replaceable=join([scene.object_replaceable, [True]]),
        object_name=(*scene.object_name, "ground"),
    ), n  # fmt: skip


def inside_a_house(scene, points):
    return (
        ((points[:, None] > scene.object_box[None, :, 0]) & (points[:, None] < scene.object_box[None, :, 1]))
        .all(2)
        .any(1)
    )


# Kernels ------------------------------------------------------------------------------------------------------------


def test_lines_mark_the_cells_that_their_segment_crosses():
    rng = np.random.default_rng(0)
    # Boxes of different heights, one flat, with gaps: cells are tight and not a grid.
    low = np.array([[x * 7.0, rng.uniform(0, 9), z * 7.0] for x in range(4) for z in range(4)])
    boxes = np.stack([low, low + np.array([7.0, 1.5, 7.0])], 1)
    boxes[3, 1, 1] = boxes[3, 0, 1]
    cells = build_cells(boxes, 5.0)
    n = 400
    inside = boxes[rng.integers(0, 16, n)]
    origin = inside[:, 0] + (inside[:, 1] - inside[:, 0]) * rng.random((n, 3))
    direction = unit(rng.normal(size=(n, 3)) * [1, 0.2, 1])
    direction[:40] = np.eye(3)[rng.integers(0, 3, 40)]
    back, ahead = rng.uniform(0, 20, n), np.where(rng.random(n) < 0.3, np.inf, rng.uniform(0, 30, n))
    behind, front = rng.integers(-1, 130, n).astype(np.int32), rng.integers(-1, 130, n).astype(np.int32)
    seen, expected = np.zeros((cells.n_cells, 3), np.uint64), [set() for _ in range(cells.n_cells)]
    news, own = np.empty((n, 2), np.int32), np.array([5, 20])
    kernels.mark_lines(
        cells.low, cells.high, cells.box, cells.start, origin, direction, back, ahead, behind, front, seen, own, news
    )
    for r in range(n):
        crossed = naive.cells_crossed(cells.cell_box, origin[r], direction[r], back[r], ahead[r])
        for side, o in enumerate((int(behind[r]), int(front[r]))):
            new = [c for c in crossed if o >= 0 and o not in expected[c]]
            assert news[r, side] in [c for c in new if 5 <= c < 20] or news[r, side] == -1
            assert (news[r, side] == -1) == (not any(5 <= c < 20 for c in new))
            for c in new:
                expected[c].add(o)
    row = np.concatenate([[0], np.cumsum(kernels.sizes(seen))])
    object = np.empty(row[-1], np.int32)
    kernels.members(seen, row, object)
    assert [object[a:b].tolist() for a, b in pairwise(row)] == [sorted(s) for s in expected]
    cell, o = rng.integers(0, cells.n_cells, 300), rng.integers(-1, 130, 300).astype(np.int32)
    out = np.empty(300, bool)
    kernels.is_seen(seen, cell, o, out)
    assert out.tolist() == [x < 0 or x in expected[c] for c, x in zip(cell, o)]


def test_the_frontier_is_what_neighbours_see_and_ranks_pick_its_members():
    rng = np.random.default_rng(1)
    sets = [set(rng.integers(0, 150, 40).tolist()) for _ in range(6)]
    seen = np.zeros((6, 3), np.uint64)
    for c, members in enumerate(sets):
        for o in members:
            seen[c, o // 64] |= np.uint64(1) << np.uint64(o % 64)
    cells, row, neighbour = np.array([0, 3, 5]), np.array([0, 2, 3, 5]), np.array([1, 2, 4, 0, 2])
    out = np.empty((3, 3), np.uint64)
    count = kernels.frontier(seen, cells, row, neighbour, out)
    expected = [sorted((sets[1] | sets[2]) - sets[0]), sorted(sets[4] - sets[3]), sorted((sets[0] | sets[2]) - sets[5])]
    assert count.tolist() == [len(e) for e in expected]
    ranks = np.sort(rng.integers(0, count.sum(), 200))
    which, object = np.empty(200, np.int32), np.empty(200, np.int32)
    kernels.pick(out, ranks, which, object)
    flat = [(c, o) for c, e in enumerate(expected) for o in e]
    assert list(zip(which.tolist(), object.tolist())) == [flat[r] for r in ranks]


# Rays ---------------------------------------------------------------------------------------------------------------


def test_rays_hit_what_trying_each_triangle_hits():
    scene = town(12, seed=2)
    matrix = scene.object_matrix.copy()
    matrix[3, 0, 0] = -1.0  # mirrored: its faces must still count as faces
    matrix[3, 0, 3] += 8.0
    scene = dataclasses.replace(scene, object_matrix=matrix)
    rays = Rays(scene)
    triangles, objects, _ = naive.object_triangles(scene)
    rng = np.random.default_rng(0)
    origin, direction = rng.uniform([-40, 1, -40], [40, 20, 40], (300, 3)), unit(rng.normal(size=(300, 3)))
    object, distance, faces = rays.first(origin, direction)
    assert (object >= 0).sum() > 40
    for r in range(300):
        hit, expected = naive.first_hit(triangles, origin[r], direction[r])
        assert object[r] == (objects[hit] if hit >= 0 else -1), (origin[r], direction[r])
        assert distance[r] == pytest.approx(expected, rel=1e-4)
    outside = ~inside_a_house(scene, origin) & (object >= 0) & (object != 3)
    assert len(set(faces[outside].tolist())) == 1, "closed houses show one side only to a point outside"


def test_see_through_triangles_are_seen_and_do_not_hide():
    """A masked and a blended wall in a row before a house: all three are seen by a cell in front."""
    base = town(3, seed=0, block_m=30.0)
    low = np.array([[-3.0, 0, 10], [-3.0, 0, 20], [-3.0, 0, 30]])
    matrix = base.object_matrix.copy()
    matrix[:, :, 3] = low
    box = base.object_box - base.object_box[:, :1] + low[:, None]
    scene = dataclasses.replace(
        base, object_matrix=matrix, object_box=box, view_boxes=np.array([[[-1.0, 1.0, -2.0], [1.0, 2.0, 0.0]]]),
        material_alpha_mode=np.array([MASK, BLEND, 0], np.uint8), primitive_material=np.array([0, 1, 2], np.int32),
    )  # fmt: skip
    assert sample_cells(scene, cells_of(scene), 0, rays=2000, seed=0).tolist() == [[True, True, True]]
    opaque = dataclasses.replace(scene, material_alpha_mode=np.zeros(3, np.uint8))
    wide = dataclasses.replace(opaque, position=opaque.position * np.array([20, 1, 1], np.float32))
    assert sample_cells(wide, cells_of(wide), 0, rays=2000, seed=0)[0].tolist()[0]
    ray, passed = Rays(scene).passed(np.array([[0.0, 1.5, 0.0]]), np.array([[0.0, 0.0, 1.0]]), np.array([np.inf]))
    assert ray.tolist() == [0, 0] and passed.tolist() == [0, 1]


def test_the_same_hits_whoever_builds_the_tracer():
    """Coincident faces: which of two objects is hit must not depend on the build."""
    one = town(60, seed=4)
    twice = dataclasses.replace(one, index=np.concatenate([one.index] * 1), object_matrix=one.object_matrix.copy())
    twice.object_matrix[30:] = twice.object_matrix[:30]
    rng = np.random.default_rng(0)
    origin, direction = rng.uniform(-60, 60, (5000, 3)), unit(rng.normal(size=(5000, 3)))
    first = Rays(twice).first(origin, direction)
    for _ in range(3):
        again = Rays(twice).first(origin, direction)
        for a, b in zip(first, again):
            np.testing.assert_array_equal(a, b)


# Free points --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ground", [True, False])
def test_no_origin_is_inside_a_house(ground):
    scene = town(100, seed=1)
    if ground:
        scene, _ = grounded(scene)
    rays = Rays(scene)
    rule = choose_rule(rays, whole(scene.view_boxes, cell_m=scene.cell_m))
    assert rule == ("sky" if ground else "facing")
    cells = cells_of(scene)
    places = places_of(cells, scene.view_boxes, cell_m=scene.cell_m, which=np.arange(cells.n_cells))
    assert places.volume.sum() == pytest.approx(np.prod(np.diff(scene.view_boxes, axis=1)))
    rng = np.random.default_rng(0)
    cell, points = places.spread(rng.random((4000, 4)))
    box = cells.cell_box[cell]
    assert ((points >= box[:, 0]) & (points <= box[:, 1])).all()
    houses = dataclasses.replace(scene, object_box=scene.object_box[:100])
    inside = inside_a_house(houses, points)
    assert 0.1 < inside.mean() < 0.9
    np.testing.assert_array_equal(is_free(rays, points, rule), ~inside)
    pool = build_pool(rays, places, rule, rng, tries=64, last=64)
    assert not inside_a_house(houses, pool.points).any()
    for c in pool.open:
        held = pool.points[pool.row[c] : pool.row[c + 1]]
        assert ((held >= cells.cell_box[c, 0]) & (held <= cells.cell_box[c, 1])).all()


def test_an_inside_out_level_falls_back_to_the_sky():
    scene, _ = grounded(town(100, seed=1))
    turned = scene.index.copy()
    turned[:-2] = turned[:-2, ::-1]  # houses, not the ground
    scene = dataclasses.replace(scene, index=turned)
    assert choose_rule(Rays(scene), whole(scene.view_boxes, cell_m=scene.cell_m)) == "sky"


# The sets -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sampled():
    scene, _ = grounded(town(225, seed=5, view_m=96.0))
    cells = cells_of(scene)
    parts = [see(scene, cells, node, settings=QUICK, mode="sampled", seen_share=0.25) for node in plan_shards(cells)]
    return scene, cells, parts, merge(scene, cells, parts)


def test_sets_hold_what_fresh_dense_views_see(sampled):
    scene, cells, _, visible = sampled
    rays, sets = Rays(scene), sets_of(visible)
    places = places_of(cells, scene.view_boxes, cell_m=scene.cell_m, which=np.arange(cells.n_cells))
    rng = np.random.default_rng(99)
    cell, points = places.spread(rng.random((300_000, 4)))
    free = is_free(rays, points, "sky")
    object = rays.first(points[free], view_directions(rng.random((int(free.sum()), 4))))[0]
    pairs, count = np.unique(np.stack([cell[free], object], 1)[object >= 0], axis=0, return_counts=True)
    missed = sum(n for (c, o), n in zip(pairs.tolist(), count.tolist()) if o not in sets[c])
    assert missed / free.sum() * 1e6 < 2 * visible.missed_ppm_upper + 50
    assert 0 < visible.missed_ppm_upper < 2500 and visible.p99_ppm >= 0
    assert visible.held_out > 60_000 and visible.views > 60
    # ... and not simply everything: houses hide houses.
    assert len(visible.object) < 0.7 * cells.n_cells * scene.n_objects


def test_no_pair_is_seen_that_a_ray_cannot_witness(sampled):
    """A house within four taller walls is seen from nowhere."""
    scene = sampled[0]
    k = 100
    box = scene.object_box[k]
    middle = box.mean(0)
    around = np.argsort(((scene.object_box[:225].mean(1) - middle) ** 2).sum(1))[1:5]
    matrix, boxes = scene.object_matrix.copy(), scene.object_box.copy()
    for o, (dx, dz) in zip(around, ((-9, 0), (9, 0), (0, -9), (0, 9))):
        size = boxes[o, 1] - boxes[o, 0]
        grow = np.array([24.0, 60.0, 4.0] if dz else [4.0, 60.0, 24.0]) / size
        low = np.array([middle[0] + dx, 0, middle[2] + dz]) - np.array(
            [grow[0] * size[0] / 2, 0, grow[2] * size[2] / 2]
        )
        matrix[o, :, :3], matrix[o, :, 3] = np.diag(grow), low
        boxes[o] = [low, low + grow * size]
    hidden = dataclasses.replace(
        scene, object_matrix=matrix, object_box=boxes,
        view_boxes=np.array([[[-90.0, 1.0, -90.0], [-60.0, 3.0, 90.0]]]),
    )  # fmt: skip
    found = sample_cells(hidden, cells_of(hidden), 0, rays=20_000, seed=3)
    assert not found[:, k].any() and found[:, around].any()


def test_the_stated_misses_are_those_of_the_held_out_rays(sampled):
    _, _, parts, visible = sampled
    sets = sets_of(visible)
    missed = sum(int(n) for p in parts for c, o, n in zip(p.held_cell, p.held_object, p.held_count) if o not in sets[c])
    assert (visible.held_out, visible.held_out_missed) == (sum(p.held_out for p in parts), missed)
    assert visible.missed_ppm_upper == pytest.approx(1e6 * beta.ppf(0.95, missed + 1, visible.held_out - missed))
    lost = []
    for p in parts:
        for v in range(len(p.view_cell)):
            pairs = slice(p.view_row[v], p.view_row[v + 1])
            lost.append(
                sum(int(n) for o, n in zip(p.view_object[pairs], p.view_count[pairs]) if o not in sets[p.view_cell[v]])
            )
    assert visible.worst_ppm == pytest.approx(max(lost) * 1e6 / 96**2)
    assert visible.p99_ppm == pytest.approx(sorted(lost)[-1 - len(lost) // 100] * 1e6 / 96**2)


def test_shards_come_out_alike_in_any_order_and_twice(sampled):
    scene, cells, parts, visible = sampled
    assert len(parts) >= 4
    assert sorted(c for p in plan_shards(cells) for c in range(cells.start[p], cells.stop[p])) == list(
        range(cells.n_cells)
    )
    again = see(scene, cells, plan_shards(cells)[1], settings=QUICK, mode="sampled", seen_share=0.25)
    assert pack_dataclass(again) == pack_dataclass(parts[1])
    through_files = [unpack_dataclass(Sightings, pack_dataclass(p)) for p in parts[::-1]]
    assert pack_dataclass(merge(scene, cells, through_files)) == pack_dataclass(visible)
    other = see(
        scene,
        cells,
        plan_shards(cells)[1],
        settings=dataclasses.replace(QUICK, seed=1),
        mode="sampled",
        seen_share=0.25,
    )
    assert pack_dataclass(other) != pack_dataclass(parts[1])


def test_a_power_of_two_changes_no_set():
    scene, _ = grounded(town(64, seed=6, view_m=48.0))
    small = dataclasses.replace(
        scene, cell_m=scene.cell_m / 8, view_boxes=scene.view_boxes / 8, position=scene.position / 8,
        object_box=scene.object_box / 8,
        object_matrix=np.concatenate([scene.object_matrix[:, :, :3], scene.object_matrix[:, :, 3:] / 8], 2),
    )  # fmt: skip
    a, b = (sample_cells(s, cells_of(s), 0, rays=3000, seed=0) for s in (scene, small))
    np.testing.assert_array_equal(a, b)


def test_a_cell_inside_a_solid_is_closed_and_has_what_it_touches():
    scene, _ = grounded(town(64, seed=6))
    house = int(np.argmax(np.prod(scene.object_box[:64, 1] - scene.object_box[:64, 0], axis=1)))
    box = scene.object_box[house]
    middle = (box[0] + box[1]) / 2
    shut = np.array([[middle[0] - 0.5, 1.0, middle[2] - 0.5], [middle[0] + 0.5, 2.0, middle[2] + 0.5]])
    street = np.array([[-60.0, 1.0, -60.0], [-56.0, 2.0, 60.0]])
    scene = dataclasses.replace(scene, view_boxes=np.stack([street, shut]))
    cells = cells_of(scene)
    visible = merge(scene, cells, [see(scene, cells, 0, settings=QUICK, mode="sampled", seen_share=None)])
    inside = [
        c for c in range(cells.n_cells) if ((cells.cell_box[c] >= shut[0]) & (cells.cell_box[c] <= shut[1])).all()
    ]
    assert visible.closed.tolist() == inside and inside
    for c in inside:
        assert sets_of(visible)[c] == {house}


# Confidence and auto ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("missed", "n"), [(0, 1000), (3, 1000), (40, 2**20), (1000, 1000)])
def test_bounds_are_those_of_clopper_and_pearson(missed, n):
    expected = 1e6 if missed == n else 1e6 * beta.ppf(0.95, missed + 1, n - missed)
    assert upper_ppm(missed, n) == pytest.approx(expected)
    if missed == 0:
        assert upper_ppm(0, n) == pytest.approx(3e6 / n, rel=0.01)
    most = most_missed(n, ppm=5000.0)
    assert most == -1 or upper_ppm(most, n) <= 5000.0
    assert most == n or upper_ppm(most + 1, n) > 5000.0


def test_the_bound_holds_as_often_as_it_says():
    rng = np.random.default_rng(0)
    p, n = 30e-6, 2**19
    misses = rng.binomial(n, p, 4000)
    held = np.mean([upper_ppm(int(k), n) >= 1e6 * p for k in misses])
    assert 0.945 <= held <= 0.99


def test_auto_skips_where_everything_is_seen_and_not_where_houses_hide_houses():
    dense, _ = grounded(town(400, seed=0, block_m=9.0, view_m=96.0))
    sparse, _ = grounded(town(16, seed=0, block_m=60.0, view_m=96.0), half_m=300.0)
    shares = [measure(s, cells_of(s), seed=0) for s in (dense, sparse)]
    assert shares[0] < WORTH < shares[1]
    assert reason_to_skip(shares[0]) is None and f"{shares[1]:.0%}" in reason_to_skip(shares[1])
    assert "no cell" in reason_to_skip(None)
    assert measure(dense, cells_of(dense), seed=0) == shares[0]


def test_a_sampler_stops_at_its_limit():
    scene, _ = grounded(town(64, seed=6, view_m=48.0))
    sampler = Sampler(scene, cells_of(scene), 0, seed=0)
    sampler.run(rays=5000)
    assert 5000 * len(sampler.open) <= sampler.n_rays <= 5000 * len(sampler.open) + 2**17


WALL = sheet([-10, 0, -40], [-10, 0, 40], [-10, 20, 40], [-10, 20, -40])
GROUND = sheet([-60, 0, -60], [-60, 0, 60], [60, 0, 60], [60, 0, -60])


def turned_over(mesh):
    return mesh[0], mesh[1][:, ::-1]


@pytest.mark.parametrize(
    ("walls", "double_sided", "hides"),
    [([WALL], False, False), ([turned_over(WALL)], False, True), ([WALL, turned_over(WALL)], False, True),
     ([WALL], True, True)],
    ids=["back", "front", "both", "double-sided"],
)  # fmt: skip
def test_a_back_that_is_not_drawn_hides_nothing(walls, double_sided, hides):
    view, target = [[[0.5, 1.0, -1.5], [3.5, 3.0, 1.5]]], block([-30, 0, -0.5], [-29, 2, 0.5])
    scene = level_of([target, GROUND, *walls], view=view, cell_m=4.0, double_sided=double_sided)
    sees = sample_cells(scene, cells_of(scene), 0, rays=20_000, seed=0)[0]
    assert sees[0] == (not hides) and sees[1]
    assert sees[2:].any() == hides  # a back is no part of a picture
    rays, at, along = Rays(scene), np.array([[2.0, 1.5, 0.0]]), np.array([[-1.0, 0.0, 0.0]])
    object, distance, free = rays.seen(at, along)
    assert (distance[0], free[0]) == pytest.approx((12.0, 12.0) if hides else (31.0, 12.0))
    assert (object[0] == 0) == (not hides)
