"""Triangles seen from straight above. Float64, one fixed order: the same picture everywhere."""

import math

import numpy as np
from numba import njit


@njit(cache=True)
def draw_from_above(position, index, triangles, matrix, colors, low_x, low_z, scale, height, image, most):
    """Draw the triangles [triangles[0], triangles[1]) of one object; return the pixels looked at, -1 beyond `most`.

    height (H,W) f64 metres, -inf where nothing is; image (H,W,3) f64; a pixel's centre decides, the highest point wins
    """
    n_rows, n_columns = height.shape
    looked = 0
    p = np.empty((3, 3))
    for t in range(triangles[0], triangles[1]):
        for k in range(3):
            v = position[index[t, k]]
            for axis in range(3):
                m = matrix[axis]
                p[k, axis] = m[0] * v[0] + m[1] * v[1] + m[2] * v[2] + m[3]
        ax, az = (p[0, 0] - low_x) * scale, (p[0, 2] - low_z) * scale
        bx, bz = (p[1, 0] - low_x) * scale, (p[1, 2] - low_z) * scale
        cx, cz = (p[2, 0] - low_x) * scale, (p[2, 2] - low_z) * scale
        area = (bx - ax) * (cz - az) - (bz - az) * (cx - ax)
        if area == 0.0 or not math.isfinite(area):
            continue
        first_column = max(0, math.ceil(min(ax, bx, cx) - 0.5))
        last_column = min(n_columns - 1, math.floor(max(ax, bx, cx) - 0.5))
        first_row = max(0, math.ceil(min(az, bz, cz) - 0.5))
        last_row = min(n_rows - 1, math.floor(max(az, bz, cz) - 0.5))
        if first_column > last_column or first_row > last_row:
            continue
        looked += (last_column - first_column + 1) * (last_row - first_row + 1)
        if looked > most:
            return -1
        # Light from above, north-west: how a map is shaded. Both sides count, for a file's winding says little.
        ux, uy, uz = p[1, 0] - p[0, 0], p[1, 1] - p[0, 1], p[1, 2] - p[0, 2]
        vx, vy, vz = p[2, 0] - p[0, 0], p[2, 1] - p[0, 1], p[2, 2] - p[0, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        side = 1.0 if ny >= 0.0 else -1.0
        lit = 0.0 if length == 0.0 else side * (-0.4 * nx + 0.82 * ny - 0.4 * nz) / length
        shade = 0.35 + 0.65 * max(0.0, lit)
        for row in range(first_row, last_row + 1):
            z = row + 0.5
            for column in range(first_column, last_column + 1):
                x = column + 0.5
                a = ((bx - x) * (cz - z) - (bz - z) * (cx - x)) / area
                b = ((cx - x) * (az - z) - (cz - z) * (ax - x)) / area
                c = 1.0 - a - b
                if a < 0.0 or b < 0.0 or c < 0.0:
                    continue
                y = a * p[0, 1] + b * p[1, 1] + c * p[2, 1]
                if y > height[row, column]:
                    height[row, column] = y
                    for channel in range(3):
                        image[row, column, channel] = shade * colors[t, channel]
    return looked
