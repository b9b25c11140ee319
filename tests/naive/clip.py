"""A triangle between two planes of constant z: half-space after half-space, in fractions."""

from fractions import Fraction

import numpy as np

Point = tuple[Fraction, ...]


def _keep(polygon: list[Point], border: Fraction, sign: int) -> list[Point]:
    out: list[Point] = []
    for k, q in enumerate(polygon):
        p = polygon[k - 1]
        if (p[2] - border) * sign < 0 < (q[2] - border) * sign or (q[2] - border) * sign < 0 < (p[2] - border) * sign:
            t = (border - p[2]) / (q[2] - p[2])
            out.append(tuple(a + t * (b - a) for a, b in zip(p, q, strict=True)))
        if (q[2] - border) * sign >= 0:
            out.append(q)
    return out


def clip(triangle: np.ndarray, near: float, far: float) -> set[tuple[float, ...]]:
    """Return the corners, rounded to 12 digits, of the part of triangle (3,3) with near <= z <= far."""
    polygon = [tuple(Fraction(float(x)) for x in corner) for corner in triangle]
    for border, sign in ((near, 1), (far, -1)):
        polygon = _keep(polygon, Fraction(border), sign)
    return {tuple(round(float(x), 12) + 0.0 for x in p) for p in polygon}
