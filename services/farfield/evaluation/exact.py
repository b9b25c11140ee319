"""The error metric in 50 digits: the published and corrected equations as they stand, none of the stable forms.

Twins of `farfield.impostor.kernels`, argument for argument; slow, for tests and for `farfield stability`. Every float
that goes in is taken as the exact number it is. `condition` beside a formula says by how much it magnifies errors of
its arguments: a threshold (where a spacing or depth becomes infinite) is a pole, so near it no float64 form can have all
its digits. Needs mpmath (the extra `exact`).

Equations: Jeschke and Wimmer 2002, (2) to (7), and the general forms in their place for objects off the axis.
"""

from collections.abc import Sequence
from typing import Any

import mpmath as mp

DIGITS = 50
GUARD_DIGITS = 150  # more that are carried: some of the forms cancel

Number = Any  # a float or an mpf


def number(x: Number) -> Any:
    """Return x as the exact number it is."""
    return mp.mpf(x)


def near_term(n: Number, s: Number, res: Number, delta: Number) -> Any:
    """Return a of (2)."""
    n, s, res, delta = map(number, (n, s, res, delta))
    return n / (2 * delta) + (res / 2 - 1) * s


def far_term(n: Number, m: Number, s: Number, res: Number, delta: Number) -> Any:
    """Return d of (3)."""
    n, m, s, res, delta = map(number, (n, m, s, res, delta))
    return n / (2 * delta) + res / 2 * (m - s)


def shaft_term(tangent: Number, res: Number, delta: Number) -> Any:
    """Return eps - 1 of (5)."""
    return number(tangent) / number(delta) + number(res) / 2 - 1


def spacing(t: Number, s: Number, is_box: bool, m: Number, a: Number, far: Number) -> Any:
    """Return the smaller of (2) and (3) or (5); infinity where neither binds."""
    t, s, m, a, far = map(number, (t, s, m, a, far))
    found = [mp.inf]
    if t < a:
        found.append((t + s) / (a / t - 1))
    if is_box and t + m < far:
        found.append((t + s) / (far / (t + m) - 1))
    if not is_box and far > 0:
        found.append((t + s) / far)
    return min(found)


def spacing_condition(t: Number, m: Number, a: Number, far: Number, is_box: bool) -> Any:
    """Return the largest factor by which `spacing` magnifies a relative error of its arguments."""
    t, m, a, far = map(number, (t, m, a, far))
    out = mp.mpf(1)
    if t < a:
        out = max(out, a / (a - t))
    if is_box and t + m < far:
        out = max(out, far / (far - t - m))
    return out


def border(t_near: Number, gap: Number, s: Number) -> Any:
    """Return (6): 1 + s/(t + d) is the geometric mean of 1 + s/t_near and 1 + s/t_far; its limits for s = 0, infinity."""
    t, s = number(t_near), number(s)
    if mp.isinf(number(gap)):
        return mp.sqrt(t) * mp.sqrt(t + s)
    far = t + number(gap)
    if s == 0:
        return 2 * t * far / (t + far) - t
    return s / (mp.sqrt((1 + s / t) * (1 + s / far)) - 1) - t


def depth_near(t: Number, s: Number, r: Number, alpha: Number) -> Any:
    """Return e_near: the value of (7) at phi = atan2(s, r) / 2."""
    t, s, r, alpha = map(number, (t, s, r, alpha))
    h = mp.tan(alpha / 2)
    reach = mp.sqrt(r * r + s * s)
    q = r + (s * s / (reach + r) / (1 + mp.cos(alpha)) if reach + r > 0 else 0)
    bottom = q - (2 * t + s) * h
    return 2 * t * h * (t + s) / bottom if bottom > 0 else mp.inf


def depth_near_condition(t: Number, s: Number, r: Number, alpha: Number) -> Any:
    t, s, r, alpha = map(number, (t, s, r, alpha))
    h = mp.tan(alpha / 2)
    reach = mp.sqrt(r * r + s * s)
    q = r + (s * s / (reach + r) / (1 + mp.cos(alpha)) if reach + r > 0 else 0)
    bottom = abs(q - (2 * t + s) * h)
    return (q + (2 * t + s) * h) / bottom if bottom else mp.inf


def depth_safe(t: Number, f0: Number, b: Number, cell_depth: Number, dl: Number) -> Any:
    """Return the least over all depths d of the cell of dl u^2 / (F0 + b d - dl u), u = t + d: at an end or between."""
    t, f0, b, depth, dl = map(number, (t, f0, b, cell_depth, dl))

    def at(u: Any) -> Any:
        bottom = f0 + b * (u - t) - dl * u
        return dl * u * u / bottom if bottom > 0 else mp.inf

    found = [at(t)]
    if not mp.isinf(depth):
        found.append(at(t + depth))
    if b > dl:
        u = 2 * (b * t - f0) / (b - dl)
        if t < u < t + depth:
            found.append(at(u))
    return min(found)


