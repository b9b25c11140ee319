"""The formulas of the error metric that kernels compute, each with its twin in 50 digits and the domain it is tried on.

Lengths are drawn evenly in their logarithm; a zero as often as makes it matter; next to a pole as often as far from it.
Inputs outside what `farfield.impostor.metric.check` lets through are not drawn.
"""

import math
from typing import Any

import numpy as np

from farfield.evaluation import exact
from farfield.impostor import kernels
from farfield.stability.trial import Arguments, Formula

Rng = np.random.Generator


def _log(rng: Rng, low: float, high: float) -> float:
    return float(10 ** rng.uniform(low, high))


def _or_zero(rng: Rng, low: float, high: float) -> float:
    return float(rng.integers(0, 3) > 0) * _log(rng, low, high)


def _beside(rng: Rng, value: float) -> float:
    """Return a number near `value`, from a last digit away to ten times as much."""
    return max(value * (1 + float(rng.choice([-1, 1])) * _log(rng, -16, 1)), 0.0)


def _near_term(rng: Rng, unit: float) -> Arguments:
    res = float(rng.choice([1, 2, 3, 4, 65, 4096]))
    return unit * _or_zero(rng, -6, 6), unit * _or_zero(rng, -6, 6), res, _log(rng, -9, 2)


def _far_term(rng: Rng, unit: float) -> Arguments:
    n, s, res, delta = _near_term(rng, unit)
    return n, unit * _or_zero(rng, -6, 6), s, res, delta


def _cancels_near(n: float, s: float, res: float, delta: float) -> Any:
    value = abs(exact.near_term(n, s, res, delta))
    return (
        (exact.number(n) / exact.number(delta) / 2 + abs(res / 2 - 1) * exact.number(s)) / value if value else math.inf
    )


def _cancels_far(n: float, m: float, s: float, res: float, delta: float) -> Any:
    value = abs(exact.far_term(n, m, s, res, delta))
    parts = exact.number(n) / exact.number(delta) / 2 + res / 2 * (exact.number(m) + exact.number(s))
    return parts / value if value else math.inf


def _shaft_term(rng: Rng, unit: float) -> Arguments:
    return _or_zero(rng, -30, 6), float(rng.choice([1, 2, 3, 4, 65, 4096])), _log(rng, -6, 2)


def _cancels_shaft(tangent: float, res: float, delta: float) -> Any:
    # The guard is absolute there: next to 0 it decides, on the side of smaller spacing.
    value = abs(exact.shaft_term(tangent, res, delta))
    return (exact.number(tangent) / exact.number(delta) + abs(res / 2 - 1) + 1) / value if value else math.inf


def _spacing(rng: Rng, unit: float) -> Arguments:
    t, is_box = unit * _log(rng, -3, 3), bool(rng.integers(2))
    s, m = (unit * _or_zero(rng, -12, 4) for _ in range(2))
    far = _beside(rng, t + m) if is_box else float(rng.choice([-0.5, 0.0, _log(rng, -12, 4)]))
    return t, s, is_box, m, _beside(rng, t), far


def _border(rng: Rng, unit: float) -> Arguments:
    t = unit * _log(rng, -6, 6)
    return t, t * _log(rng, -15, 6) if rng.random() < 0.9 else math.inf, unit * _or_zero(rng, -12, 12)


def _depth_near(rng: Rng, unit: float) -> Arguments:
    alpha, t = _log(rng, -6, 0.19), unit * _log(rng, -3, 3)
    s, r = (unit * _or_zero(rng, -12, 4) for _ in range(2))
    if rng.random() < 0.3:  # at the threshold q = (2 t + s) h
        r, s = 2 * t * math.tan(alpha / 2) * (1 + float(rng.choice([-1, 1])) * _log(rng, -15, -3)), 0.0
    return t, s, r, alpha


def _depth_safe(rng: Rng, unit: float) -> Arguments:
    dl, t = _log(rng, -6, -0.5), unit * _log(rng, -3, 3)
    depth = float(rng.choice([0.0, math.inf, unit * _log(rng, -6, 4)]))
    f0 = unit * _or_zero(rng, -12, 3)
    b = float(rng.choice([0, 1, 1, -1])) * _log(rng, -6, 1)
    if depth in (0.0, math.inf):
        b = abs(b) * (depth > 0)
    elif b < 0:
        b = max(b, -f0 / depth)  # F1 = F0 + b m is not negative
    if rng.random() < 0.2:
        f0 = dl * t * (1 + float(rng.choice([-1, 1])) * _log(rng, -15, -2))
    if rng.random() < 0.1 and depth > 0:
        b = dl * (1 + float(rng.choice([-1, 1])) * _log(rng, -15, -2))
    return t, f0, b, depth, dl


