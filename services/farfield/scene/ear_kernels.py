"""Ears of one polygon in the plane. Float64, one fixed order."""

import numpy as np
from numba import njit


@njit(cache=True)
def _turn(flat, a, b, c):
    return (flat[b, 0] - flat[a, 0]) * (flat[c, 1] - flat[a, 1]) - (flat[b, 1] - flat[a, 1]) * (flat[c, 0] - flat[a, 0])


@njit(cache=True)
def _same(flat, a, b):
    return flat[a, 0] == flat[b, 0] and flat[a, 1] == flat[b, 1]


@njit(cache=True)
def clip_ears(flat, most, found):
    """Cut the first ear off, again and again, and fan what has none; return the corners tested, above `most` where it gave up.

    flat   (n,2) f64 corners, counter-clockwise; found (n-2,3) int64, filled
    """
    left = np.arange(len(flat))
    n, made, tests = len(flat), 0, 0
    while n > 3:
        cut = -1
        for k in range(n):
            a, b, c = left[k - 1 if k > 0 else n - 1], left[k], left[k + 1 if k + 1 < n else 0]
            if not _turn(flat, a, b, c) > 0.0:
                continue
            is_ear = True
            for j in range(n):
                p = left[j]
                tests += 1
                if p in (a, b, c) or _same(flat, p, a) or _same(flat, p, b) or _same(flat, p, c):
                    continue
                if _turn(flat, a, b, p) >= 0.0 and _turn(flat, b, c, p) >= 0.0 and _turn(flat, c, a, p) >= 0.0:
                    is_ear = False
                    break
            if tests > most:
                return tests
            if is_ear:
                cut = k
                found[made, 0], found[made, 1], found[made, 2] = a, b, c
                break
        if cut < 0:
            break
        made += 1
        for k in range(cut, n - 1):
            left[k] = left[k + 1]
        n -= 1
    for k in range(1, n - 1):
        found[made, 0], found[made, 1], found[made, 2] = left[0], left[k], left[k + 1]
        made += 1
    return tests
