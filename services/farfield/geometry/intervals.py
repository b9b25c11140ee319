"""Direction intervals: the cells of a quadtree on the six faces of the direction cube.

Face     0..5 = +x, -x, +y, -y, +z, -z: the axis of the largest |component|, ties to the smallest axis.
         On the face of axis m, u and v are the next two axes in cyclic order ((m+1) % 3, (m+2) % 3), without a sign:
         the ratios are d[u] / |d[m]| and d[v] / |d[m]|, both in [-1, 1].
Interval A face is cut into n x n intervals of equal angle (n = 90 / interval_deg) at the ratios `edges(n)`; interval
         (i, j) holds edges[i] <= ratio_u < edges[i+1], edges[j] <= ratio_v < edges[j+1] (the last also its upper end).
         Its id is (face * n + j) * n + i. Coarser levels of the quadtree are the same with n / 2, n / 4, ... 1.
The edges are stored in the manifest: both readers compare the same float64 numbers and no arc tangent decides.
"""

import numpy as np


def edges(n: int) -> np.ndarray:
    """Return the (n+1,) f64 tangents of -45 .. 45 degrees in n equal angles; exactly antisymmetric, -1 and 1 at the ends."""
    half = np.tan(np.pi / 2 / n * np.arange(n // 2 + 1) - (np.pi / 4 if n % 2 == 0 else 0.0)) if n > 1 else None
    if half is None:
        return np.array([-1.0, 1.0])
    assert n % 2 == 0
    half[0], half[-1] = -1.0, 0.0
    return np.concatenate([half, -half[-2::-1]])


def face_axes(face: int) -> tuple[int, int, int, float]:
    """Return (m, u, v, sign) of a face."""
    m = face // 2
    return m, (m + 1) % 3, (m + 2) % 3, 1.0 if face % 2 == 0 else -1.0


def find_interval(direction: np.ndarray, n: int) -> int:
    """Return the interval id of a direction of any length but 0."""
    d = np.asarray(direction, dtype=np.float64)
    m = int(np.argmax(np.abs(d)))
    face = 2 * m + (1 if d[m] < 0 else 0)
    _, u, v, _ = face_axes(face)
    inner = edges(n)[1:-1]
    i = int(np.searchsorted(inner, d[u] / abs(d[m]), side="right"))
    j = int(np.searchsorted(inner, d[v] / abs(d[m]), side="right"))
    return (face * n + j) * n + i


def split_id(interval: int, n: int) -> tuple[int, int, int]:
    """Return (face, i, j) of an interval id."""
    return interval // (n * n), interval % n, interval // n % n


def interval_bounds(face: int, i: int, j: int, n: int) -> np.ndarray:
    """Return [[u0, u1], [v0, v1]], the ratios between which the interval lies."""
    e = edges(n)
    return np.array([[e[i], e[i + 1]], [e[j], e[j + 1]]])


def direction_at(face: int, ratio_u: float, ratio_v: float) -> np.ndarray:
    """Return the unit direction at the ratios of a face."""
    m, u, v, sign = face_axes(face)
    d = np.empty(3)
    d[m], d[u], d[v] = sign, ratio_u, ratio_v
    return d / np.linalg.norm(d)
