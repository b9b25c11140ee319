"""The view-space tree: it covers the view space once, on planes of one grid."""

import numpy as np
from farfield.geometry.cells import build_cells, coarsest_plane, find_cell
from hypothesis import given
from hypothesis import strategies as st


def random_boxes(seed, n):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-50, 50, (n, 3)).round(1)
    size = rng.uniform(0, 40, (n, 3)).round(1) * (rng.random((n, 3)) > 0.2)
    return np.stack([low, low + size], 1)


@given(st.integers(-64, 64), st.integers(1, 64), st.floats(0.1, 10))
def test_the_plane_is_the_coarsest_strictly_inside(first, length, cell_m):
    low, high = (first + 0.25) * cell_m, (first + 0.25 + length) * cell_m
    step = round(coarsest_plane(low, high, cell_m) / cell_m)
    inside = [k for k in range(first - 1, first + length + 2) if low < k * cell_m < high]

    def low_bits(k):
        return np.inf if k == 0 else (k & -k)

    assert step in inside and low_bits(step) == max(map(low_bits, inside))


@given(st.integers(0, 10_000), st.integers(1, 6), st.sampled_from([3.0, 8.0, 23.0]))
def test_each_point_of_the_view_space_lies_in_its_cell(seed, n, cell_m):
    boxes = random_boxes(seed, n)
    tree = build_cells(boxes, cell_m)
    assert (tree.cell_box[:, 1] - tree.cell_box[:, 0] <= cell_m * (1 + 1e-12)).all()
    rng = np.random.default_rng(seed + 1)
    for low, high in boxes:
        fraction = rng.choice([0.0, 1.0, 0.5, rng.random()], (8, 3))
        for point in np.clip(low + fraction * (high - low), low, high):
            cell = find_cell(tree, boxes, point)
            assert cell >= 0
            assert (tree.cell_box[cell, 0] <= point).all() and (point <= tree.cell_box[cell, 1]).all()
    assert find_cell(tree, boxes, boxes[:, 1].max(0) + 1) == -1


@given(st.integers(0, 1000), st.integers(-20, 20))
def test_scaling_by_a_power_of_two_scales_every_plane_exactly(seed, exponent):
    boxes, scale = random_boxes(seed, 3), 2.0**exponent
    a, b = build_cells(boxes, 8.0), build_cells(boxes * scale, 8.0 * scale)
    assert (a.axis == b.axis).all() and (a.plane * scale == b.plane).all() and (a.box * scale == b.box).all()


def test_neighbouring_boxes_that_share_a_face_share_no_cell():
    boxes = np.array([[[0, 0, 0], [8, 1, 8]], [[8, 5, 0], [16, 6, 8]]], dtype=float)
    tree = build_cells(boxes, 8.0)
    assert tree.cell_box.tolist() == boxes.tolist()
    assert [find_cell(tree, boxes, np.array(p)) for p in ([8, 0.5, 1], [8, 5.5, 1], [16, 6.0, 8])] == [0, 1, 1]
