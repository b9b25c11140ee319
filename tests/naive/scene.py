"""The slow obvious version of stage scene's kernels: exact fractions, one triangle and one sample at a time."""

from fractions import Fraction

import numpy as np


def has_area(corners: np.ndarray) -> bool:
    """True where three float32 corners are not in line, in exact arithmetic."""
    a, b, c = ([Fraction(float(x)) for x in corner] for corner in corners)
    u, v = [q - p for p, q in zip(a, b)], [q - p for p, q in zip(a, c)]
    return any(u[i] * v[j] != u[j] * v[i] for i, j in ((0, 1), (1, 2), (2, 0)))


def box(points: np.ndarray, matrix: np.ndarray) -> tuple[list[float], list[float]]:
    """Return the box of points through a (3,4) matrix."""
    rows = matrix.tolist()
    placed = [[m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3] for m in rows] for p in points.tolist()]
    return [min(c) for c in zip(*placed)], [max(c) for c in zip(*placed)]


def lowest(corners: np.ndarray, facing: float, steepest: float, floor_y: float, x: float, z: float) -> float:
    """Return the height of the lowest surface over (x, z), by a vertical line through each triangle."""
    best = np.inf
    for a, b, c in corners.astype(np.float64):
        normal = np.cross(b - a, c - a)
        length = np.sqrt((normal * normal).sum())
        if not normal[1] * facing > steepest * length:
            continue
        inside = []
        for p, q in ((a, b), (b, c), (c, a)):
            inside.append((q[0] - p[0]) * (z - p[2]) - (q[2] - p[2]) * (x - p[0]))
        if all(i >= 0 for i in inside) or all(i <= 0 for i in inside):
            y = a[1] - (normal[0] * (x - a[0]) + normal[2] * (z - a[2])) / normal[1]
            if y >= floor_y:
                best = min(best, y)
    return best