def depth_safe_condition(t: Number, f0: Number, b: Number, cell_depth: Number, dl: Number) -> Any:
    t, f0, b, depth, dl = map(number, (t, f0, b, cell_depth, dl))
    out = mp.mpf(1)
    ends = [t] if mp.isinf(depth) else [t, t + depth]
    for u in ends:
        bottom = abs(f0 + b * (u - t) - dl * u)
        out = max(out, (f0 + abs(b) * (u + t) + dl * u) / bottom) if bottom else mp.inf
    if b != dl:
        out = max(out, (abs(b) + dl) / abs(b - dl))
        if b * t != f0:
            out = max(out, (abs(b) * t + f0) / abs(b * t - f0))
    return out


def steps_near(t1: Number, t2: Number, s: Number, a: Number) -> Any:
    """Return how often t -> t + c_r(t) fits between t1 and t2: 1/t + 1/s shrinks by a / (a + s) each time."""
    t1, t2, s, a = map(number, (t1, t2, s, a))
    if t2 <= t1:
        return mp.mpf(0)
    if t1 >= a:
        return mp.mpf(1)
    end = 0 if mp.isinf(t2) else 1 / t2
    if s == 0:
        return a * (1 / t1 - end)
    return mp.log((1 / t1 + 1 / s) / (end + 1 / s)) / mp.log((a + s) / a)


def steps_far(t1: Number, t2: Number, s: Number, m: Number, d: Number) -> Any:
    """Return how often t -> t + c_l(t) fits: the same recursion in t + m, with s - m for s and d for a."""
    t1, t2, s, m, d = map(number, (t1, t2, s, m, d))
    if t2 <= t1:
        return mp.mpf(0)
    if t1 + m >= d:
        return mp.mpf(1)
    end = 0 if mp.isinf(t2) else 1 / (t2 + m)
    back = s - m
    if back == 0:
        return d * (1 / (t1 + m) - end)
    return mp.log((1 / (t1 + m) + 1 / back) / (end + 1 / back)) / mp.log((d + back) / d)


def steps_shaft(t1: Number, t2: Number, s: Number, eps1: Number) -> Any:
    """Return how often t -> t + c_s(t) fits: t + s grows by eps / (eps - 1) each time."""
    t1, t2, s, eps1 = map(number, (t1, t2, s, eps1))
    if t2 <= t1:
        return mp.mpf(0)
    if eps1 <= 0:
        return mp.mpf(1)
    return mp.inf if mp.isinf(t2) else mp.log((t2 + s) / (t1 + s)) / mp.log((eps1 + 1) / eps1)


def last_layer(t_far: Number, f0: Number, f1: Number, b: Number, m: Number, is_box: bool, dl: Number) -> Any:
    """Return t_stop of section 7: where dl u^2 / (F0 + b d - dl u) reaches t_far - t, at both ends and between."""
    t_far, f0, f1, b, m, dl = map(number, (t_far, f0, f1, b, m, dl))
    whole = mp.isinf(t_far)
    found = [f0 / dl if whole else f0 * t_far / (f0 + dl * t_far)]
    if is_box:
        found.append(f1 / dl - m if whole else f1 * (t_far + m) / (f1 + dl * (t_far + m)) - m)
    if b > dl:
        if whole and not is_box:
            return mp.inf
        if not whole and b * t_far > f0:
            g = 4 * dl / (b - dl) ** 2
            found.append((t_far + g * f0) / (1 + g * b))
    return min(t_far, max(found))


def vertex_terms(x: Number, d: Number, r: Number, s: Number, low: Number, high: Number, delta: Number) -> Any:
    """Return X (t + d) of the general form at one vertex of the cell."""
    x, d, r, s, low, high, delta = map(number, (x, d, r, s, low, high, delta))
    return r + max(
        low * (s - d) - x, (high - delta) * (s - d) - x, -high * (s - d) + x, -(low + delta) * (s - d) + x
    )  # fmt: skip


def largest_over(t: Number, depth: Sequence[Number], term: Sequence[Number], limit: Number) -> Any:
    """Return max(limit, term_j / (t + depth_j)): X, or X2."""
    t = number(t)
    return max([number(limit), *(number(x) / (t + number(d)) for d, x in zip(depth, term, strict=True))])


def spacing_any(t: Number, s: Number, depth: Sequence[Number], term: Sequence[Number], limit: Number) -> Any:
    """Return Delta (t + s) / (X - Delta), terms given in multiples of Delta."""
    x = largest_over(t, depth, term, limit)
    return (number(t) + number(s)) / (x - 1) if x > 1 else mp.inf


def behind(t: Number, swing: Number, dl: Number) -> Any:
    t, swing, dl = map(number, (t, swing, dl))
    return dl * t / (swing - dl) if swing > dl else mp.inf


def before(t: Number, swing: Number, dl: Number) -> Any:
    t, swing, dl = map(number, (t, swing, dl))
    return dl * t / (swing + dl)


def texel_slope(fov_deg: Number, width: int, height: int, pixel_error: Number, anywhere: bool) -> tuple[Any, Any]:
    """Return (slope of the largest texel, 2 tan(alpha / 2)) of a camera, sections 1 and 2."""
    half_y = mp.tan(mp.radians(number(fov_deg)) / 2)
    half_x = half_y * width / height
    k = 1 + half_x**2 + half_y**2 if anywhere else mp.mpf(1)
    delta = 2 * half_y / height / k
    return delta, number(pixel_error) * delta
