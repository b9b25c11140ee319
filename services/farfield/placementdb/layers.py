"""Turn baked layers into what is drawn: polygons of 3 to 8 corners over blocks of texels that fit into a page.

Problem  A layer's tile may be larger than a page, its polygon may reach past its tile, and the polygons of the pieces
         must meet without a crack.
Method   Clip the polygon to its tile; cut tile and polygon into columns, then each column into rows, along whole
         texels (multiples of 8, so that the mip levels of two pieces agree). Both sides of a cut inherit the same
         edges and intersect them in the same order, so shared corners are equal bit for bit. A convex polygon of
         more than 8 corners is halved along a diagonal: the triangles of a fan stay as many as they were.
Errs     A piece without a covered texel is dropped; nothing that is covered is.
"""

import math
from dataclasses import dataclass

import numpy as np

from farfield.bake.model import BakedLayers
from farfield.placementdb.layout import ALIGN_TEXELS, MAX_CORNERS, PAGE_TEXELS

Polygon = list[tuple[float, float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Pieces:
    """R rows of the layer table, near to far within an impostor, over B distinct blocks of texels."""

    row: np.ndarray  # (I+1,) i64  rows of impostor i; none where it is not shown
    layer: np.ndarray  # (R,) i64  of BakedLayers
    number: np.ndarray  # (R,) i64  of the layer in its impostor
    block: np.ndarray  # (R,) i64
    corner_row: np.ndarray  # (R+1,) i64
    corner: np.ndarray  # (Q,2) f64  texels from the block's low corner
    position: np.ndarray  # (Q,3) f32  relative to the impostor's eye
    block_tile: np.ndarray  # (B,) i64  tile of BakedLayers
    block_rect: np.ndarray  # (B,4) i64  x, y, width, height in that tile


def cut_layers(baked: BakedLayers, shown: np.ndarray) -> Pieces:
    """Return the pieces of the impostors with `shown` (I,) bool. Blocks are numbered in order of first use."""
    blocks: dict[tuple[int, int, int, int, int], int] = {}
    covered: dict[tuple[int, int, int, int, int], bool] = {}
    row, layers, numbers, used, counts = [0], [], [], [], [0]
    corners: Polygon = []
    for i in range(len(baked.eye)):
        first, stop = int(baked.layer_row[i]), int(baked.layer_row[i + 1])
        number = 0
        for layer in range(first, stop if shown[i] else first):
            tile = int(baked.tile[layer])
            number += layer > first and baked.plane[layer] != baked.plane[layer - 1]
            width, height = (int(n) for n in baked.tile_size[tile])
            a, b = baked.corner_row[layer], baked.corner_row[layer + 1]
            polygon = [(float(x), float(y)) for x, y in baked.corner[a:b] - baked.tile_at[layer]]
            for x, y, w, h, part in _pieces(polygon, width, height):
                key = (tile, x, y, w, h)
                if key not in covered:
                    covered[key] = bool(tile_texels(baked, tile)[y : y + h, x : x + w, 3].any())
                if not covered[key]:
                    continue
                block = blocks.setdefault(key, len(blocks))
                for convex in halved(part):
                    layers.append(layer)
                    numbers.append(number)
                    used.append(block)
                    corners.extend((u - x, v - y) for u, v in convex)
                    counts.append(len(corners))
        row.append(len(layers))
    layer_of = np.array(layers, dtype=np.int64)
    corner_row = np.array(counts, dtype=np.int64)
    keys = np.array(list(blocks), dtype=np.int64).reshape(-1, 5)
    corner = np.array(corners, dtype=np.float64).reshape(-1, 2)
    block_of = np.array(used, dtype=np.int64)
    origin = baked.tile_at[layer_of] + keys[block_of, 1:3] if len(layer_of) else np.zeros((0, 2))
    grid = corner + np.repeat(origin, np.diff(corner_row), axis=0)
    impostor = np.repeat(np.arange(len(baked.eye)), np.diff(row))
    impostor_of, layer_at = (np.repeat(ids, np.diff(corner_row)) for ids in (impostor, layer_of))
    return Pieces(
        row=np.array(row, dtype=np.int64), layer=layer_of, number=np.array(numbers, dtype=np.int64), block=block_of,
        corner_row=corner_row, corner=corner, block_tile=keys[:, 0], block_rect=keys[:, 1:],
        position=_positions(baked, impostor_of, layer_at, grid),
    )  # fmt: skip


def tile_texels(baked: BakedLayers, tile: int) -> np.ndarray:
    """Return the (height, width, 4) u1 texels of a tile, a view."""
    width, height = baked.tile_size[tile]
    return baked.tile_data[baked.tile_byte[tile] : baked.tile_byte[tile + 1]].reshape(height, width, 4)


def _positions(baked: BakedLayers, impostor: np.ndarray, layer: np.ndarray, grid: np.ndarray) -> np.ndarray:
    right, up = baked.right[impostor], baked.up[impostor]
    slope = baked.slope0[impostor] + grid * baked.texel[impostor]
    ahead = -np.cross(right, up) if len(right) else right
    point = baked.plane[layer, None] * (slope[:, :1] * right + slope[:, 1:] * up + ahead)
    return point.astype(np.float32).reshape(-1, 3)


def _pieces(polygon: Polygon, width: int, height: int) -> list[tuple[int, int, int, int, Polygon]]:
    """Return (x, y, width, height, polygon) of the pieces of a tile, each at most a page; polygons keep tile texels."""
    inside = polygon
    for axis, bound in ((0, width), (1, height)):
        if any(p[axis] < 0 for p in inside):
            inside = clip(inside, axis, 0.0, low=False)
        if any(p[axis] > bound for p in inside):
            inside = clip(inside, axis, float(bound), low=True)
    out: list[tuple[int, int, int, int, Polygon]] = []
    for x, w, column in _cut(inside, 0, width):
        out.extend((x, y, w, h, part) for y, h, part in _cut(column, 1, height) if _area(part) > 0)
    return out


def _cut(polygon: Polygon, axis: int, size: int) -> list[tuple[int, int, Polygon]]:
    """Return (start, length, polygon) of near-equal slices along an axis, each at most a page."""
    n = math.ceil(size / PAGE_TEXELS)
    step = math.ceil(size / n / ALIGN_TEXELS) * ALIGN_TEXELS
    out, rest = [], polygon
    for start in range(0, size, step):
        stop = min(start + step, size)
        here = clip(rest, axis, float(stop), low=True) if stop < size else rest
        rest = clip(rest, axis, float(stop), low=False) if stop < size else []
        if len(here) >= 3:
            out.append((start, stop - start, here))
    return out


def clip(polygon: Polygon, axis: int, bound: float, *, low: bool) -> Polygon:
    """Return the part of a convex polygon with coordinate <= bound (low) or >= bound. Cut points lie on it exactly."""
    out: Polygon = []
    for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        inside_p = p[axis] <= bound if low else p[axis] >= bound
        inside_q = q[axis] <= bound if low else q[axis] >= bound
        if inside_p:
            out.append(p)
        if inside_p != inside_q and p[axis] != bound and q[axis] != bound:
            a, b = (p, q) if p <= q else (q, p)  # the same point, whichever side asks
            t = (bound - a[axis]) / (b[axis] - a[axis])
            other = a[1 - axis] + t * (b[1 - axis] - a[1 - axis])
            out.append((bound, other) if axis == 0 else (other, bound))
    return out


def halved(polygon: Polygon) -> list[Polygon]:
    """Return convex polygons of 3 to 8 corners that make up a convex polygon, in as many fan triangles."""
    if len(polygon) <= MAX_CORNERS:
        return [polygon]
    half = len(polygon) // 2
    return halved(polygon[: half + 1]) + halved([*polygon[half:], polygon[0]])


def _area(polygon: Polygon) -> float:
    if len(polygon) < 3:
        return 0.0
    return sum(p[0] * q[1] - q[0] * p[1] for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True))
