"""Colours spread into empty texels, one ring a pass."""

import numpy as np


def bleed(rgba: np.ndarray, passes: int) -> np.ndarray:
    out = rgba.astype(int)
    known = rgba[..., 3] > 0
    height, width = known.shape
    for _ in range(passes):
        before = known.copy()
        for j in range(height):
            for i in range(width):
                if before[j, i]:
                    continue
                around = np.s_[max(j - 1, 0) : j + 2, max(i - 1, 0) : i + 2]
                colors = out[around][before[around]][:, :3]
                if len(colors):
                    out[j, i, :3] = colors.sum(0) // len(colors)
                    known[j, i] = True
    return out.astype(np.uint8)
