"""Triangles are cut at slab borders, and both slabs agree on the cut."""

import numpy as np
from farfield.bake import kernels
from farfield.bake.clip import cell_hull
from farfield.candidates.model import BOX, SHAFT
from naive import clip as naive


def test_parts_in_a_slab_are_those_of_exact_arithmetic():
    rng = np.random.default_rng(0)
    out = np.empty((9, 3))
    for k in range(3000):
        triangle = rng.uniform(0, 4, (3, 3))
        near, far = np.sort(rng.uniform(-0.5, 4.5, 2))
        if k % 3 == 0:  # corners and whole edges on borders
            triangle[:, 2] = np.round(triangle[:, 2])
            near, far = np.floor(near), np.ceil(far)
        n = kernels.clip(triangle, near, far, out)
        found = {tuple(round(float(x), 12) + 0.0 for x in p) for p in out[:n]}
        expected = naive.clip(triangle, near, far)
        gap = [min((max(abs(a - b) for a, b in zip(p, q, strict=True)) for q in expected), default=9) for p in found]
        back = [min((max(abs(a - b) for a, b in zip(p, q, strict=True)) for q in found), default=9) for p in expected]
        assert max(gap + back, default=0) < 1e-9, f"{triangle=} {near=} {far=}"


def test_neighbours_at_a_border_and_at_an_edge_get_the_same_points():
    """Bit for bit, whichever corner comes first and whichever slab or triangle asks."""
    rng = np.random.default_rng(1)
    out = np.empty((9, 3))
    for _ in range(2000):
        a, b, c, d = rng.uniform(1, 5, (4, 3))
        border = rng.uniform(1, 5)
        points = []
        for triangle in ((a, b, c), (b, c, a), (c, b, a), (b, a, d), (d, b, a)):
            for near, far in ((-np.inf, border), (border, np.inf), (border, border)):
                n = kernels.clip(np.array(triangle), near, far, out)
                points.append({tuple(p) for p in out[:n] if p[2] == border})
        assert all(p == points[0] for p in points[:9])
        if (a[2] - border) * (b[2] - border) < 0:
            assert len(points[0] & points[9] & points[12]) == 1


def test_pieces_are_counted_as_they_are_written():
    rng = np.random.default_rng(2)
    corner = rng.uniform(-1, 1, (500, 3, 3)) * [1, 1, 3] + [0, 0, 5]
    near = np.array([-np.inf, 3, 3.5, 5, 5.1, 7])
    far = np.append(near[1:], np.inf)
    grid = np.array([-1.0, -1.0]), np.array([0.01, 0.01]), np.array([200, 200])
    snapped, inverse = np.empty((500, 6), np.int32), np.empty((500, 3))
    kernels.snap_sources(corner, np.zeros((500, 3), np.int32), *grid, snapped, inverse, np.empty((500, 3), np.float32))
    count = np.zeros(6, np.int64)
    kernels.count_pieces(corner, near, far, count)
    row = np.concatenate([[0], np.cumsum(count)])
    piece, source = np.empty((row[-1], 6), np.int32), np.empty(row[-1], np.int32)
    place = row[:-1].copy()
    kernels.fill_pieces(corner, snapped, near, far, *grid, place, piece, source)
    np.testing.assert_array_equal(place, row[1:])
    for k in range(6):
        own = source[row[k] : row[k + 1]]
        assert (np.diff(own) >= 0).all()
        low, high = corner[:, :, 2].min(1), corner[:, :, 2].max(1)
        assert set(own) == set(np.flatnonzero((low <= far[k]) & (high >= near[k])))


def test_the_hull_of_a_view_cell_holds_its_points():
    rng = np.random.default_rng(3)
    box = np.array([-1, 2, -3, 4, 5, 6, 0, 0, 0.0])
    points, directions = cell_hull(BOX, box)
    assert {tuple(p) for p in points} == {(x, y, z) for x in (-1, 4) for y in (2, 5) for z in (-3, 6)}
    assert len(directions) == 0
    for far in (9.0, np.inf):
        axis = np.array([2.0, 1.0, -2.0]) / 3
        points, directions = cell_hull(SHAFT, np.array([5, 6, 7, *axis, 0.4, 3, far]))
        assert (len(directions) > 0) == np.isinf(far)
        for _ in range(300):  # points of the cone against random half-spaces
            side = np.cross(axis, rng.normal(size=3))
            side *= 0.4 * rng.random() ** 0.5 / np.linalg.norm(side)
            p = np.array([5, 6, 7]) + rng.uniform(3, min(far, 20)) * (axis + side)
            n = rng.normal(size=3)
            reach = np.inf if len(directions) and (directions @ n).max() > 0 else (points @ n).max()
            assert p @ n <= reach + 1e-9
