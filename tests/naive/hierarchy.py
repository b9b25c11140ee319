"""The slow obvious version of stage hierarchy: Python integers, one bit at a time."""

import math

import numpy as np


def morton_key(low, high, origin, cell_m: float) -> int:
    """Interleave the three grid indices of the box centre, one bit at a time."""
    spacing = cell_m / 1024
    index = [
        math.floor((a * 0.5 + b * 0.5) / spacing) + round(o / spacing) + 2**41 for a, b, o in zip(low, high, origin)
    ]
    index = [min(max(i, 0), 2**42 - 1) for i in index]
    key = 0
    for bit in reversed(range(42)):
        for i in index:
            key = 2 * key + (i >> bit & 1)
    return key


def clusters(boxes: np.ndarray, origin, cell_m: float) -> list[tuple[int, int]]:
    """Return the preorder ranges of the tree: split by each bit in turn, the highest first."""
    keys = [morton_key(*box, origin, cell_m) for box in boxes.tolist()]
    ranges: list[tuple[int, int]] = []

    def grow(start: int, stop: int, bit: int) -> None:
        if stop - start == 1:
            ranges.append((start, stop))
            return
        while bit >= 0:
            ones = sum(keys[i] >> bit & 1 for i in range(start, stop))
            if 0 < ones < stop - start:
                break
            bit -= 1
        cut = stop - ones if bit >= 0 else (start + stop + 1) // 2
        ranges.append((start, stop))
        grow(start, cut, bit - 1)
        grow(cut, stop, bit - 1)

    grow(0, len(keys), 125)
    return ranges
