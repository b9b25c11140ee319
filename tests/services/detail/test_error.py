"""The bound of a level's error: never below what any two points show, and not much above."""

import numpy as np
import pytest
from curved import ball, hill
from farfield.detail import kernels
from farfield.detail.error import RESOLVED, surface_distance
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from naive import detail as naive


def surface_of(mesh):
    position, faces = mesh
    return position.astype(np.float64)[faces]


def extent(*surfaces):
    return float(np.linalg.norm(np.ptp(np.concatenate([s.reshape(-1, 3) for s in surfaces]), axis=0)))


GRID = st.integers(-4, 4).map(lambda k: k / 4)  # corners meet, triangles lie in one plane, have no area, are points


@settings(max_examples=80, deadline=None)
@given(arrays(np.float64, (5, 3, 3), elements=GRID), arrays(np.float64, (3, 3, 3), elements=GRID), st.integers(0, 99))
def test_no_sampled_point_is_farther_than_the_bound(a, b, seed):
    rng = np.random.default_rng(seed)
    bound = surface_distance(a, b)
    assert bound >= naive.distance(a, b, 200, rng)
    assert bound == surface_distance(b, a) or abs(bound - surface_distance(b, a)) < 0.25 * bound


@settings(max_examples=80, deadline=None)
@given(arrays(np.float64, (40, 3), elements=st.floats(-2, 2, width=32)), arrays(np.float64, (3, 3), elements=GRID))
def test_distances_from_a_triangle_are_those_of_the_nearest_point(p, t):
    expected = np.sqrt(((p - naive.closest_on_triangle(p, t)) ** 2).sum(1))
    ours = np.sqrt([kernels.triangle2(q, t) for q in p])
    assert (ours >= expected - 1e-12).all()
    np.testing.assert_allclose(ours, expected, atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_noise_on_a_surface_is_bounded_closely(seed):
    """Attack: another triangulation of a rough surface, with long slivers, at sizes from millimetres to kilometres."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-3, 3)
    position, faces = hill(9)
    rough = position + rng.normal(size=position.shape) * 0.03 * rng.choice([0, 1], (len(position), 1), p=[0.7, 0.3])
    a = (position * size)[faces].astype(np.float64)
    b = (rough * size)[np.roll(faces, 1, axis=1)[rng.permutation(len(faces))]].astype(np.float64)
    b = b[:, [0, 2, 1]]
    sampled, bound = naive.distance(a, b, 3000, rng), surface_distance(a, b)
    assert sampled <= bound <= 1.4 * sampled + 2 * RESOLVED * extent(a, b)


def test_a_finer_triangulation_of_the_same_plane_is_no_error():
    n = 30
    x, z = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0), indexing="ij")
    p = np.stack([x, 0 * x, z], -1).reshape(-1, 3)
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    k = i * (n + 1) + j
    fine = p[np.concatenate([np.stack([k, k + 1, k + n + 2], 1), np.stack([k, k + n + 2, k + n + 1], 1)])]
    c = np.array([[0.0, 0, 0], [0, 0, n], [n, 0, n], [n, 0, 0]])
    coarse = c[[[0, 1, 3], [1, 2, 3]]]
    assert surface_distance(fine, coarse) <= 1.2 * RESOLVED * extent(fine)


def test_known_distances():
    t = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])
    assert surface_distance(t, t + np.array([0, 0, 0.5])) == pytest.approx(0.5, rel=1e-6)
    # A spike of one corner: from its tip back to the base, which the base's own points do not show.
    spike = np.concatenate([t, [[[0.2, 0.2, 0], [0.3, 0.2, 0], [0.25, 0.25, 3]]]])
    assert surface_distance(t, spike) == pytest.approx(3.0, rel=1e-6)
    # A ball in a ball of facets: largest in the middle of the coarse one's facets or at the fine one's corners.
    fine, coarse = surface_of(ball(16)), surface_of(ball(6))
    sagitta = naive.distance(fine, coarse, 4000, np.random.default_rng(0))
    assert sagitta <= surface_distance(fine, coarse) <= 1.2 * sagitta


def test_a_hole_counts_as_what_is_missing():
    """One way alone would not see it: every point that is left lies on the original."""
    whole = surface_of(hill(12))
    holed = np.delete(whole, [130, 131, 132], axis=0)
    assert surface_distance(whole, holed) > 0.02
    assert surface_distance(holed, whole) > 0.02


def test_running_out_of_pieces_errs_upwards():
    a, b = surface_of(ball(16)), surface_of(ball(7))
    tree = kernels.build_tree(b)
    close = kernels.farthest(a, b, *tree, 1e-4, 0.1, 10**7)
    rough = kernels.farthest(a, b, *tree, 1e-4, 0.1, 10)
    assert naive.distance(a, b, 1000, np.random.default_rng(1)) * 0.9 < close <= rough
