"""Kernels of stage placementdb; `pack.py` documents and checks."""

import numpy as np
from numba import njit


@njit(cache=True)
def max_rects(size, side):
    """Return at (B,2) i64, the low corner of each block on a square page, -1 where it found no place.

    Blocks are tried in order; each goes into the low corner of the maximal free rectangle with the least short side left
    over, the first of those. size (B,2) i64, side i64: units, at least 1.

    Source: J. Jylänki, A Thousand Ways to Pack the Bin (2010), section 2.2, MAXRECTS-BSSF without rotation.
    """
    at = np.full(size.shape, -1, dtype=np.int64)
    free = np.empty((1024, 4), dtype=np.int64)  # low and high corners; none holds another
    free[0] = (0, 0, side, side)
    n_free = 1
    for b in range(len(size)):
        width, height = size[b]
        best, least = -1, side + 1
        for k in range(n_free):
            short = min(free[k, 2] - free[k, 0] - width, free[k, 3] - free[k, 1] - height)
            if 0 <= short < least:
                best, least = k, short
        if best < 0:
            continue
        x, y = free[best, 0], free[best, 1]
        at[b] = (x, y)
        rest = np.empty((4 * n_free + 4, 4), dtype=np.int64)
        cut = np.zeros(len(rest), dtype=np.bool_)
        n_rest = 0
        for k in range(n_free):
            left, low, right, high = free[k]
            if x >= right or x + width <= left or y >= high or y + height <= low:
                rest[n_rest] = free[k]
                n_rest += 1
                continue
            for side_of in range(4):
                piece = free[k].copy()
                if side_of == 0:
                    piece[2] = x
                elif side_of == 1:
                    piece[0] = x + width
                elif side_of == 2:
                    piece[1] = y + height
                else:
                    piece[3] = y
                if piece[0] < piece[2] and piece[1] < piece[3]:
                    rest[n_rest], cut[n_rest] = piece, True
                    n_rest += 1
        # Only a piece can lie in another: what was not cut lay in none, and every piece lies in what it was cut from.
        if n_rest > len(free):
            free = np.empty((2 * n_rest, 4), dtype=np.int64)
        n_free = 0
        for i in range(n_rest):
            held = False
            if cut[i]:
                for j in range(n_rest):
                    if (j != i and rest[j, 0] <= rest[i, 0] and rest[j, 1] <= rest[i, 1]
                            and rest[j, 2] >= rest[i, 2] and rest[j, 3] >= rest[i, 3]):  # fmt: skip
                        same = (rest[j] == rest[i]).all()
                        if not same or j < i:  # of equal ones the first stays
                            held = True
                            break
            if not held:
                free[n_free] = rest[i]
                n_free += 1
    return at
