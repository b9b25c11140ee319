"""Lay the layers of an impostor side by side in sheets, to be recorded in one pass each."""

import numpy as np

from farfield.bake.records import Slabs

SIDE = 2048  # texels of a sheet, unless one layer alone is larger: 16 MB of piece numbers


def lay_out(slabs: Slabs) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Set slabs.at and return the sheets: (layers [a, b), (width, height)); every layer is in one, in order.

    Rows of layers, left to right, in layer order: neighbours are of similar size, so little is lost.
    """
    sheets: list[tuple[tuple[int, int], tuple[int, int]]] = []
    n = len(slabs.size)
    wide = max(SIDE, int(slabs.size[:, 0].max(initial=0)))
    start = 0
    while start < n:
        x = y = row = width = height = 0
        k = start
        while k < n:
            w, h = (int(v) for v in slabs.size[k])
            if x + w > wide:
                x, y, row = 0, y + row, 0
            if k > start and y + h > SIDE:
                break
            slabs.at[k] = x, y
            x, row = x + w, max(row, h)
            width, height = max(width, x), max(height, y + h)
            k += 1
        if width and height:
            sheets.append(((start, k), (width, height)))
        start = k
    return sheets


def part(rgba: np.ndarray, slabs: Slabs, layer: int) -> np.ndarray:
    """Return the rectangle of a layer in its sheet, a view (h,w,...)."""
    (x, y), (w, h) = slabs.at[layer], slabs.size[layer]
    return rgba[y : y + h, x : x + w]
