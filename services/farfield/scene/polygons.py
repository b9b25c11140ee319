"""Polygons -> triangles: fans where they are right, ear clipping where a polygon is concave.

After    Meisters. Polygons have ears. American Mathematical Monthly 82, 1975 (every simple polygon has two).
"""

import numpy as np

from farfield.errors import SceneOverLimit
from farfield.scene.ear_kernels import clip_ears

MOST_TESTS = 1 << 30  # some seconds of one core


def triangulate(position: np.ndarray, corner: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ((T,3) int64 rows of `corner`, (T,) int64 the polygon of each triangle), in polygon order.

    position   (V,3) f64
    corner     (E,) int64 vertex of each polygon corner, polygon after polygon
    size       (F,) int64 corners of each polygon; those with fewer than 3 give nothing
    Raises SceneOverLimit where concave ones would take more than MOST_TESTS tests of a corner against an ear.
    """
    first = np.concatenate([[0], np.cumsum(size)[:-1]]) if len(size) else np.zeros(0, np.int64)
    triangles, owners = [], []
    left = MOST_TESTS
    for n in np.unique(size[size >= 3]).tolist():
        polygon = np.flatnonzero(size == n)
        rows = first[polygon][:, None] + np.arange(n)
        fan = np.array([[0, k, k + 1] for k in range(1, n - 1)])
        cut = rows[:, fan]
        if n > 3:
            for i in np.flatnonzero(~_convex(position[corner[rows]])).tolist():
                ears, tests = _clip_ears(position[corner[rows[i]]], left)
                left -= tests
                cut[i] = rows[i][ears]
        triangles.append(cut.reshape(-1, 3))
        owners.append(np.repeat(polygon, n - 2))
    if not triangles:
        return np.zeros((0, 3), np.int64), np.zeros(0, np.int64)
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(triangles)[order], owner[order]


def _normal(points: np.ndarray) -> np.ndarray:
    """Newell's normal of (..., n, 3) polygons: twice their area vector."""
    p = points - points[..., :1, :]
    return np.cross(p, np.roll(p, -1, axis=-2)).sum(-2)


def _convex(points: np.ndarray) -> np.ndarray:
    """(F,n,3) -> (F,): no corner turns against the polygon's normal."""
    edge = np.roll(points, -1, axis=1) - points
    turn = np.cross(np.roll(edge, 1, axis=1), edge)
    return ((turn * _normal(points)[:, None]).sum(-1) >= 0).all(1)


def _clip_ears(points: np.ndarray, most: int) -> tuple[np.ndarray, int]:
    """(n,3) -> (n-2,3): cut off ears in the plane of the normal; what has no ear left is fanned. Also the tests made."""
    whole = _normal(points)
    drop = int(np.argmax(np.abs(whole)))
    u, v = [(1, 2), (2, 0), (0, 1)][drop]
    sign = 1.0 if whole[drop] >= 0 else -1.0
    flat = np.stack([points[:, u], sign * points[:, v]], 1)
    found = np.empty((len(points) - 2, 3), dtype=np.int64)
    tests = clip_ears(flat, most, found)
    if tests > most:
        raise SceneOverLimit("The scene has concave polygons with too many corners; triangulate them.")
    return found, tests
