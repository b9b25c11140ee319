"""The formulas of the error metric as scalar numba functions, float64, in forms that neither overflow nor cancel.

Frame: layers are planes z = t > 0, the view cell lies at z <= 0, the reference viewpoint at z = -s. Nothing is checked
here: `farfield.impostor.metric` and `farfield.impostor.plan` do that. Infinity is a legal spacing and depth.
"Centred" means: object and view cell are symmetric about the axis through the reference viewpoint.
"""

import math

import numpy as np
from numba import njit

from farfield.impostor.weight import PAGE_TEXELS

GUARD = 16 * 2.0**-53  # relative; makes a computed spacing never exceed the exact one
INF = np.inf


# Spacing -------------------------------------------------------------------------------------------------------------


@njit(cache=True)
def near_term(n, s, res, delta):
    """Return a of (2): width n of the cell's near face, s of the reference viewpoint, slope delta of a texel."""
    return (n / delta / 2 + (res / 2 - 1) * s) * (1 + GUARD)


@njit(cache=True)
def far_term(n, m, s, res, delta):
    """Return d of (3), boxes only."""
    return (n / delta / 2 + res / 2 * (m - s)) * (1 + GUARD)


@njit(cache=True)
def shaft_term(tangent, res, delta):
    """Return eps - 1 of (5), shafts only; tangent = tan(apex angle / 2)."""
    exact = tangent / delta + (res - 2) / 2
    return exact + GUARD * (abs(exact) + 1)


@njit(cache=True)
def spacing(t, s, is_box, m, a, far):
    """Return the largest gap-free distance from the layer at t to the next, centred: the minimum of (2) and (3) or (5).

    far  d of (3) for a box, eps - 1 of (5) for a shaft
    """
    c = INF
    if t < a:
        c = t * ((t + s) / (a - t))
    if is_box:
        if t + m < far:
            c = min(c, (t + m) * ((t + s) / (far - t - m)))
    elif far > 0:
        c = min(c, (t + s) / far)
    return c


# Border and depth range ----------------------------------------------------------------------------------------------


@njit(cache=True)
def border(t_near, gap, s):
    """Return how far behind the layer at t_near its border to the layer at t_near + gap lies, (6); gap may be inf."""
    if gap == INF:
        return math.sqrt(t_near) * math.sqrt(t_near + s)
    t_far = t_near + gap
    return gap / (1 + math.sqrt(t_far / t_near) * math.sqrt((t_far + s) / (t_near + s)))


@njit(cache=True)
def depth_near(t, s, r, alpha):
    """Return e_near of (7): how far behind t (or before t + e) one layer serves viewpoints on the near face."""
    h = math.tan(alpha / 2)
    q = 0.0
    reach = math.hypot(r, s)
    if reach + r > 0:
        q = r + s / (reach + r) * s / (1 + math.cos(alpha))
    if q <= (2 * t + s) * h:
        return INF
    return t * (2 * h * (t + s) / (q - (2 * t + s) * h))


@njit(cache=True)
def _depth_at(u, t, f0, b, dl):
    bottom = f0 + b * (u - t) - dl * u
    if bottom <= 0:
        return INF
    return dl * u * (u / bottom)


@njit(cache=True)
def depth_safe(t, f0, b, cell_depth, dl):
    """Return e_safe: like e_near, but for every viewpoint of the cell and in 3D. cell_depth is infinite for a shaft."""
    e = _depth_at(t, t, f0, b, dl)
    if cell_depth < INF:
        e = min(e, _depth_at(t + cell_depth, t, f0, b, dl))
    if b > dl:
        u = 2 * (b * t - f0) / (b - dl)
        if t < u < t + cell_depth:
            e = min(e, 4 * dl / (b - dl) * ((b * t - f0) / (b - dl)))
    return e


# Count of layers -----------------------------------------------------------------------------------------------------


@njit(cache=True)
def _log_ratio(z):
    """log1p(z) / z, continuous at 0; z > -1."""
    if abs(z) < 1e-300:
        return 1.0
    return math.log1p(z) / z


@njit(cache=True)
def steps_near(t1, t2, s, a):
    """Return the number of steps t -> t + c_r(t) from t1 to t2 (real, >= 0); 1 where the spacing is infinite."""
    if t2 <= t1:
        return 0.0
    if t1 >= a:
        return 1.0
    x = 1 / t1 if t2 == INF else (t2 - t1) / t1 / (t2 + s)
    return x * a * (_log_ratio(s * x) / _log_ratio(s / a))


@njit(cache=True)
def steps_far(t1, t2, s, m, d):
    """Return the number of steps t -> t + c_l(t) from t1 to t2; 1 where the spacing is infinite already."""
    if t2 <= t1:
        return 0.0
    if t1 + m >= d:
        return 1.0
    x = 1 / (t1 + s) if t2 == INF else (t2 - t1) / (t2 + m) / (t1 + s)
    return x * d * (_log_ratio((m - s) * x) / _log_ratio(-(m - s) / d))


@njit(cache=True)
def steps_shaft(t1, t2, s, eps1):
    """Return the number of steps t -> t + c_s(t) from t1 to t2; 1 where the spacing is infinite already."""
    if t2 <= t1:
        return 0.0
    if eps1 <= 0:
        return 1.0
    return math.log1p((t2 - t1) / (t1 + s)) / -math.log1p(-1 / (eps1 + 1))


