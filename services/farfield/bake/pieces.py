"""Cut a layer into a few rectangles where that leaves out what is empty between them.

Problem  What a slab cuts out of a row of houses is set here and there: of a cropped rectangle only a quarter is. Bytes,
         video memory and drawn pixels count the whole of it.
Method   Of all straight cuts of all rectangles take the one that saves most, crop both sides, and go on while a cut saves
         more than further rows of the layer tables weigh and there are fewer than MOST. Where a surface goes through
         a cut, both sides keep the texel column it goes through: they overlap by one texel of equal content, and
         the viewer cannot see between them, however it rounds. (Corners that lie on another's edge would open.)
Errs     Every set texel is in some rectangle, so nothing is lost; sizes are counted as the pages store them, in whole
         units of ALIGN texels, so that nothing is saved on paper only.
Tried    500 layers of Telegraph Hill, bytes of rectangles and overheads without cuts = 1: cuts through empty columns only
         0.89 (1.3 rectangles a layer); through any 0.82 with two rectangles, 0.74 with three, 0.67 with six (2.4), 0.65
         with any number (2.8). Three keep the triangles within what the estimate of a layer counts. The whole hill,
         904 impostors: 154 to 116 MB, pages 10.8 to 9.9 MB, but tables 8.1 to 13.3 MB; with cuts that must save three rows
         and not one 117 MB and 12.3.
"""

import numpy as np
from numba import njit

from farfield.impostor.weight import LAYER_BYTES, TEXEL_BYTES

MOST = 3  # rectangles a layer: two triangles each are as many as the estimate counts
ROW_BYTES = 3 * LAYER_BYTES  # what a cut must save: an impostor stands in the tables of some three chunks
ALIGN = 8  # texels: what a page gives a block (farfield.placementdb.layout.ALIGN_TEXELS)


def rectangles(alpha: np.ndarray, most: int = MOST) -> np.ndarray:
    """Return (R,4) i64, R in 1..most: x0, x1, y0, y1 of tight rectangles that together hold all set texels.

    alpha  (h,w) u1, at least one texel set. In order of position: y0, then x0.
    """
    out = np.empty((most, 4), np.int64)
    n = _split(np.ascontiguousarray(alpha), out, most)
    found = out[:n]
    return found[np.lexsort((found[:, 0], found[:, 2]))]


@njit(cache=True)
def _weight(x0: int, x1: int, y0: int, y1: int) -> int:
    wide, high = (x1 - x0 + ALIGN - 1) // ALIGN * ALIGN, (y1 - y0 + ALIGN - 1) // ALIGN * ALIGN
    # Both count: what the measure of bytes sees, and what a page holds.
    return TEXEL_BYTES * (wide * high + (x1 - x0) * (y1 - y0)) // 2


@njit(cache=True)
def _tight(alpha: np.ndarray, x0: int, x1: int, y0: int, y1: int, out: np.ndarray) -> None:
    """Fill out with the extent of what is set in the rectangle; x1 = x0 if nothing is."""
    out[0], out[1], out[2], out[3] = x1, x0, y1, y0
    for j in range(y0, y1):
        for i in range(x0, x1):
            if alpha[j, i] != 0:
                out[0], out[1] = min(out[0], i), max(out[1], i + 1)
                out[2], out[3] = min(out[2], j), max(out[3], j + 1)


@njit(cache=True)
def _best_cut(alpha: np.ndarray, r: np.ndarray, cut: np.ndarray) -> int:
    """Fill cut (2,4) with the two tight sides of the best cut of r; return the bytes that it saves, 0 if none does."""
    best, whole = 0, _weight(r[0], r[1], r[2], r[3]) - ROW_BYTES
    sides = (r[1] - r[0], r[3] - r[2])
    for axis in range(2):
        n, other = sides[axis], sides[1 - axis]
        low, high = np.full(n, other), np.full(n, -1)  # extent across of each line of texels
        for j in range(sides[1]):
            for i in range(sides[0]):
                if alpha[r[2] + j, r[0] + i] != 0:
                    k, t = (i, j) if axis == 0 else (j, i)
                    low[k], high[k] = min(low[k], t), max(high[k], t)
        # Extents of lines [0, k] and [k, n): a cut at k has line k on both sides, or on none if it is empty.
        after_low, after_high, after_first = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
        a, b, c = other, -1, n
        for k in range(n - 1, -1, -1):
            if high[k] >= 0:
                a, b, c = min(a, low[k]), max(b, high[k]), k
            after_low[k], after_high[k], after_first[k] = a, b, c
        a, b, c = other, -1, -1
        for k in range(n - 1):
            if high[k] >= 0:
                a, b, c = min(a, low[k]), max(b, high[k]), k
            if k == 0:
                continue
            first = after_first[k]
            here = _weight(0, c + 1, a, b + 1) + _weight(first, n, after_low[k], after_high[k] + 1)
            if axis == 1:
                here = _weight(a, b + 1, 0, c + 1) + _weight(after_low[k], after_high[k] + 1, first, n)
            if whole - here > best:
                best = whole - here
                if axis == 0:
                    cut[0] = r[0], r[0] + c + 1, r[2] + a, r[2] + b + 1
                    cut[1] = r[0] + first, r[1], r[2] + after_low[k], r[2] + after_high[k] + 1
                else:
                    cut[0] = r[0] + a, r[0] + b + 1, r[2], r[2] + c + 1
                    cut[1] = r[0] + after_low[k], r[0] + after_high[k] + 1, r[2] + first, r[3]
    return best


@njit(cache=True)
def _split(alpha: np.ndarray, out: np.ndarray, most: int) -> int:
    saved, cuts = np.zeros(most, np.int64), np.zeros((most, 2, 4), np.int64)
    _tight(alpha, 0, alpha.shape[1], 0, alpha.shape[0], out[0])
    saved[0] = _best_cut(alpha, out[0], cuts[0]) if most > 1 else 0
    n = 1
    while n < most:
        k = int(np.argmax(saved[:n]))
        if saved[k] <= 0:
            break
        out[n], out[k] = cuts[k, 1], cuts[k, 0]
        for m in (n, k):
            saved[m] = _best_cut(alpha, out[m], cuts[m])
        n += 1
    return n
