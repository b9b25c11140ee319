"""Record every texel that a layer's geometry touches, and which triangle shows there: exact, in integers.

Problem  A texel that a surface touches only at its edge must be recorded too, or gaps open between layers. Which texels
         those are must not depend on the machine: the shader (`farfield.bake.gl`) and this file find the same ones.
Method   Pieces have whole 1/256 texel coordinates and count as closed, and so do texels. Triangle and square touch
         iff none of the axes x, y and the three edge normals separates them. Along the normal of the edge from
         (x, y) with the step (dx, dy), with L = dx j - dy i for texel (i, j), that is lo <= L <= hi with integer lo, hi
         (`edge_bounds`): each row of texels is one span. Segments and points are triangles whose hi binds, too.
         Of the pieces in a texel the nearest that covers its centre shows, as in a picture taken from the eye; where
         none does, the nearest that faces the eye, else the nearest. Depth is that of the point of the *source*
         triangle next to the texel's centre (not of the piece: both slabs at a border then see the same point),
         relative to the slab, clamped to it, in 2**20 steps; ties go to the lower piece. It is computed in float32 in
         one fixed order of products and sums, which the shader repeats, so that even the depth test agrees.
         A masked material records a texel iff its alpha at that point reaches the cutoff; this is always done here.
         Closed pieces and texels make the texels of a connected surface 4-connected: where a path steps diagonally it
         passes the common corner, and that touches all four. So the diagonal steps that Jeschke and Wimmer close by
         hand (2002, section 2.2) do not arise.
Tried    The nearest piece always: back walls, which end at the same edges as the front ones, draw dark outlines.
"""

from typing import Any

import numpy as np
from numba import njit

from farfield.bake.records import Pieces, Slabs, Sources, Surface
from farfield.bake.sample import alpha_at

F0, F1, DEPTHS = np.float32(0), np.float32(1), np.float32(1 << 20)
NONE = np.uint32(0xFFFFFFFF)


