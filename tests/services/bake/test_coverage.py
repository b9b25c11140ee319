"""Texels are recorded exactly: numba against first principles, OpenGL against numba."""

import numpy as np
import pytest
from farfield.bake import coverage, kernels
from farfield.bake.records import Pieces, Slabs, Sources, Surface
from naive import coverage as naive


def random_triangles(n: int, side: int, seed: int) -> np.ndarray:
    """(n,6) int: ordinary ones, slivers, specks below a texel, segments, points, corners on texel corners."""
    rng = np.random.default_rng(seed)
    full = 256 * side
    t = rng.integers(0, full + 1, (n, 3, 2))
    kind = np.arange(n) % 6
    centre = rng.integers(0, full + 1, (n, 1, 2))
    t[kind == 1] = (centre + rng.integers(-300, 301, t.shape))[kind == 1]  # about a texel
    t[kind == 2] = (centre + rng.integers(-20, 21, t.shape))[kind == 2]  # far below a texel
    k = kind == 3  # slivers: the third corner next to the middle of the opposite edge
    t[k, 2] = (t[k, 0] + t[k, 1]) // 2 + rng.integers(-2, 3, (int(k.sum()), 2))
    k = kind == 4  # segments and points
    t[k, 2] = np.where(rng.random((int(k.sum()), 1)) < 0.5, t[k, 0], t[k, 1])
    k = (kind == 4) & (rng.random(n) < 0.3)
    t[k] = centre[k]
    t[kind == 5] = (t // 256 * 256)[kind == 5]
    return np.clip(t, 0, full).reshape(n, 6).astype(np.int32)


def records(snapped: np.ndarray, layer: np.ndarray, side: int, seed: int = 0) -> tuple[Sources, Pieces, Slabs, Surface]:
    """Sources that are their own pieces, in layers of random depths; sorted by layer."""
    rng = np.random.default_rng(seed)
    n, k = len(snapped), int(layer.max()) + 1
    z = rng.uniform(0.9, 2.1, (n, 3))
    slope = snapped.reshape(n, 3, 2) / 256
    corner = np.concatenate([slope * z[:, :, None], z[:, :, None]], -1)
    vertex, out = np.zeros((n, 3), np.int32), np.empty((n, 6), np.int32)
    inverse, reciprocal = np.empty((n, 3)), np.empty((n, 3), np.float32)
    grid = np.zeros(2), np.ones(2), np.full(2, side, np.int64)
    assert kernels.snap_sources(corner, vertex, *grid, out, inverse, reciprocal) < 1e-9
    sources = Sources(
        corner, out, inverse, reciprocal, vertex, np.zeros(n, np.int32), np.zeros(n, np.int32), rng.random(n) < 0.5
    )
    row = np.searchsorted(layer, np.arange(k + 1)).astype(np.int64)
    pieces = Pieces(row, out, np.arange(n, dtype=np.int32))
    low, size = np.zeros((k, 2), np.int32), np.zeros((k, 2), np.int32)
    kernels.bound_pieces(row, out, grid[2], low, size)
    at = np.stack([np.zeros(k), np.arange(k) * side], -1).astype(np.int32)
    slabs = Slabs(np.ones(k), np.full(k, 0.5), low, size, at)
    return sources, pieces, slabs, surface()


def surface() -> Surface:
    z = np.zeros
    return Surface(
        uv=z((1, 2), np.float32), color=np.ones((1, 4), np.float32), normal=z((1, 3), np.float32), turn=z((1, 3, 3)),
        base_color=np.ones((1, 4), np.float32), emissive=z((1, 3), np.float32), masked=z(1, bool),
        double_sided=np.ones(1, bool), cutoff=z(1, np.float32), texture=np.full(1, -1, np.int32), level_row=z(1,
        np.int64), level_size=z((0, 2), np.int32), level_byte=z(0, np.int64), texel=z(0, np.uint8), wrap=z((0, 2),
        np.int32), linear=z(0, bool), smooth=z(0, bool), emissive_uv=z((1, 2), np.float32), unlit=z(1, bool),
        emissive_texture=np.full(1, -1, np.int32), decode=z(256), encode=z(255), lights=z((4, 3)),
    )  # fmt: skip


def test_numba_records_the_texels_that_first_principles_give(request):
    """10,000 triangles with --accept."""
    side = 12
    snapped = random_triangles(10_000 if request.config.getoption("--accept") else 600, side, 1)
    for f, t in enumerate(snapped):
        sources, pieces, slabs, _ = records(t[None], np.zeros(1, np.int64), side)
        sheet = coverage.record(sources, pieces, slabs, surface(), (0, 1), (side, side))
        x, y = slabs.low[0]
        found = {(int(i + x), int(j + y)) for j, i in zip(*np.nonzero(sheet), strict=True)}
        assert found == naive.texels(t.tolist(), side, side), f"{f=} {t=}"


@pytest.mark.parametrize("side", [16, 61])
def test_opengl_records_the_same_pieces(gl, side):
    """10,000 triangles in layers of 20: the winner in every texel, not only the set."""
    from farfield.bake.gl.record import Recorder

    n = 10_000 if side == 16 else 600
    snapped = random_triangles(n, side, 2)
    given = records(snapped, np.arange(n) // 20, side, 3)
    layers, size = (0, n // 20), (side, side * (n // 20))
    recorder = Recorder()
    step = recorder.most_side // side // 20 * 20
    for first in range(0, n // 20, step):  # a sheet cannot be higher than a texture
        last = min(first + step, n // 20)
        given[2].at[first:last, 1] = np.arange(last - first) * side
        size = (side, side * (last - first))
        numba = coverage.record(*given, (first, last), size)
        np.testing.assert_array_equal(recorder.record(*given, (first, last), size), numba)
        assert numba.any()
    assert layers[1] * 20 == n


def test_opengl_records_the_same_pieces_on_grids_of_many_blocks(gl):
    from farfield.bake.gl.record import Recorder

    for side, n in ((700, 60), (4096, 6)):
        given = records(random_triangles(n, side, 4), np.zeros(n, np.int64), side, 5)
        numba = coverage.record(*given, (0, 1), (side, side))
        np.testing.assert_array_equal(Recorder().record(*given, (0, 1), (side, side)), numba)


def test_a_connected_surface_is_recorded_four_connected():
    """The diagonal steps that Jeschke and Wimmer close by hand do not arise."""
    from scipy.ndimage import label

    side = 40
    rng = np.random.default_rng(6)
    for _ in range(150):
        points = np.clip(np.cumsum(rng.integers(-900, 901, (12, 2)), 0) + 128 * side, 0, 256 * side)
        strip = np.array([points[k : k + 3].reshape(6) for k in range(10)], np.int32)
        sheet = coverage.record(*records(strip, np.zeros(10, np.int64), side), (0, 1), (side, side))
        assert label(sheet > 0)[1] == 1


def test_of_two_coincident_pieces_the_first_shows():
    t = np.array([[0, 0, 900, 0, 0, 900]] * 2, np.int32)
    sources, pieces, slabs, s = records(t, np.zeros(2, np.int64), 4)
    sources.corner[1], sources.inverse[1], sources.away[1] = sources.corner[0], sources.inverse[0], sources.away[0]
    sheet = coverage.record(sources, pieces, slabs, s, (0, 1), (4, 4))
    assert set(np.unique(sheet)) == {0, 1}
