"""Direction intervals: every direction lies in exactly the one that is found."""

import numpy as np
import pytest
from farfield.geometry.intervals import direction_at, edges, find_interval, interval_bounds, split_id
from hypothesis import given
from hypothesis import strategies as st


@pytest.mark.parametrize("n", [1, 2, 4, 8, 16])
def test_edges_are_equal_angles_and_antisymmetric(n):
    e = edges(n)
    assert (e == -e[::-1]).all() and e[0] == -1 and e[-1] == 1
    assert np.allclose(np.degrees(np.arctan(e)), np.linspace(-45, 45, n + 1), atol=1e-12)
    if n > 1:
        assert (edges(n)[::2] == edges(n // 2)).all()


@pytest.mark.parametrize("n", [1, 2, 8])
def test_the_middle_of_each_interval_is_found_in_it(n):
    for interval in range(6 * n * n):
        face, i, j = split_id(interval, n)
        u, v = interval_bounds(face, i, j, n).mean(1)
        assert find_interval(direction_at(face, u, v) * 3.7, n) == interval


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda d: max(map(abs, d)) > 1e-6), st.sampled_from([1, 4, 8]))
def test_a_direction_lies_within_the_bounds_of_its_interval(d, n):
    direction = np.array(d)
    face, i, j = split_id(find_interval(direction, n), n)
    m, sign = face // 2, 1 if face % 2 == 0 else -1
    assert direction[m] * sign == np.abs(direction).max()
    (u0, u1), (v0, v1) = interval_bounds(face, i, j, n)
    u, v = direction[(m + 1) % 3] / abs(direction[m]), direction[(m + 2) % 3] / abs(direction[m])
    assert u0 <= u and (u < u1 or u1 == 1.0) and v0 <= v and (v < v1 or v1 == 1.0)
