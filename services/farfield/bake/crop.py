"""Crop a recorded layer to what it contains: tiles, each in a convex polygon of few corners, colours bled outwards.

Tiles    Up to three (`pieces`), as many as one polygon of eight corners has triangles.

Polygon  The tighter of two, both around every set texel's square. The rectangle with its corners cut at 45 degrees; and
         the convex hull of the squares, from which the edge that adds least area is taken away, its neighbours
         prolonged, until there are few enough. Either loses what saves less than 1/32 of the rectangle: a cut costs the viewer
         a triangle and saves it the texels beyond.
Bleeding Empty texels up to BLEED away from a set one take the mean colour of their set or already bled neighbours
         (rounded down), alpha stays 0: bilinear filtering then never mixes in black.
"""

import numpy as np
from numba import njit

from farfield.bake.pieces import MOST, rectangles

BLEED = 2
_LEAST_SAVING = 32
MOST_CORNERS = (8, 5, 4)  # of a layer's one, two or three polygons: six triangles in all


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


Cropped = tuple[np.ndarray, tuple[int, int], np.ndarray]


def crop(rgba: np.ndarray, most: int = MOST) -> list[Cropped]:
    """Return (tile (h,w,4) u1, (x0, y0), corners (Q,2) f64 counter-clockwise) of each of 1 to `most` pieces, none if no
    texel is set.

    rgba  (height,width,4) u1, rows from low to high; the corners are in its texel coordinates
    """
    if not rgba[..., 3].any():
        return []
    found = rectangles(rgba[..., 3], most)
    return [_cropped(rgba, rectangle, MOST_CORNERS[len(found) - 1]) for rectangle in found.tolist()]


def _cropped(rgba: np.ndarray, rectangle: list[int], corners: int) -> Cropped:
    x0, x1, y0, y1 = rectangle
    tile = np.ascontiguousarray(rgba[y0:y1, x0:x1])
    extent = np.empty(8, np.int64)
    _extent(tile, extent)
    bleed(tile, BLEED)
    at = np.array([x0, y0], np.float64)
    return tile, (x0, y0), tightest(tile[..., 3], extent, corners) + at


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


def tightest(alpha: np.ndarray, extent: np.ndarray, most: int) -> np.ndarray:
    """Return the corners (Q,2) f64, Q <= most, counter-clockwise, of the smaller of octagon and reduced hull.

    alpha  (h,w) u1, cropped to what is set; extent  of it; most  >= 4
    """
    octagon = polygon(extent)
    height, width = alpha.shape
    if len(octagon) > most:
        octagon = np.array([(0, 0), (width, 0), (width, height), (0, height)], np.float64)
    corner = np.empty((4 * height + 4, 2))
    n = _reduced(corner, _hull(alpha, corner), width, height, most)
    hull = corner[:n]
    if n <= most and _LEAST_SAVING * (_area(octagon) - _area(hull)) > (n - len(octagon)) * width * height:
        return hull
    return octagon


@njit(cache=True)
def _area(corner: np.ndarray) -> float:
    total = 0.0
    for k in range(len(corner)):
        a, b = corner[k], corner[(k + 1) % len(corner)]
        total += a[0] * b[1] - a[1] * b[0]
    return total / 2


@njit(cache=True)
def _turn(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@njit(cache=True)
def _hull(alpha: np.ndarray, corner: np.ndarray) -> int:
    """Fill corner with the convex hull of the set texels' squares, counter-clockwise; return how many. Exact: integers."""
    height, width = alpha.shape
    n = 0
    for side in range(2):  # the right side upwards, then the left side downwards
        base = n
        for k in range(height):
            j = k if side == 0 else height - 1 - k
            at = -1
            for i in range(width):
                x = width - 1 - i if side == 0 else i
                if alpha[j, x] != 0:
                    at = x
                    break
            if at < 0:
                continue
            px = float(at + 1 if side == 0 else at)
            for step in range(2):
                py = float(j + (step if side == 0 else 1 - step))
                while n - base >= 2 and (
                    _turn(corner[n - 2, 0], corner[n - 2, 1], corner[n - 1, 0], corner[n - 1, 1], px, py) <= 0
                ):
                    n -= 1
                corner[n, 0], corner[n, 1] = px, py
                n += 1
    return n


@njit(cache=True)
def _reduced(corner: np.ndarray, n: int, width: int, height: int, most: int) -> int:
    """Take edges away from a convex polygon, those that add least area first; return how many corners are left.

    More than `most` are left where every further one would reach out of the rectangle.
    """
    worth = width * height / _LEAST_SAVING
    while n > 3:
        best, least, at_x, at_y = -1, np.inf, 0.0, 0.0
        for k in range(n):
            a, b, c, d = corner[(k + n - 1) % n], corner[k], corner[(k + 1) % n], corner[(k + 2) % n]
            ux, uy, vx, vy = b[0] - a[0], b[1] - a[1], c[0] - d[0], c[1] - d[1]
            cross = ux * vy - uy * vx
            if cross <= 0:
                continue  # they do not meet beyond the edge
            t = ((c[0] - b[0]) * vy - (c[1] - b[1]) * vx) / cross
            x, y = b[0] + t * ux, b[1] + t * uy
            if x < 0 or y < 0 or x > width or y > height:
                continue
            added = abs(_turn(b[0], b[1], c[0], c[1], x, y)) / 2
            if added < least:
                best, least, at_x, at_y = k, added, x, y
        if best < 0 or (n <= most and least > worth):
            break
        corner[best, 0], corner[best, 1] = at_x, at_y
        gone = (best + 1) % n
        for k in range(gone, n - 1):
            corner[k, 0], corner[k, 1] = corner[k + 1, 0], corner[k + 1, 1]
        n -= 1
    return n
