"""Numba kernels of the geometry leaf."""

import numpy as np
from numba import njit


@njit(cache=True)
def convex_hull(x, y, order):
    """Return the indices of the strictly convex hull, counter-clockwise; `order` sorts the points by (x, y)."""
    n = len(order)
    hull = np.empty(2 * n + 1, dtype=np.int64)
    size = 0
    for sweep in range(2):
        first = size
        for k in range(n):
            i = order[k] if sweep == 0 else order[n - 1 - k]
            while size - first >= 2:
                a, b = hull[size - 2], hull[size - 1]
                if (x[b] - x[a]) * (y[i] - y[a]) - (y[b] - y[a]) * (x[i] - x[a]) > 0:
                    break
                size -= 1
            hull[size] = i
            size += 1
        size -= 1  # the last point of a sweep is the first of the other
    return hull[:size].copy()


@njit(cache=True)
def accepts(normals, start, stop, pad, qx, qy, qz, gx, gy, gz, reach):
    """Return -1 if no normal of [start, stop) rejects the box (centre q, half sizes g), else the one that does.

    reach = |q| + |g|. normals (K,6): a unit normal and its absolute values.
    """
    slack = pad * reach
    for k in range(start, stop):
        n = normals[k]
        inside = n[0] * qx + n[1] * qy + n[2] * qz + (n[3] * gx + n[4] * gy + n[5] * gz) + slack
        if inside < 0:
            return k
    return -1
