import numpy as np
from farfield.scene import kernels
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import scene as naive


def grid_triangles(seed, n, steps):
    """Triangles whose corners lie on a coarse raster: many are degenerate, many share lines."""
    rng = np.random.default_rng(seed)
    scale = np.float32(10.0) ** rng.integers(-12, 12)
    return (rng.integers(-steps, steps + 1, (n, 3, 3)) * scale).astype(np.float32)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32), steps=st.sampled_from([1, 2, 1000]))
def test_triangles_with_area_are_found_exactly(seed, steps):
    corners = grid_triangles(seed, 40, steps)
    position, index = corners.reshape(-1, 3), np.arange(120).reshape(-1, 3)
    keep = np.zeros(40, dtype=bool)
    kernels.solid_triangles(position, index, keep)
    # Products of float32 differences fit float64 up to rounding: nearly degenerate ones may differ, none with integers.
    assert keep.tolist() == [naive.has_area(c) for c in corners]


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_face_normals(seed):
    corners = grid_triangles(seed, 30, 50)
    corners = corners[[naive.has_area(c) for c in corners]]
    normal = np.empty((len(corners), 3))
    kernels.face_normals(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), normal)
    for c, n in zip(corners.astype(np.float64), normal):
        expected = np.cross(c[1] - c[0], c[2] - c[0])
        np.testing.assert_allclose(n, expected / np.sqrt((expected**2).sum()), atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_boxes_of_placed_meshes(seed):
    rng = np.random.default_rng(seed)
    position = rng.normal(0, 10, (20, 3)).astype(np.float32)
    start, stop = np.array([0, 5, 6]), np.array([5, 6, 20])
    mesh, matrix = rng.integers(0, 3, 7).astype(np.int32), rng.normal(0, 2, (7, 3, 4))
    box = np.empty((7, 2, 3))
    kernels.object_boxes(position, start, stop, mesh, matrix, box)
    for o in range(7):
        low, high = naive.box(position[start[mesh[o]] : stop[mesh[o]]], matrix[o])
        assert box[o].tolist() == [low, high]
        placed = np.empty((stop[mesh[o]] - start[mesh[o]], 3))
        kernels.place(position[start[mesh[o]] : stop[mesh[o]]], matrix[o], placed)
        np.testing.assert_array_equal(placed.min(0), low)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32), facing=st.sampled_from([1.0, -1.0]))
def test_lowest_surface(seed, facing):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-6, 6, (12, 3, 3))
    x0, z0, step = -4.03, -3.97, 0.81
    height = np.full((9, 8), np.inf)
    kernels.lowest_surface(corners, facing, 0.3, -3.0, x0, z0, step, height)
    expected = [
        [naive.lowest(corners, facing, 0.3, -3.0, x0 + i * step, z0 + k * step) for k in range(8)] for i in range(9)
    ]
    np.testing.assert_allclose(height, expected, rtol=1e-9)