@njit(cache=True)
def steps(t1, t2, s, is_box, m, a, far):
    """Return N(t1, t2), an upper bound (give or take one) of the steps from t1 to t2; may be infinite."""
    if is_box:
        switch = a * (m / (far - a)) if far > a else INF
        return steps_near(t1, min(t2, switch), s, a) + steps_far(max(t1, switch), t2, s, m, far)
    eps = far + 1
    switch = a / eps if eps > 0 else INF
    return steps_near(t1, min(t2, switch), s, a) + steps_shaft(max(t1, switch), t2, s, far)


@njit(cache=True)
def last_layer(t_far, f0, f1, b, m, is_box, dl):
    """Return an upper bound of where the last layer is needed: from there on it serves to t_far (may be infinite)."""
    last = f0 / (f0 / t_far + dl)
    if is_box:
        last = max(last, f1 / (f1 / (t_far + m) + dl) - m)
    if b > dl:
        if t_far == INF:
            if not is_box:
                return INF
        elif b * t_far > f0:
            inverse = (b - dl) * ((b - dl) / dl) / 4
            last = max(last, (inverse * t_far + f0) / (inverse + b))
    return min(t_far, last)


# Any convex view cell ------------------------------------------------------------------------------------------------


@njit(cache=True)
def vertex_terms(x, d, r, s, low, high, delta):
    """Return what a vertex of the cell adds to X (t + d) of the general form, one axis, guard included.

    x, d  its offset from the reference viewpoint's axis and its depth in the cell; r >= 0 widens it (round shafts)
    low, high  slopes of the frustum; delta  slope of a texel
    """
    reach = s - d
    worst = max(max(low * reach, (high - delta) * reach) - x, max(-high * reach, -(low + delta) * reach) + x) + r
    scale = (abs(low) + abs(high) + delta) * (s + d) + abs(x) + r
    return worst + GUARD * scale


@njit(cache=True)
def spacing_any(t, s, depth, term, limit):
    """Return the gap-free spacing of the general form.

    depth, term  (J,) depths d_j of the cell's vertices, and the larger over both axes of X_j (t + d_j) / Delta
    limit        the same for the directions of a cell without far end: X / Delta; 0 if there are none
    """
    x = limit
    for j in range(len(depth)):
        x = max(x, term[j] / (t + depth[j]))
    if x <= 1:
        return INF
    return (t + s) / (x - 1)


@njit(cache=True)
def swing_any(t, depth, offset, limit):
    """Return X2: the largest |th (s - d) - x| / (t + d), vectors in x and y, over the cell."""
    x = limit
    for j in range(len(depth)):
        x = max(x, offset[j] / (t + depth[j]))
    return x


@njit(cache=True)
def behind(t, swing, dl):
    """Return how far behind a layer at t points may lie that it shows; swing = X2(t)."""
    return INF if swing <= dl else t * (dl / (swing - dl))


@njit(cache=True)
def before(t, swing, dl):
    """Return how far in front of a layer at t points may lie that it shows; swing = X2(t). Always below t."""
    return t * (dl / (swing + dl))


@njit(cache=True)
def stack(t0, t_far, s, dl, depth, term, offset, term_limit, offset_limit, plane, near, far):
    """Place layers from t0 to t_far (finite) for any convex cell; return their count, or -1 if they exceed len(plane).

    First and last layer as in section 6, spacing by `spacing_any`; on top of it each range is held to what its layer
    may show (`behind`, `before`), so that the parallax stays below alpha also where the spacing alone allows more
    (few texels, pixel errors below one). Arrays as in `spacing_any`, `swing_any`; plane, near, far (limit,) are filled.
    """
    front = behind(t0, swing_any(t0, depth, offset, offset_limit), dl)
    start = t0
    if t0 + front >= t_far:
        t = t0 + border(t0, t_far - t0, s)
    else:
        t = t0 + front
    count = 0
    while True:
        if count == len(plane):
            return -1
        reach = behind(t, swing_any(t, depth, offset, offset_limit), dl)
        plane[count], near[count] = t, start
        count += 1
        if t + reach >= t_far:
            far[count - 1] = t_far
            return count
        c = min(spacing_any(t, s, depth, term, term_limit), t_far - t)
        # widest gap that the ranges of both layers cover together, by a fixed point from below
        c_seen = reach
        for _ in range(4):
            c_seen = reach + before(t + c_seen, swing_any(t + c_seen, depth, offset, offset_limit), dl)
            if c_seen >= c:
                break
        c = min(c, c_seen)
        t_next = t + c
        d = border(t, c, s)
        d = min(d, reach)
        d = max(d, c - before(t_next, swing_any(t_next, depth, offset, offset_limit), dl))
        start = t + d
        far[count - 1] = start
        t = t_next


@njit(cache=True)
def cut_triangles(width, height):
    """Return how many triangles a layer of width x height texels gains at most when it is cut into pages.

    A straight cut of a convex polygon adds four corners to its two parts, hence two triangles; columns are cut first,
    then each into rows.
    """
    pieces = math.ceil(width / PAGE_TEXELS) * math.ceil(height / PAGE_TEXELS)
    return 2 * max(0, pieces - 1)
