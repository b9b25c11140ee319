"""Cut pieces into blocks of at most 256 x 256 texels with everything the shader needs in 32-bit integers.

Relative to its block's corner every product of the test stays below 2**31 (grids up to records.MAX_SIDE texels); bounds
that lie beyond all values in the block are clamped, which changes no answer. Blocks that a piece does not meet are left
out.

whole  (B,27) i32: 0-1 x, y in the sheet; 2-3 width, height; 4 piece + 1; 5-16 for each edge of the piece dx, dy, lo,
       hi; 17-19 for each edge of the source triangle the least dx j - dy i that is inside; 20-25 its corners; 26
       whether the eye sees its back
real   (B,8) f32: 0-2 depths of its corners; 3-5 reciprocal squared edge lengths; 6-7 slopes of the depth
"""

from typing import Any

import numpy as np
from numba import njit

from farfield.bake.coverage import centre_bound, depth_plane, edge_bounds, piece_edges, slab_depth
from farfield.bake.records import Pieces, Slabs, Sources, Surface

SIDE = 256
_MOST = 2**31 - 1


@njit(cache=True)
def _clamp(value: int) -> int:
    return min(max(value, -_MOST), _MOST)


@njit(cache=True)
def _fill(sources: Any, pieces: Any, slabs: Any, masked: Any, first_layer: int, last_layer: int, start: int, whole: Any,
          real: Any) -> tuple[int, int]:  # fmt: skip
    """Write the blocks of pieces from `start` on until all are written or the arrays are full; return how many blocks
    there are and the piece that is next (its blocks do not straddle calls)."""
    edge = np.empty((3, 4), np.int64)
    lo, hi = np.empty(3, np.int64), np.empty(3, np.int64)
    n = 0
    for k in range(first_layer, last_layer):
        low, size = slabs.low[k], slabs.size[k]
        near, far = slabs.inverse_near[k], slabs.inverse_far[k]
        for f in range(max(start, pieces.row[k]), pieces.row[k + 1]):
            s = pieces.source[f]
            if masked[sources.material[s]]:
                continue
            p = pieces.snapped[f]
            i0 = max(-((-min(p[0], p[2], p[4])) // 256) - 1, low[0])
            i1 = min(max(p[0], p[2], p[4]) // 256, low[0] + size[0] - 1)
            j0 = max(-((-min(p[1], p[3], p[5])) // 256) - 1, low[1])
            j1 = min(max(p[1], p[3], p[5]) // 256, low[1] + size[1] - 1)
            across, along = (i1 - i0) // SIDE + 1, (j1 - j0) // SIDE + 1
            if n + across * along > len(whole):
                return n, f
            twice = piece_edges(p, edge)
            for e in range(3):
                lo[e], hi[e] = edge_bounds(edge[e, 0], edge[e, 1], edge[e, 2], edge[e, 3], twice)
            q = sources.snapped[s]
            v0 = slab_depth(sources.inverse[s, 0], near, far)
            v1 = slab_depth(sources.inverse[s, 1], near, far)
            v2 = slab_depth(sources.inverse[s, 2], near, far)
            gx, gy = depth_plane(q, v0, v1, v2)
            for by in range(along):
                for bx in range(across):
                    x, y = i0 + SIDE * bx, j0 + SIDE * by
                    w, h = min(SIDE, i1 - x + 1), min(SIDE, j1 - y + 1)
                    meets = True
                    for e in range(3):
                        dx, dy = edge[e, 2], edge[e, 3]
                        here = dx * y - dy * x
                        a, b = lo[e] - here, hi[e] - here
                        least = min(dx * (h - 1), 0) + min(-dy * (w - 1), 0)
                        most = max(dx * (h - 1), 0) + max(-dy * (w - 1), 0)
                        meets = meets and most >= a and least <= b
                        whole[n, 5 + 4 * e], whole[n, 6 + 4 * e] = dx, dy
                        whole[n, 7 + 4 * e], whole[n, 8 + 4 * e] = _clamp(a), _clamp(b)
                    if not meets:
                        continue
                    whole[n, 0], whole[n, 1] = x - low[0] + slabs.at[k, 0], y - low[1] + slabs.at[k, 1]
                    whole[n, 2], whole[n, 3], whole[n, 4] = w, h, f + 1
                    area = 0
                    for e in range(3):
                        g = (e + 1) % 3
                        dx, dy = np.int64(q[2 * g] - q[2 * e]), np.int64(q[2 * g + 1] - q[2 * e + 1])
                        area += dx * (-q[2 * e + 1]) - dy * (-q[2 * e])
                        whole[n, 17 + e] = _clamp(centre_bound(q[2 * e], q[2 * e + 1], dx, dy) - (dx * y - dy * x))
                        whole[n, 20 + 2 * e], whole[n, 21 + 2 * e] = q[2 * e] - 256 * x, q[2 * e + 1] - 256 * y
                    whole[n, 26] = sources.away[s]
                    if area <= 0:
                        whole[n, 17] = _MOST
                    real[n, 0], real[n, 1], real[n, 2] = v0, v1, v2
                    real[n, 3], real[n, 4], real[n, 5] = (
                        sources.reciprocal[s, 0],
                        sources.reciprocal[s, 1],
                        sources.reciprocal[s, 2],
                    )
                    real[n, 6], real[n, 7] = gx, gy
                    n += 1
    return n, pieces.row[last_layer]


def fill(
    sources: Sources, pieces: Pieces, slabs: Slabs, surface: Surface, layers: tuple[int, int], start: int,
    whole: np.ndarray, real: np.ndarray,
) -> tuple[int, int]:  # fmt: skip
    """Fill `whole` and `real` (see the module's head) with blocks of the opaque pieces of layers [a, b) from piece
    `start` on; return how many blocks were written and the piece to go on with (the end of the last layer when
    done)."""
    n, following = _fill(sources, pieces, slabs, surface.masked, *layers, start, whole, real)
    return int(n), int(following)