def _ends(rng: Rng, unit: float) -> tuple[float, float]:
    t = unit * _log(rng, -3, 3)
    return t, t * (1 + _log(rng, -12, 4)) if rng.random() < 0.9 else math.inf


def _apart(t1: float, t2: float, back: float) -> Any:
    """Return by how much t2 - t1 magnifies: the difference of two given numbers."""
    difference = exact.number(t2) - exact.number(t1)
    return 1 + (exact.number(t1) + exact.number(back)) / difference if difference > 0 else math.inf


def _steps_near(rng: Rng, unit: float) -> Arguments:
    t1, t2 = _ends(rng, unit)
    return t1, t2, unit * _or_zero(rng, -12, 4), t1 * (1 + _log(rng, -3, 8))


def _steps_far(rng: Rng, unit: float) -> Arguments:
    t1, t2 = _ends(rng, unit)
    m = unit * _or_zero(rng, -12, 4)
    return t1, t2, min(m, unit * _or_zero(rng, -12, 4)), m, (t1 + m) * (1 + _log(rng, -3, 8))


def _steps_shaft(rng: Rng, unit: float) -> Arguments:
    t1, t2 = _ends(rng, unit)
    return t1, t2 if t2 < math.inf else 2 * t1, unit * _or_zero(rng, -12, 4), _log(rng, -12, 12)


def _last_layer(rng: Rng, unit: float) -> Arguments:
    t_far = unit * _log(rng, -2, 4) if rng.random() < 0.85 else math.inf
    f0, f1, m = (unit * _or_zero(rng, -9, 4) for _ in range(3))
    is_box = bool(rng.integers(2))
    if not is_box:
        f1 = m = 0.0
    b = ((f1 - f0) / m if m > 0 else 0.0) if is_box else _log(rng, -6, 1)
    return t_far, f0, f1, b, m, is_box, _log(rng, -6, -0.5)


def _last_condition(t_far: float, f0: float, f1: float, b: float, m: float, is_box: bool, dl: float) -> Any:
    value = exact.last_layer(t_far, f0, f1, b, m, is_box, dl)
    lost = (abs(value) + m) / abs(value) if is_box and value and value < math.inf else 1  # F1 / (...) - m
    slope = abs(exact.number(b) - dl)
    return lost * ((abs(exact.number(b)) + dl) / slope if slope else math.inf)


def _vertex_terms(rng: Rng, unit: float) -> Arguments:
    low = float(rng.choice([-1, 1])) * _log(rng, -6, 0.5)
    high = low + _log(rng, -6, 0.5)
    x, d, s = (unit * _or_zero(rng, -6, 3) for _ in range(3))
    r = unit * float(rng.integers(2)) * _log(rng, -6, 2)
    return x * float(rng.choice([-1, 1])), d, r, s, low, high, (high - low) / float(rng.choice([1, 2, 4, 333]))


def _cancels_terms(x: float, d: float, r: float, s: float, low: float, high: float, delta: float) -> Any:
    value = abs(exact.vertex_terms(x, d, r, s, low, high, delta))
    parts = (abs(low) + abs(high) + delta) * (exact.number(s) + d) + abs(x) + r
    return parts / value if value else math.inf


def _spacing_any(rng: Rng, unit: float) -> Arguments:
    depth = np.concatenate([[0.0], unit * 10 ** rng.uniform(-4, 3, 3)])
    t = unit * _log(rng, -2, 3)
    term = (t + depth) * 10 ** rng.uniform(-1, 4, 4)
    if rng.random() < 0.3:
        term = (t + depth) * (1 + rng.choice([-1, 1]) * 10 ** rng.uniform(-15, -1, 4))
    return t, unit * _or_zero(rng, -9, 3), depth, term, _or_zero(rng, -3, 4)


def _pole_any(t: float, s: float, depth: Any, term: Any, limit: float) -> Any:
    x = exact.largest_over(t, depth, term, limit)
    return x / abs(x - 1) if x != 1 else math.inf


def _swing_any(rng: Rng, unit: float) -> Arguments:
    t, _, depth, term, limit = _spacing_any(rng, unit)
    return t, depth, term, limit


def _range(rng: Rng, unit: float) -> Arguments:
    dl = _log(rng, -6, -0.5)
    return unit * _log(rng, -3, 3), _beside(rng, dl) if rng.random() < 0.5 else _log(rng, -6, 2), dl


def _pole_behind(t: float, swing: float, dl: float) -> Any:
    gap = abs(exact.number(swing) - dl)
    return (exact.number(swing) + dl) / gap if gap else math.inf


