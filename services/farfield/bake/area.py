"""What shows in each texel of a layer: the mean colour of the surfaces in it, and the share of it that they cover.

Problem  A texel is recorded wherever a surface touches it, even at a corner. Coloured by the one surface that shows at
         its centre and drawn as a full square, it makes silhouettes half a texel fatter, and a sliver of a roof seen
         edge-on as heavy as the wall beside it.
Method   `sample`: 4 x 4 points a texel. At each the nearest piece of the layer that covers it shows; each piece is shaded
         once for all of its points (a textured one once a quarter, at half a texel's detail); colours are averaged in
         linear light. Where no point is covered, the recorded piece is shaded at its point next to the centre.
         `compose`, over all layers of an impostor: where a surface goes on in the layer behind or in front (the texel is
         set there, too), the texel is drawn in full, lest a gap opens between the two when the eye moves; points that
         its own layer leaves empty then take the colour seen there in those layers, the nearer ones first. Where a
         surface ends, the texel is drawn to the share of its points that are covered, in quarters.
Ends     A share does not say which part of the texel is covered: two halves that complete each other are drawn on the
         same samples. So where another surface of the cluster ends, too, in any layer (a wall in front of the crest of
         a hill), in this texel or one around it, since layers shift against each other, both are drawn in full.
Errs     Towards covering: never less than a quarter, in full where layers adjoin, where two surfaces end, or where
         another object's surface is (`beside`), for what lies side by side in different impostors must leave no seam.
Tried    FLIP over covered pixels on Telegraph Hill: docs/decisions/0012.
"""

from typing import Any

import numpy as np
from numba import njit

from farfield.bake.coverage import depth_plane, edge_bounds, piece_edges, slab_depth, span
from farfield.bake.records import Pieces, Slabs, Sources, Surface
from farfield.bake.sample import alpha_at
from farfield.bake.shade import depth_code, encode, shade_at

POINTS = 16  # a texel
BAND = 1 << 14  # texels whose points are held at once: 2 MB
NOTHING = np.uint32(0xFFFFFFFF)
FULL = np.int64(0xFFFF)


def layer_starts(slabs: Slabs) -> np.ndarray:
    """Return (K+1,) i64: texels of layer k are [start[k], start[k+1]) of the arrays here, rows from low to high."""
    return np.concatenate([[0], np.cumsum(slabs.size.astype(np.int64).prod(1))]).astype(np.int64)