@njit(cache=True)
def edge_bounds(x: int, y: int, dx: int, dy: int, twice: int) -> tuple[int, int]:
    """Return (lo, hi): texel (i, j) is not separated along this edge's normal iff lo <= dx j - dy i <= hi.

    The edge starts at (x, y), 1/256 texels; twice >= 0 is twice the triangle's area. At a texel's corner (256 i, 256 j)
    the edge function is 256 L - (dx y - dy x), positive inside; over the square it varies by 256 dx and 256 -dy.
    """
    k = dx * y - dy * x
    lo = -((-k) // 256) - (max(dx, 0) + max(-dy, 0))  # largest value >= 0
    hi = (twice + k) // 256 - (min(dx, 0) + min(-dy, 0))  # smallest value <= twice
    return lo, hi


@njit(cache=True)
def centre_bound(x: int, y: int, dx: int, dy: int) -> int:
    """Return the least dx j - dy i for which the centre of texel (i, j) is on the inner side of the edge."""
    return -(((128 * (dx - dy)) - (dx * y - dy * x)) // 256)


@njit(cache=True)
def _divide_up(a: int, b: int) -> int:
    return -((-a) // b)


@njit(cache=True)
def span(j: int, lo: int, hi: int, dx: int, dy: int, first: int, last: int) -> tuple[int, int]:
    """Return the texels first <= i <= last of row j with lo <= dx j - dy i <= hi, as (first, last)."""
    if dy == 0:
        if lo <= dx * j <= hi:
            return first, last
        return 1, 0
    if dy > 0:
        return max(first, _divide_up(dx * j - hi, dy)), min(last, (dx * j - lo) // dy)
    return max(first, _divide_up(lo - dx * j, -dy)), min(last, (hi - dx * j) // -dy)


@njit(cache=True)
def depth_plane(q: Any, v0: np.float32, v1: np.float32, v2: np.float32) -> tuple[np.float32, np.float32]:
    """Return the slopes of the depth over snapped coordinates; 0 for a triangle without area."""
    x1, y1 = np.int64(q[2] - q[0]), np.int64(q[3] - q[1])
    x2, y2 = np.int64(q[4] - q[0]), np.int64(q[5] - q[1])
    twice = float(x1 * y2 - x2 * y1)
    if twice == 0:
        return F0, F0
    a, b = float(v1) - float(v0), float(v2) - float(v0)
    return np.float32((a * y2 - b * y1) / twice), np.float32((b * x1 - a * x2) / twice)


@njit(cache=True)
def depth_key(i: int, j: int, q: Any, r: Any, v0: np.float32, v1: np.float32, v2: np.float32,
              gx: np.float32, gy: np.float32, away: bool) -> np.uint32:  # fmt: skip
    """Return what decides which piece shows in texel (i, j), the least: depth of source triangle q in steps of 2**-20
    of the slab, + 2**21 where its centre is not covered, + 2**22 where also the eye sees its back; r as
    Sources.reciprocal.
    """
    cx, cy = 256 * i + 128, 256 * j + 128
    inside, twice = True, 0
    for e in range(3):
        f = (e + 1) % 3
        dx, dy = np.int64(q[2 * f] - q[2 * e]), np.int64(q[2 * f + 1] - q[2 * e + 1])
        height = dx * (cy - q[2 * e + 1]) - dy * (cx - q[2 * e])
        inside = inside and height >= 0
        twice += height
    if inside and twice > 0:
        best = (gx * np.float32(cx - q[0]) + gy * np.float32(cy - q[1])) + v0
        best = max(min(best, max(v0, max(v1, v2))), min(v0, min(v1, v2)))
    else:
        best, nearest = F0, np.float32(np.inf)
        for e in range(3):
            f = (e + 1) % 3
            ex, ey = np.float32(q[2 * f] - q[2 * e]), np.float32(q[2 * f + 1] - q[2 * e + 1])
            px, py = np.float32(cx - q[2 * e]), np.float32(cy - q[2 * e + 1])
            t = min(max((px * ex + py * ey) * r[e], F0), F1)
            rx, ry = px - t * ex, py - t * ey
            d = rx * rx + ry * ry
            if d < nearest:
                va = v0 if e == 0 else (v1 if e == 1 else v2)
                vb = v1 if e == 0 else (v2 if e == 1 else v0)
                nearest, best = d, va + t * (vb - va)
    key = np.uint32(min(max(best, F0), F1) * DEPTHS)
    if inside and twice > 0:
        return key
    return np.uint32(key + (2 << 21 if away else 1 << 21))


@njit(cache=True)
def slab_depth(inverse: float, near: float, far: float) -> np.float32:
    """Return 0 at the slab's near end, 1 at its far end, linear in 1 / z; may lie outside [0, 1]."""
    if near <= far:
        return F0
    return np.float32((near - inverse) / (near - far))


@njit(cache=True)
def piece_edges(p: Any, out: Any) -> int:
    """Fill out (3,4) int64 with x, y, dx, dy of the piece's edges, counter-clockwise; return twice its area."""
    x0, y0, x1, y1 = np.int64(p[0]), np.int64(p[1]), np.int64(p[2]), np.int64(p[3])
    x2, y2 = np.int64(p[4]), np.int64(p[5])
    twice = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    if twice < 0:
        twice, x1, y1, x2, y2 = -twice, x2, y2, x1, y1
    out[0, 0], out[0, 1], out[0, 2], out[0, 3] = x0, y0, x1 - x0, y1 - y0
    out[1, 0], out[1, 1], out[1, 2], out[1, 3] = x1, y1, x2 - x1, y2 - y1
    out[2, 0], out[2, 1], out[2, 2], out[2, 3] = x2, y2, x0 - x2, y0 - y2
    return int(twice)


@njit(cache=True)
def _record(sources: Any, pieces: Any, slabs: Any, surface: Any, first_layer: int, last_layer: int, masked: bool,
            sheet: Any, keys: Any) -> None:  # fmt: skip
    edge = np.empty((3, 4), np.int64)
    lo, hi = np.empty(3, np.int64), np.empty(3, np.int64)
    for k in range(first_layer, last_layer):
        low, size = slabs.low[k], slabs.size[k]
        ax, ay = slabs.at[k, 0] - low[0], slabs.at[k, 1] - low[1]
        near, far = slabs.inverse_near[k], slabs.inverse_far[k]
        for f in range(pieces.row[k], pieces.row[k + 1]):
            s = pieces.source[f]
            if surface.masked[sources.material[s]] != masked:
                continue
            p = pieces.snapped[f]
            twice = piece_edges(p, edge)
            for e in range(3):
                lo[e], hi[e] = edge_bounds(edge[e, 0], edge[e, 1], edge[e, 2], edge[e, 3], twice)
            i0 = max(-((-min(p[0], p[2], p[4])) // 256) - 1, low[0])
            i1 = min(max(p[0], p[2], p[4]) // 256, low[0] + size[0] - 1)
            j0 = max(-((-min(p[1], p[3], p[5])) // 256) - 1, low[1])
            j1 = min(max(p[1], p[3], p[5]) // 256, low[1] + size[1] - 1)
            q, r = sources.snapped[s], sources.reciprocal[s]
            v0 = slab_depth(sources.inverse[s, 0], near, far)
            v1 = slab_depth(sources.inverse[s, 1], near, far)
            v2 = slab_depth(sources.inverse[s, 2], near, far)
            gx, gy = depth_plane(q, v0, v1, v2)
            for j in range(j0, j1 + 1):
                a, b = i0, i1
                for e in range(3):
                    a, b = span(j, lo[e], hi[e], edge[e, 2], edge[e, 3], a, b)
                for i in range(a, b + 1):
                    if masked and not alpha_at(sources, surface, s, i, j):
                        continue
                    key = depth_key(i, j, q, r, v0, v1, v2, gx, gy, sources.away[s])
                    x, y = i + ax, j + ay
                    if key < keys[y, x] or (key == keys[y, x] and np.uint32(f) < sheet[y, x] - np.uint32(1)):
                        keys[y, x] = key
                        sheet[y, x] = np.uint32(f + 1)


@njit(cache=True)
def _find_keys(sources: Any, pieces: Any, slabs: Any, first_layer: int, last_layer: int, sheet: Any, keys: Any) -> None:
    for k in range(first_layer, last_layer):
        near, far = slabs.inverse_near[k], slabs.inverse_far[k]
        for y in range(slabs.at[k, 1], slabs.at[k, 1] + slabs.size[k, 1]):
            for x in range(slabs.at[k, 0], slabs.at[k, 0] + slabs.size[k, 0]):
                if sheet[y, x] == 0:
                    continue
                s = pieces.source[sheet[y, x] - 1]
                v0 = slab_depth(sources.inverse[s, 0], near, far)
                v1 = slab_depth(sources.inverse[s, 1], near, far)
                v2 = slab_depth(sources.inverse[s, 2], near, far)
                gx, gy = depth_plane(sources.snapped[s], v0, v1, v2)
                i, j = x - slabs.at[k, 0] + slabs.low[k, 0], y - slabs.at[k, 1] + slabs.low[k, 1]
                keys[y, x] = depth_key(
                    i, j, sources.snapped[s], sources.reciprocal[s], v0, v1, v2, gx, gy, sources.away[s]
                )


def record(
    sources: Sources,
    pieces: Pieces,
    slabs: Slabs,
    surface: Surface,
    layers: tuple[int, int],
    sheet_size: tuple[int, int],
) -> np.ndarray:
    """Return the sheet (height, width) u32 of layers [a, b): 0 where empty, else 1 + the piece that shows.

    sheet_size  width, height; every layer's rectangle (slabs.at, slabs.size) lies in it, none overlap
    """
    sheet = np.zeros(sheet_size[::-1], np.uint32)
    keys = np.full(sheet_size[::-1], NONE)
    _record(sources, pieces, slabs, surface, *layers, False, sheet, keys)
    if _any_masked(sources, surface):
        _record(sources, pieces, slabs, surface, *layers, True, sheet, keys)
    return sheet


def add_masked(
    sheet: np.ndarray, sources: Sources, pieces: Pieces, slabs: Slabs, surface: Surface, layers: tuple[int, int]
) -> None:
    """Add the pieces with masked materials to a sheet that holds the opaque ones, in place."""
    if _any_masked(sources, surface):
        keys = np.full(sheet.shape, NONE)
        _find_keys(sources, pieces, slabs, *layers, sheet, keys)
        _record(sources, pieces, slabs, surface, *layers, True, sheet, keys)


def _any_masked(sources: Sources, surface: Surface) -> bool:
    return bool(surface.masked.any() and surface.masked[sources.material].any())
