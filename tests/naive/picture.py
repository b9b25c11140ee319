"""A picture from above, pixel by pixel: every triangle is asked."""

import numpy as np


def heights_from_above(corners, *, low, scale, shape):
    """(T,3,3) corners -> (H,W): the highest point over each pixel's centre, -inf where there is none."""
    height = np.full(shape, -np.inf)
    for row in range(shape[0]):
        for column in range(shape[1]):
            x, z = low[0] + (column + 0.5) / scale, low[2] + (row + 0.5) / scale
            for a, b, c in corners:
                m = np.array([[a[0], b[0], c[0]], [a[2], b[2], c[2]], [1.0, 1.0, 1.0]])
                if abs(np.linalg.det(m)) < 1e-12:
                    continue
                weights = np.linalg.solve(m, [x, z, 1.0])
                if (weights >= 0).all():
                    height[row, column] = max(height[row, column], weights @ [a[1], b[1], c[1]])
    return height
