"""The walk of comparisons: inside the view space, step by step, the same for the same boxes."""

import numpy as np
import pytest
from farfield.experiment.route import district, make_route
from hypothesis import given
from hypothesis import strategies as st


def inside(boxes: np.ndarray, position: np.ndarray) -> bool:
    return bool(((position >= boxes[:, 0] - 1e-9) & (position <= boxes[:, 1] + 1e-9)).all(1).any())


@given(st.sets(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=1, max_size=30), st.integers(0, 2**31))
def test_every_frame_stands_in_the_view_space_and_no_step_is_a_jump(squares, seed):
    rng = np.random.default_rng(seed)
    corner = np.array(sorted(squares), dtype=np.float64) * 10 + rng.uniform(-1e6, 1e6, 2)
    floor = rng.uniform(0, 1.5, len(corner))
    low = np.column_stack([corner[:, 0], floor, corner[:, 1]])
    boxes = np.stack([low, low + np.array([10.0, 2.0, 10.0])], 1)
    walk = make_route(boxes, 50)
    assert walk.shape == (50, 6)
    assert all(inside(boxes, p) for p in walk[:, :3])
    step = np.sqrt((np.diff(walk[:, :3], axis=0) ** 2).sum(1))
    assert step.max() <= 1.0001 * np.median(step) + 1e-6  # corners are cut: steps there are shorter
    np.testing.assert_allclose((walk[:, 3:] ** 2).sum(1), 1.0)
    np.testing.assert_array_equal(walk, make_route(boxes, 50))


def test_a_view_space_of_one_point_is_stood_in():
    walk = make_route(np.array([[[3.0, 1.5, 4.0]] * 2]), 5)
    np.testing.assert_array_equal(walk[:, :3], np.tile([3.0, 1.5, 4.0], (5, 1)))
    assert np.isfinite(walk).all()


@pytest.mark.parametrize("most", [1, 4, 100])
def test_a_district_is_connected_and_around_the_middle(most):
    corner = np.array([(x, z) for x in range(9) for z in range(9)], dtype=np.float64)
    low = np.column_stack([corner[:, 0], np.zeros(81), corner[:, 1]])
    boxes = np.stack([low, low + 1], 1)
    chosen = district(boxes, most)
    assert len(chosen) == min(most, 81)
    assert 40 in chosen
    assert all(inside(boxes[chosen], p) for p in make_route(boxes[chosen], 40)[:, :3])
