"""Atlas pages as plain masked pictures: what an engine that knows nothing of depth in alpha can show.

Problem  Alpha of a page holds depth and share (docs/formats/placementdb.md section 4); an engine wants a mask.
Method   Level 0 of the page, colours as they are, bled ones under empty texels included; alpha 255 where anything is
         stored, else 0. Texels that no exported polygon may read are cleared, so that an excerpt is small.
Errs     Texels with a share below 1 are drawn in full: a silhouette grows by less than a texel, nothing opens.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np


def masked(image: np.ndarray, level: dict[str, Any], rects: Sequence[tuple[int, int, int, int]]) -> np.ndarray:
    """Return the (size, size, 4) u1 texels of a page's level 0 within the rects (x, y, width, height), alpha 0 or 255."""
    x, y, size = level["x"], level["y"], level["size"]
    kept = np.zeros((size, size), dtype=bool)
    for left, top, width, height in rects:
        kept[top : top + height, left : left + width] = True
    texels = image[y : y + size, x : x + size].copy()
    texels[..., 3] = np.where(texels[..., 3] > 0, 255, 0)
    texels[~kept] = 0
    return texels