LENGTHS = "lengths 1e-3 to 1e3"
FORMULAS = (
    Formula(name="near_term", equation="(2) a", domain="n, s 0 or 1e-6 to 1e6; res 1 to 4096; Delta 1e-9 to 1e2",
            draw=_near_term, kernel=kernels.near_term, exact=exact.near_term, condition=_cancels_near),
    Formula(name="far_term", equation="(3) d", domain="n, m, s 0 or 1e-6 to 1e6; res 1 to 4096; Delta 1e-9 to 1e2",
            draw=_far_term, kernel=kernels.far_term, exact=exact.far_term, condition=_cancels_far),
    Formula(name="shaft_term", equation="(5) eps - 1", domain="T 0 or 1e-30 to 1e6; res 1 to 4096; Delta 1e-6 to 1e2",
            draw=_shaft_term, kernel=kernels.shaft_term, exact=exact.shaft_term, condition=_cancels_shaft),
    Formula(name="spacing", equation="(2) (3) (5)", domain=f"{LENGTHS}; s, m 0 or 1e-12 to 1e4; a, d to 1e-16 of the pole",
            draw=_spacing, kernel=kernels.spacing, exact=exact.spacing,
            condition=lambda t, s, is_box, m, a, far: exact.spacing_condition(t, m, a, far, is_box)),
    Formula(name="border", equation="(6)", domain="t 1e-6 to 1e6; gap 1e-15 t to 1e6 t or infinite; s 0 or 1e-12 to 1e12",
            draw=_border, kernel=kernels.border, exact=exact.border, limit=1e-14),
    Formula(name="depth_near", equation="(7)", domain=f"{LENGTHS}; s, r 0 or 1e-12 to 1e4; alpha 1e-6 to 1.5; at the pole",
            draw=_depth_near, kernel=kernels.depth_near, exact=exact.depth_near, condition=exact.depth_near_condition),
    Formula(name="depth_safe", equation="section 5",
            domain=f"{LENGTHS}; F0 0 or 1e-12 to 1e3; b 0 or 1e-6 to 10, of both signs; dl 1e-6 to 0.3; at both poles",
            draw=_depth_safe, kernel=kernels.depth_safe, exact=exact.depth_safe,
            condition=lambda *a: 8 * exact.depth_safe_condition(*a)),
    Formula(name="steps_near", equation="section 7", domain=f"{LENGTHS}; t2 - t1 1e-12 t1 to infinity; s 0 or 1e-12 to 1e4",
            draw=_steps_near, kernel=kernels.steps_near, exact=exact.steps_near,
            condition=lambda t1, t2, s, a: _apart(t1, t2, 0)),
    Formula(name="steps_far", equation="section 7", domain=f"{LENGTHS}; t2 - t1 1e-12 t1 to infinity; s <= m",
            draw=_steps_far, kernel=kernels.steps_far, exact=exact.steps_far,
            condition=lambda t1, t2, s, m, d: _apart(t1, t2, m) + d / (exact.number(d) - t1 - m)),
    Formula(name="steps_shaft", equation="section 7", domain=f"{LENGTHS}; t2 - t1 1e-12 t1 to 1e4 t1; eps - 1 1e-12 to 1e12",
            draw=_steps_shaft, kernel=kernels.steps_shaft, exact=exact.steps_shaft,
            condition=lambda t1, t2, s, eps1: _apart(t1, t2, s) + 1 / exact.number(eps1)),
    Formula(name="last_layer", equation="section 7", domain="t_far 1e-2 to 1e4 or infinite; F0, F1, m 0 or 1e-9 to 1e4",
            draw=_last_layer, kernel=kernels.last_layer, exact=exact.last_layer, condition=_last_condition),
    Formula(name="vertex_terms", equation="section 3", domain="x, d, s 0 or 1e-6 to 1e3; slopes 1e-6 to 6, of both signs",
            draw=_vertex_terms, kernel=kernels.vertex_terms, exact=exact.vertex_terms, condition=_cancels_terms),
    Formula(name="spacing_any", equation="section 3", domain=f"{LENGTHS}; four vertices; X / Delta to 1e-15 of the pole",
            draw=_spacing_any, kernel=kernels.spacing_any, exact=exact.spacing_any, condition=_pole_any),
    Formula(name="swing_any", equation="section 5", domain=f"{LENGTHS}; four vertices", draw=_swing_any,
            kernel=kernels.swing_any, exact=exact.largest_over),
    Formula(name="behind", equation="section 5", domain="t 1e-3 to 1e3; X2 to 1e-16 of dl; dl 1e-6 to 0.3", draw=_range,
            kernel=kernels.behind, exact=exact.behind, condition=_pole_behind),
    Formula(name="before", equation="section 5", domain="t 1e-3 to 1e3; X2 1e-6 to 1e2; dl 1e-6 to 0.3", draw=_range,
            kernel=kernels.before, exact=exact.before),
)  # fmt: skip
