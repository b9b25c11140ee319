import dataclasses

import numpy as np
import pytest
from farfield.hierarchy.build import build_hierarchy
from farfield.scene.order import morton_keys, object_order, spread_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import hierarchy as naive
from towns import town


def boxes_scene(boxes, *, cell_m=16.0, origin=(0.0, 0.0, 0.0)):
    """A town whose boxes are replaced by `boxes`, in id order; only what stage hierarchy reads is consistent."""
    n = len(boxes)
    base = town(n)
    origin = np.array(origin, dtype=np.float64)
    ones = np.ones(n, dtype=np.int64)
    order = object_order(boxes, triangles=ones, calls=ones, origin_m=origin, cell_m=cell_m)
    return dataclasses.replace(base, object_box=boxes[order], origin_m=origin, cell_m=cell_m), order


def some_boxes(rng, n, extent=300.0, coarse=False):
    low = rng.uniform(-extent, extent, (n, 3))
    if coarse:
        low = np.round(low / 40) * 40
    size = np.full((n, 3), 4.0) if coarse else rng.uniform(0, 20, (n, 3))
    return np.stack([low, low + size], 1)


def cluster_sets(hierarchy, names):
    return {frozenset(names[a:b]) for a, b in zip(hierarchy.start.tolist(), hierarchy.stop.tolist())}


@pytest.mark.parametrize("n", [1, 2, 3, 7, 64, 401])
@pytest.mark.parametrize("coarse", [False, True])
def test_invariants(n, coarse):
    rng = np.random.default_rng(n)
    scene, _ = boxes_scene(some_boxes(rng, n, coarse=coarse))
    h = build_hierarchy(scene)
    assert len(h.start) == 2 * n - 1
    assert (h.start[0], h.stop[0], h.parent[0]) == (0, n, -1)
    leaf = h.left < 0
    np.testing.assert_array_equal(leaf, h.right < 0)
    np.testing.assert_array_equal(h.start[leaf], np.arange(n))
    np.testing.assert_array_equal(h.stop[leaf], np.arange(n) + 1)
    inner = np.flatnonzero(~leaf)
    np.testing.assert_array_equal(h.left[inner], inner + 1)
    np.testing.assert_array_equal(h.start[h.left[inner]], h.start[inner])
    np.testing.assert_array_equal(h.stop[h.left[inner]], h.start[h.right[inner]])
    np.testing.assert_array_equal(h.stop[h.right[inner]], h.stop[inner])
    np.testing.assert_array_equal(h.parent[h.left[inner]], inner)
    np.testing.assert_array_equal(h.parent[h.right[inner]], inner)
    for c in range(2 * n - 1):
        part = slice(h.start[c], h.stop[c])
        np.testing.assert_array_equal(h.box[c, 0], scene.object_box[part, 0].min(0))
        np.testing.assert_array_equal(h.box[c, 1], scene.object_box[part, 1].max(0))
        assert h.calls[c] == scene.object_calls[part].sum()
        assert h.triangles[c] == scene.object_triangles[part].sum()
        assert h.bytes[c] == scene.object_bytes[part].sum()


def test_replaceable_needs_every_object():
    scene = town(50)
    flags = np.ones(50, dtype=bool)
    flags[17] = False
    h = build_hierarchy(dataclasses.replace(scene, object_replaceable=flags))
    np.testing.assert_array_equal(h.replaceable, ~((h.start <= 17) & (h.stop > 17)))


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    n=st.integers(1, 60),
    extent=st.sampled_from([0.01, 5.0, 300.0, 1e7, 1e13]),
    coarse=st.booleans(),
    cell_m=st.sampled_from([16.0, 23.0, 0.3]),
    steps=st.integers(-3, 3),
)
def test_equals_the_naive_tree(seed, n, extent, coarse, cell_m, steps):
    scene, _ = boxes_scene(
        some_boxes(np.random.default_rng(seed), n, extent, coarse), cell_m=cell_m, origin=(steps * 64 * cell_m,) * 3
    )
    h = build_hierarchy(scene)
    assert list(zip(h.start.tolist(), h.stop.tolist())) == naive.clusters(scene.object_box, scene.origin_m, cell_m)
    keys = morton_keys(scene.object_box, origin_m=scene.origin_m, cell_m=cell_m).tolist()
    assert [(a << 63) | b for a, b in keys] == [
        naive.morton_key(*box, scene.origin_m, cell_m) for box in scene.object_box.tolist()
    ]


@pytest.mark.parametrize("coarse", [False, True])
def test_moving_one_object_changes_only_its_branch(coarse):
    """Without the moved object's own id the clusters before and after are the same ones."""
    rng = np.random.default_rng(5)
    boxes = some_boxes(rng, 120)
    if coarse:
        boxes = np.unique(some_boxes(rng, 120, coarse=True), axis=0)  # ties are halved by count: leave them out
    moved = boxes.copy()
    moved[11] += 170.0

    def without(b, gone):
        scene, order = boxes_scene(b)
        return {c - {gone} for c in cluster_sets(build_hierarchy(scene), order.tolist())} - {frozenset()}

    assert without(boxes, 11) == without(moved, 11)


@pytest.mark.parametrize("factor", [2.0**-9, 0.5, 4.0, 2.0**20])
def test_scaling_by_a_power_of_two_keeps_ids_and_tree(factor):
    boxes = some_boxes(np.random.default_rng(3), 200)
    scene, order = boxes_scene(boxes, cell_m=23.0, origin=(23.0 * 64, 0, -23.0 * 32))
    scaled, scaled_order = boxes_scene(
        boxes * factor, cell_m=23.0 * factor, origin=np.array([23.0 * 64, 0, -23.0 * 32]) * factor
    )
    np.testing.assert_array_equal(order, scaled_order)
    np.testing.assert_array_equal(build_hierarchy(scene).start, build_hierarchy(scaled).start)


def test_order_ignores_the_input_order_and_the_origin():
    rng = np.random.default_rng(4)
    boxes = some_boxes(rng, 200)
    shuffle = rng.permutation(200)
    scene, order = boxes_scene(boxes)
    other, other_order = boxes_scene(boxes[shuffle])
    np.testing.assert_array_equal(order, shuffle[other_order])
    np.testing.assert_array_equal(scene.object_box, other.object_box)
    # A whole number of cells, a power of two of metres: the shifted boxes are exact.
    boxes = np.round(boxes * 64) / 64
    _, order = boxes_scene(boxes)
    _, rebased = boxes_scene(boxes - 512.0, origin=(512.0,) * 3)
    np.testing.assert_array_equal(order, rebased)


def test_many_equal_centres_stay_shallow():
    boxes = np.tile(np.array([[[0.0, 0, 0], [1, 1, 1]]]), (5000, 1, 1))
    scene, _ = boxes_scene(boxes)
    h = build_hierarchy(scene)
    depth = np.zeros(len(h.start), dtype=int)
    for c in range(1, len(depth)):
        depth[c] = depth[h.parent[c]] + 1
    assert depth.max() == 13


def test_spread_bits_of_every_single_bit():
    for bit in range(21):
        assert int(spread_bits(np.array([1 << bit], dtype=np.uint64))[0]) == 1 << (3 * bit)


def test_town_is_in_id_order_of_the_fixed_grid():
    build_hierarchy(town(400))