@njit(cache=True)
def sample_band(sources: Any, pieces: Any, slabs: Any, surface: Any, k: int, row: int, last_row: int, owner: Any,
                 depth: Any) -> None:  # fmt: skip
    """Fill owner and depth (texels of the rows, 16) of layer k with the nearest piece at each point."""
    edge = np.empty((3, 4), np.int64)
    lo, hi, e0 = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.int64)
    low, size = slabs.low[k], slabs.size[k]
    near, far = slabs.inverse_near[k], slabs.inverse_far[k]
    for f in range(pieces.row[k], pieces.row[k + 1]):
        p = pieces.snapped[f]
        j0 = max(-((-min(p[1], p[3], p[5])) // 256) - 1, row)
        j1 = min(max(p[1], p[3], p[5]) // 256, last_row - 1)
        if j0 > j1:
            continue
        twice = piece_edges(p, edge)
        if twice == 0:
            continue
        for e in range(3):
            lo[e], hi[e] = edge_bounds(edge[e, 0], edge[e, 1], edge[e, 2], edge[e, 3], twice)
        i0 = max(-((-min(p[0], p[2], p[4])) // 256) - 1, low[0])
        i1 = min(max(p[0], p[2], p[4]) // 256, low[0] + size[0] - 1)
        s = pieces.source[f]
        masked = surface.masked[sources.material[s]]
        q = sources.snapped[s]
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
                t = (j - row) * size[0] + i - low[0]
                for e in range(3):
                    e0[e] = edge[e, 2] * (256 * j + 32 - edge[e, 1]) - edge[e, 3] * (256 * i + 32 - edge[e, 0])
                z0 = gx * np.float32(256 * i + 32 - q[0]) + gy * np.float32(256 * j + 32 - q[1]) + v0
                for y in range(4):
                    for x in range(4):
                        inside = True
                        for e in range(3):
                            inside = inside and e0[e] + 64 * (edge[e, 2] * y - edge[e, 3] * x) >= 0
                        if inside:
                            z = z0 + np.float32(64 * x) * gx + np.float32(64 * y) * gy
                            if z < depth[t, 4 * y + x]:
                                depth[t, 4 * y + x] = z
                                owner[t, 4 * y + x] = np.uint32(f)


@njit(cache=True)
def _sample(sources: Any, pieces: Any, slabs: Any, surface: Any, first: int, last: int, sheet: Any, start: Any,
            rgba: Any, points: Any, owner: Any, depth: Any) -> None:  # fmt: skip
    out, uv, shown, color, total = np.empty(10), np.empty((3, 2)), np.empty(4), np.empty(3), np.empty(3)
    for k in range(first, last):
        low, size, at = slabs.low[k], slabs.size[k], slabs.at[k]
        if size[0] == 0:
            continue
        near, far = slabs.inverse_near[k], slabs.inverse_far[k]
        rows = max(1, BAND // size[0])
        for row in range(0, size[1], rows):
            until = min(row + rows, size[1])
            owner[: (until - row) * size[0]] = NOTHING
            depth[: (until - row) * size[0]] = np.inf
            sample_band(sources, pieces, slabs, surface, k, low[1] + row, low[1] + until, owner, depth)
            for y in range(row, until):
                for x in range(size[0]):
                    found = sheet[at[1] + y, at[0] + x]
                    if found == 0:
                        continue
                    t, here = start[k] + y * size[0] + x, owner[(y - row) * size[0] + x]
                    cx, cy = 256.0 * (x + low[0]), 256.0 * (y + low[1])
                    left, n = 0, 0
                    for c in range(POINTS):
                        if here[c] != NOTHING:
                            left |= 1 << c
                            n += 1
                    points[t] = left
                    total[:] = 0.0
                    while left:
                        c = 0
                        while not left >> c & 1:
                            c += 1
                        s = pieces.source[here[c]]
                        material = sources.material[s]
                        textured = surface.texture[material] >= 0 or surface.emissive_texture[material] >= 0
                        many, px, py = 0, 0, 0
                        for d in range(c, POINTS):
                            if not left >> d & 1 or pieces.source[here[d]] != s:
                                continue
                            if textured and (d & 2 != c & 2 or d & 8 != c & 8):
                                continue  # of another quarter
                            left &= ~(1 << d)
                            many, px, py = many + 1, px + d % 4, py + d // 4
                        shade_at(sources, surface, s, cx + 32 + 64 * px / many, cy + 32 + 64 * py / many,
                                 0.5 if textured else 1.0, out, uv, shown, color)  # fmt: skip
                        for a in range(3):
                            total[a] += color[a] * many
                    s = pieces.source[found - 1]
                    if n == 0:
                        n = 1
                        shade_at(sources, surface, s, cx + 128, cy + 128, 1.0, out, uv, shown, total)
                    for a in range(3):
                        rgba[t, a] = encode(surface.encode, total[a] / n)
                    rgba[t, 3] = depth_code(sources, s, cx + 128, cy + 128, near, far, out)


@njit(cache=True)
def _ones(bits: int) -> int:
    n = 0
    while bits:
        bits &= bits - 1
        n += 1
    return n


@njit(cache=True)
def _find(slabs: Any, start: Any, k: int, i: int, j: int) -> int:
    """Return the texel (i, j) of layer k, -1 where it has none."""
    if k < 0 or k >= len(slabs.size):
        return -1
    x, y = i - slabs.low[k, 0], j - slabs.low[k, 1]
    if x < 0 or y < 0 or x >= slabs.size[k, 0] or y >= slabs.size[k, 1]:
        return -1
    return int(start[k] + y * slabs.size[k, 0] + x)


@njit(cache=True)
def _other_ends(slabs: Any, start: Any, rgba: Any, points: Any, k: int, i: int, j: int) -> bool:
    """Return whether a surface of another layer ends in the texel (i, j) or one of the eight around it."""
    for m in range(len(slabs.size)):
        x, y = i - slabs.low[m, 0], j - slabs.low[m, 1]
        wide, high = slabs.size[m, 0], slabs.size[m, 1]
        if m == k or x < -1 or y < -1 or x > wide or y > high:
            continue
        for b in range(max(y - 1, 0), min(y + 2, high)):
            for a in range(max(x - 1, 0), min(x + 2, wide)):
                u = start[m] + b * wide + a
                if rgba[u, 3] != 0 and np.int64(points[u]) != FULL:
                    return True
    return False


@njit(cache=True)
def _compose(slabs: Any, start: Any, beside: Any, rgba: Any, points: Any, decode: Any, thresholds: Any,
             out: Any) -> None:  # fmt: skip
    total = np.empty(3)
    for k in range(len(slabs.size)):
        low, size = slabs.low[k], slabs.size[k]
        for y in range(size[1]):
            for x in range(size[0]):
                t = start[k] + y * size[0] + x
                if rgba[t, 3] == 0:
                    continue
                i, j = x + low[0], y + low[1]
                own = np.int64(points[t])
                left, n = FULL & ~own, _ones(own)
                for a in range(3):
                    total[a] = decode[rgba[t, a]] * n
                joined = beside[t] != 0
                for step in (-1, 1):
                    near = k + step
                    u = _find(slabs, start, near, i, j)
                    while u >= 0 and rgba[u, 3] != 0:
                        joined = True
                        seen = left & np.int64(points[u])
                        m = _ones(seen)
                        if m:
                            left, n = left & ~seen, n + m
                            for a in range(3):
                                total[a] += decode[rgba[u, a]] * m
                        near += step
                        u = _find(slabs, start, near, i, j)
                for a in range(3):
                    out[t, a] = encode(thresholds, total[a] / n) if joined and n > 0 else rgba[t, a]
                quarters = 4 if joined else min(max((_ones(own) + 2) // 4, 1), 4)
                if quarters < 4 and _other_ends(slabs, start, rgba, points, k, i, j):
                    quarters = 4
                out[t, 3] = 4 * (rgba[t, 3] - 1) + quarters


def sample(sources: Sources, pieces: Pieces, slabs: Slabs, surface: Surface, layers: tuple[int, int],
           sheet: np.ndarray, start: np.ndarray, rgba: np.ndarray, points: np.ndarray) -> None:  # fmt: skip
    """Fill rgba (N,4) u1 and points (N,) u2 for layers [a, b): own colour, 1 + depth step, covered points; 0 if empty.

    sheet  as recorded for these layers; start  `layer_starts(slabs)`
    """
    widest = int(slabs.size[layers[0] : layers[1], 0].max(initial=1))
    held = max(widest, BAND)
    owner, depth = np.empty((held, POINTS), np.uint32), np.empty((held, POINTS), np.float32)
    _sample(sources, pieces, slabs, surface, *layers, sheet, start, rgba, points, owner, depth)


def compose(slabs: Slabs, surface: Surface, start: np.ndarray, rgba: np.ndarray, points: np.ndarray,
            beside: np.ndarray) -> np.ndarray:  # fmt: skip
    """Return (N,4) u1: the texels as they are stored, from those of `sample`; see `farfield.bake.model` for alpha.

    beside  (N,) u1  1 where a surface of another object lies in the texel, in its layer or the next
    """
    out = np.zeros_like(rgba)
    _compose(slabs, start, beside, rgba, points, surface.decode, surface.encode, out)
    return out
