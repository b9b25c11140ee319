"""Crop a recorded layer to what it contains: a tile, a convex polygon of at most eight corners, colours bled outwards.

Polygon  The rectangle, with a corner cut at 45 degrees where that saves at least 1/32 of its area; every set texel's
         square lies inside. A cut costs the viewer a triangle and saves it the texels beyond.
Bleeding Empty texels up to BLEED away from a set one take the mean colour of their set or already bled neighbours
         (rounded down), alpha stays 0: bilinear filtering then never mixes in black.
"""

import numpy as np
from numba import njit

BLEED = 2
_LEAST_SAVING = 32


@njit(cache=True)
def _extent(rgba: np.ndarray, out: np.ndarray) -> None:
    """Fill out: least and greatest x, y, x + y, x - y over the corners of all set texels; out[1] = -1 if none."""
    height, width = rgba.shape[0], rgba.shape[1]
    out[0], out[2], out[4], out[6] = width, height, width + height, width
    out[1], out[3], out[5], out[7] = -1, -1, -1, -height
    for j in range(height):
        for i in range(width):
            if rgba[j, i, 3] == 0:
                continue
            out[0], out[1] = min(out[0], i), max(out[1], i + 1)
            out[2], out[3] = min(out[2], j), max(out[3], j + 1)
            out[4], out[5] = min(out[4], i + j), max(out[5], i + j + 2)
            out[6], out[7] = min(out[6], i - j - 1), max(out[7], i + 1 - j)


@njit(cache=True)
def bleed(rgba: np.ndarray, passes: int) -> None:
    """Spread colours into the empty texels of a tile (h,w,4) u1, in place; alpha is untouched."""
    height, width = rgba.shape[0], rgba.shape[1]
    known = np.empty((height, width), np.uint8)
    for j in range(height):
        for i in range(width):
            known[j, i] = 1 if rgba[j, i, 3] > 0 else 0
    for turn in range(passes):
        for j in range(height):
            for i in range(width):
                if known[j, i] != 0:
                    continue
                n, r, g, b = 0, 0, 0, 0
                for y in range(max(j - 1, 0), min(j + 2, height)):
                    for x in range(max(i - 1, 0), min(i + 2, width)):
                        if 0 < known[y, x] <= turn + 1:  # known before this pass
                            n, r, g, b = n + 1, r + rgba[y, x, 0], g + rgba[y, x, 1], b + rgba[y, x, 2]
                if n > 0:
                    rgba[j, i, 0], rgba[j, i, 1], rgba[j, i, 2] = r // n, g // n, b // n
                    known[j, i] = turn + 2


def crop(rgba: np.ndarray) -> tuple[np.ndarray, tuple[int, int], np.ndarray] | None:
    """Return (tile (h,w,4) u1, (x0, y0), corners (Q,2) f64 counter-clockwise), or None if no texel is set.

    rgba  (height,width,4) u1, rows from low to high; the corners are in its texel coordinates
    """
    extent = np.empty(8, np.int64)
    _extent(rgba, extent)
    if extent[1] < 0:
        return None
    x0, x1, y0, y1 = (int(v) for v in extent[:4])
    tile = np.ascontiguousarray(rgba[y0:y1, x0:x1])
    bleed(tile, BLEED)
    return tile, (x0, y0), polygon(extent)


def polygon(extent: np.ndarray) -> np.ndarray:
    """Return the corners of the octagon x0 <= x <= x1, y0 <= y <= y1, s0 <= x + y <= s1, d0 <= x - y <= d1, given in
    this order, without the cuts that save little."""
    x0, x1, y0, y1, s0, s1, d0, d1 = (int(v) for v in extent)
    area = (x1 - x0) * (y1 - y0)

    def worth(cut: int) -> int:
        return cut if cut * cut * _LEAST_SAVING >= 2 * area else 0

    # legs of the cut triangles: low left, low right, high right, high left
    a, b, c, d = worth(s0 - x0 - y0), worth(x1 - y0 - d1), worth(x1 + y1 - s1), worth(d0 - x0 + y1)
    ring = [
        (x0 + a, y0), (x1 - b, y0), (x1, y0 + b), (x1, y1 - c), (x1 - c, y1), (x0 + d, y1), (x0, y1 - d), (x0, y0 + a),
    ]  # fmt: skip
    corners = [p for i, p in enumerate(ring) if p != ring[i - 1]]
    return np.array(corners, np.float64)
