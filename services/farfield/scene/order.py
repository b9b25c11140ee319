"""Fix the order of objects: Morton order of their box centres on the fixed grid.

Problem  Give N boxes an order in which neighbours in space are neighbours in the order, that does not depend on the
         order of the file, that scaling by a power of two keeps, and in which moving one box moves only that box.
Method   The grid's spacing is cell_m / 1024 and its origin is that of the scene's own coordinates, not of `origin_m`:
         a scene that grows, so that `origin_m` moves on, keeps its order. A centre's 42-bit indices of the three axes
         are interleaved (x, y, z from the highest bit) into 126 bits, two words of 63. Centres beyond 2**31 cells from
         the origin share the outermost grid cell. Ties go by box corners, triangles, calls, then `extra` keys.
After    Morton. A Computer Oriented Geodetic Data Base. IBM, 1966.
"""

from collections.abc import Sequence

import numpy as np

SUBDIVISIONS = 1024  # grid spacings a cell: a power of two
BITS = 42  # an axis, in two words of 21
_WORD_BITS = 21


def grid_index(point_m: np.ndarray, *, origin_m: np.ndarray, cell_m: float) -> np.ndarray:
    """Return (N,3) int64 grid indices, clamped to +-2**41, of points relative to `origin_m`, a multiple of cell_m."""
    spacing = cell_m / SUBDIVISIONS
    half = 2.0 ** (BITS - 1)
    index = np.floor(np.asarray(point_m, dtype=np.float64) / spacing) + np.rint(np.asarray(origin_m) / spacing)
    return np.clip(index, -half, half - 1).astype(np.int64)


def spread_bits(value: np.ndarray) -> np.ndarray:
    """Return uint64 with bit i of the 21-bit `value` (uint64) at bit 3 i."""
    x = value & np.uint64(0x1FFFFF)
    for shift, mask in (
        (32, 0x001F00000000FFFF), (16, 0x001F0000FF0000FF), (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3), (2, 0x1249249249249249),
    ):  # fmt: skip
        x = (x | (x << np.uint64(shift))) & np.uint64(mask)
    return x


def morton_keys(box_m: np.ndarray, *, origin_m: np.ndarray, cell_m: float) -> np.ndarray:
    """Return (N,2) uint64 keys of box centres, high word first; compare them as pairs.

    box_m      (N,2,3) f64, relative to origin_m
    origin_m   (3,) f64, a multiple of cell_m
    cell_m     side of the smallest view-space cell, > 0
    """
    box_m = np.asarray(box_m, dtype=np.float64).reshape(-1, 2, 3)
    center = box_m[:, 0] * 0.5 + box_m[:, 1] * 0.5
    shifted = (grid_index(center, origin_m=origin_m, cell_m=cell_m) + 2 ** (BITS - 1)).astype(np.uint64)
    key = np.zeros((len(box_m), 2), dtype=np.uint64)
    for word, shift in ((0, _WORD_BITS), (1, 0)):
        for axis in range(3):
            key[:, word] |= spread_bits(shifted[:, axis] >> np.uint64(shift)) << np.uint64(2 - axis)
    return key


def object_order(
    box_m: np.ndarray,
    *,
    triangles: np.ndarray,
    calls: np.ndarray,
    origin_m: np.ndarray,
    cell_m: float,
    extra: Sequence[np.ndarray] = (),
) -> np.ndarray:
    """Return the (N,) int64 permutation that puts objects in id order.

    box_m             (N,2,3) f64, relative to origin_m
    triangles, calls  (N,) int64
    extra             further sortable (N,) columns for boxes, triangles and calls that are all equal; the first decides
    """
    key = morton_keys(box_m, origin_m=origin_m, cell_m=cell_m)
    corners = np.asarray(box_m, dtype=np.float64).reshape(-1, 6)
    columns = [key[:, 0], key[:, 1], *corners.T, triangles, calls, *extra]
    return np.lexsort(columns[::-1])
