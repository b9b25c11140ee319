"""From which distance a level may stand for its mesh.

Problem  A level is off by at most e: each point of either surface has a point of the other within e. From how far may
         it be drawn such that no point stands off its place by more than the pixel error?
Method   Both points lie in the object's box (a level has no vertices of its own), so no nearer to the eye than the box,
         at d. Two points no nearer than d and e apart are seen under at most 2 asin(e / 2d). That is at most the
         admissible angle alpha, with dl = 2 tan(alpha / 2), from d = e / (2 sin(alpha / 2)) = e hypot(1 / dl, 1 / 2) on.
         e in the scene: times the largest singular value of the object's matrix.
Errs     towards finer levels. alpha is the impostors' [`farfield.impostor.plan.precision`, error-metric.md section 1]:
         `pixel_error` pixels in the screen's centre, or nowhere more with `quality.pixels_at` = "anywhere".
"""

import math

import numpy as np

from farfield.impostor.plan import precision
from farfield.settings import Settings

_SQUARINGS = 8
ROUNDING = 1 + 2.0**-40


def stretch(matrix: np.ndarray) -> np.ndarray:
    """Return (N,) f64: at least the largest singular value of each (N,3,4) or (N,3,3) matrix, at most 0.3 % more.

    With B = A^T A its square is the largest eigenvalue of B, at most trace(B^k)^(1/k), k = 256. Scales by powers of two.
    """
    a = np.asarray(matrix, dtype=np.float64)[:, :, :3]
    _, exponent = np.frexp(np.abs(a).max(axis=(1, 2), initial=0.0))
    a = np.ldexp(a, -exponent[:, None, None])  # squares neither overflow nor vanish
    b = _product(a.transpose(0, 2, 1), a)
    size = _trace(b)
    b = b / np.where(size > 0, size, 1.0)[:, None, None]
    power = np.ones(len(a))
    for n in range(1, _SQUARINGS + 1):
        b = _product(b, b)
        trace = _trace(b)
        b = b / np.where(trace > 0, trace, 1.0)[:, None, None]
        root = trace
        for _ in range(n):
            root = np.sqrt(root)
        power = power * root  # trace(B^(2^n))^(1/2^n), as far as it goes
    return np.ldexp(np.sqrt(size * power) * ROUNDING, exponent)


def sight(settings: Settings) -> float:
    """Return the least distance from which an error of 1, both as placed, is within the pixel error."""
    return math.hypot(1 / precision(settings).dl, 0.5) * ROUNDING


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    rank_one = [a[:, :, k, None] * b[:, k, None, :] for k in range(3)]
    return np.asarray(rank_one[0] + rank_one[1] + rank_one[2])  # no BLAS: the order is fixed


def _trace(b: np.ndarray) -> np.ndarray:
    return np.asarray(b[:, 0, 0] + b[:, 1, 1] + b[:, 2, 2])
