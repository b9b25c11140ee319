"""Numba kernels of the cost model. `screen` is `farfield.rendertime.cost.screen(model)`.

Only + - * / and sqrt decide here: correctly rounded everywhere, and a power of two scales through.
"""

import math

import numpy as np
from numba import njit


@njit(cache=True)
def angle_bound(diameter, distance):
    """Return at least 2 atan(diameter / (2 distance)), at most 6 % more; distance > 0.

    atan y = 4 atan z after halving the angle twice, and atan z <= z.
    """
    y = min(diameter / (2 * distance), 1e9)
    z = y / (1 + math.sqrt(1 + y * y))
    z = z / (1 + math.sqrt(1 + z * z))
    return 8 * z


@njit(cache=True)
def box_pixels(distance, diameter, screen):
    """Return the most pixels that something of this diameter, no nearer than distance, covers (bounding rectangle)."""
    if not distance > 0:
        return screen[5]
    phi = angle_bound(diameter, distance)
    return min(screen[0], screen[2] * phi) * min(screen[1], screen[3] * phi)


@njit(cache=True)
def rect_pixels(width, height, distance, screen):
    """Return the most pixels (area) that a flat rectangle, no nearer than distance, covers."""
    if not distance > 0:
        return screen[5]
    # solid angle <= area / distance^2; as a bounding rectangle the diagonal counts
    area = screen[4] * (width / distance) * (height / distance)
    return min(area, box_pixels(distance, math.sqrt(width * width + height * height), screen))


@njit(cache=True)
def impostor_cost(triangles, pixels, per_impostor, per_triangle, per_pixel):
    return np.int64(math.ceil(per_impostor + per_triangle * triangles + per_pixel * pixels))


@njit(cache=True)
def gap(box, cell):
    """Return the distance of a box (2,3) from a cell (2,3); 0 where they touch. It falls as the cell grows."""
    gap2 = 0.0
    for k in range(3):
        d = max(box[0, k] - cell[1, k], cell[0, k] - box[1, k])
        if d > 0:
            gap2 += d * d
    return math.sqrt(gap2)


@njit(cache=True)
def level_of(o, distance, level_row, level_from):
    """Return the level that object o is drawn at: 0 itself, k the k-th of its rows."""
    level = 0
    if len(level_row) > 0:
        first = level_row[o]
        for k in range(first, level_row[o + 1]):
            if level_from[k] <= distance:
                level = k - first + 1
    return level


@njit(cache=True)
def object_levels(boxes, cell, level_row, level_from, out):
    for o in range(len(boxes)):
        out[o] = level_of(o, gap(boxes[o], cell), level_row, level_from)


@njit(cache=True)
def pixels_from(box, cell, screen):
    """Return the most pixels that a box (2,3) covers, seen from a cell (2,3)."""
    size2 = 0.0
    for k in range(3):
        size = box[1, k] - box[0, k]
        size2 += size * size
    return box_pixels(gap(box, cell), math.sqrt(size2), screen)


@njit(cache=True)
def covered_pixels(boxes, cell, screen, out):
    for i in range(len(boxes)):
        out[i] = pixels_from(boxes[i], cell, screen)


@njit(cache=True)
def object_costs(objects, fixed, level_row, level_from, level_fixed, boxes, cell, per_pixel, screen, out):
    for k in range(len(objects)):
        i = objects[k]
        out[k] = fixed[i]
        if len(level_row) > 0:
            level = level_of(i, gap(boxes[i], cell), level_row, level_from)
            if level > 0:
                out[k] = level_fixed[level_row[i] + level - 1]
        if per_pixel > 0:
            out[k] += np.int64(math.ceil(per_pixel * pixels_from(boxes[i], cell, screen)))
