"""Every formula against 50 digits over its whole domain, the stiff ends of float64 included.

Where a formula has a pole (a spacing or depth that becomes infinite) its arguments' last digits decide all of the
result's: there the bound is LIMIT times `condition`, and that the result errs to the small side is tested apart.
"""

import math

import mpmath as mp
import numpy as np
import pytest
from farfield.evaluation import exact
from farfield.impostor import kernels
from farfield.impostor.plan import precision
from farfield.settings import CameraSettings, QualitySettings, Settings

LIMIT = 1e-12
INF = math.inf
U = 2.0**-53
RNG_ROWS = 400


@pytest.fixture(autouse=True)
def digits():
    with mp.workdps(exact.DIGITS + exact.GUARD_DIGITS):
        yield


def log_uniform(rng, low, high):
    return float(10 ** rng.uniform(low, high))


def scale_of(rng):
    """A unit of length: mostly metres, else what would overflow or vanish in a square."""
    return 10.0 ** int(rng.choice([0, 0, 0, 140, -140, 75, -75]))


def near(found, wanted, condition=1.0, limit=LIMIT):
    if mp.isinf(wanted) or math.isinf(found):
        # on the other side of a threshold only if the threshold is within rounding
        return mp.isinf(wanted) == math.isinf(found) or condition > 1e-3 / U
    return abs(exact.number(found) - wanted) <= limit * abs(wanted) * max(1, condition)


def test_terms_of_spacing():
    rng = np.random.default_rng(0)
    for _ in range(RNG_ROWS):
        unit = scale_of(rng)
        s, n, m = (unit * rng.choice([0.0, 1.0, 1.0]) * log_uniform(rng, -12, 12) for _ in range(3))
        res, delta = float(rng.choice([1, 2, 3, 4, 65, 4096])), log_uniform(rng, -9, 2)
        assert near(
            kernels.near_term(n, s, res, delta), exact.near_term(n, s, res, delta) * (1 + 16 * exact.number(U)), 1e3
        )
        wanted = exact.near_term(n, s, res, delta)
        cancels = (n / delta / 2 + abs(res / 2 - 1) * s) / abs(float(wanted)) if wanted else INF
        assert near(kernels.near_term(n, s, res, delta), wanted, cancels) or not wanted
        far = exact.far_term(n, m, s, res, delta)
        cancels = (
            float((exact.number(n) / (2 * exact.number(delta)) + exact.number(res) / 2 * (m + s)) / abs(far))
            if far
            else INF
        )
        assert near(kernels.far_term(n, m, s, res, delta), far, cancels) or not far
        tangent = rng.choice([0.0, 1.0]) * log_uniform(rng, -300, 8)
        wanted, found = exact.shaft_term(tangent, res, delta), kernels.shaft_term(tangent, res, delta)
        assert found >= wanted  # the guard: what is rounded up makes spacing smaller
        assert abs(found - wanted) <= 40 * U * (abs(wanted) + 1)


def test_spacing_and_which_way_it_errs():
    rng = np.random.default_rng(1)
    poles = 0
    for _ in range(3 * RNG_ROWS):
        unit, is_box = scale_of(rng), bool(rng.integers(2))
        t = unit * log_uniform(rng, -3, 3)
        s, m = (unit * rng.choice([0.0, 1.0]) * log_uniform(rng, -15, 4) for _ in range(2))
        close = 1 + rng.choice([-1, 1]) * log_uniform(rng, -16, 1)  # next to the pole as often as far from it
        a = max(t * close, 0.0)
        far = (t + m) * close if is_box else rng.choice([-0.5, 0.0, log_uniform(rng, -20, 4)])
        found, wanted = kernels.spacing(t, s, is_box, m, a, far), exact.spacing(t, s, is_box, m, a, far)
        condition = exact.spacing_condition(t, m, a, far, is_box)
        poles += condition > 1e12
        assert near(found, wanted, condition), (t, s, is_box, m, a, far)
        assert found > 0
        # with the guard of the terms it never exceeds the exact spacing
        guarded = kernels.spacing(
            t, s, is_box, m, a * (1 + kernels.GUARD), far + kernels.GUARD * (abs(far) + (t + m if is_box else 1))
        )
        assert guarded <= wanted
    assert poles > 30


def test_border_over_all_scales():
    rng = np.random.default_rng(2)
    for _ in range(RNG_ROWS):
        t, s = log_uniform(rng, -150, 150), float(rng.choice([0.0, 1.0])) * log_uniform(rng, -150, 150)
        gap = t * log_uniform(rng, -15, 100)
        with mp.workdps(700):
            assert near(kernels.border(t, gap, s), exact.border(t, gap, s), limit=1e-14)
            assert near(kernels.border(t, INF, s), exact.border(t, INF, s), limit=1e-14)


def test_depth_of_one_viewpoint():
    rng = np.random.default_rng(3)
    for _ in range(RNG_ROWS):
        unit, alpha = scale_of(rng), log_uniform(rng, -9, 0.19)
        t = unit * log_uniform(rng, -3, 3)
        s, r = (unit * rng.choice([0.0, 1.0, 1.0]) * log_uniform(rng, -18, 4) for _ in range(2))
        if rng.random() < 0.3:  # at the threshold q = (2 t + s) h
            r, s = 2 * t * math.tan(alpha / 2) * (1 + rng.choice([-1, 1]) * log_uniform(rng, -15, -3)), 0.0
        condition = exact.depth_near_condition(t, s, r, alpha)
        assert near(kernels.depth_near(t, s, r, alpha), exact.depth_near(t, s, r, alpha), condition), (t, s, r, alpha)


def test_depth_of_all_viewpoints():
    rng = np.random.default_rng(4)
    between = 0
    for _ in range(2 * RNG_ROWS):
        unit, dl = scale_of(rng), log_uniform(rng, -8, -0.5)
        t = unit * log_uniform(rng, -3, 3)
        depth = float(rng.choice([0.0, INF, unit * log_uniform(rng, -6, 4)]))
        f0 = unit * float(rng.choice([0.0, 1.0, 1.0])) * log_uniform(rng, -12, 3)
        b = float(rng.choice([0.0, 1.0, 1.0, -1.0])) * log_uniform(rng, -6, 1)
        if depth in (0.0, INF):
            b = abs(b) * (depth > 0)
        elif b < 0:
            b = max(b, -f0 / depth)  # F1 = F0 + b m is not negative
        if rng.random() < 0.2:
            f0 = dl * t * (1 + rng.choice([-1, 1]) * log_uniform(rng, -15, -2))
        if rng.random() < 0.1:
            b = dl * (1 + rng.choice([-1, 1]) * log_uniform(rng, -15, -2))
        found, wanted = kernels.depth_safe(t, f0, b, depth, dl), exact.depth_safe(t, f0, b, depth, dl)
        condition = exact.depth_safe_condition(t, f0, b, depth, dl)
        assert near(found, wanted, condition * 8), (t, f0, b, depth, dl)
        ends = exact.depth_safe(t, f0, 0, 0, dl), exact.depth_safe(t, f0, b, depth, dl)
        between += ends[0] > ends[1]
        # no depth of the cell allows less
        if not mp.isinf(wanted):
            for d in rng.uniform(0, 1, 5) * (min(depth, 1e3 * t)):
                u = exact.number(t) + exact.number(d)
                bottom = f0 + exact.number(b) * d - dl * u
                assert bottom <= 0 or dl * u * u / bottom >= wanted * (1 - mp.mpf(10) ** -40)
    assert between > 15


def test_counts_in_constant_time():
    rng = np.random.default_rng(5)
    for _ in range(2 * RNG_ROWS):
        t1 = log_uniform(rng, -3, 3)
        t2 = t1 * (1 + log_uniform(rng, -14, 4)) if rng.random() < 0.9 else INF
        s, m = (rng.choice([0.0, 1.0, 1.0]) * log_uniform(rng, -14, 4) for _ in range(2))
        s = min(s, m) if rng.random() < 0.5 else s
        a, d = t1 * (1 + log_uniform(rng, -3, 8)), (t1 + m) * (1 + log_uniform(rng, -3, 8))
        assert near(kernels.steps_near(t1, t2, s, a), exact.steps_near(t1, t2, s, a), 1 + t1 / max(t2 - t1, 1e-300)), (
            t1,
            t2,
            s,
            a,
        )
        back = min(s, m)
        magnified = 1 + (t1 + m) / max(t2 - t1, 1e-300) + d / (d - t1 - m)
        found, wanted = kernels.steps_far(t1, t2, back, m, d), exact.steps_far(t1, t2, back, m, d)
        assert near(found, wanted, magnified), (t1, t2, back, m, d)
        eps1 = log_uniform(rng, -12, 12)
        if t2 < INF:
            assert near(
                kernels.steps_shaft(t1, t2, s, eps1),
                exact.steps_shaft(t1, t2, s, eps1),
                1 + (t1 + s) / max(t2 - t1, 1e-300) + 1 / eps1,
            ), (t1, t2, s, eps1)
    assert kernels.steps_near(1.0, 1.0, 0.5, 3.0) == kernels.steps_far(2.0, 1.0, 0.1, 1.0, 9.0) == 0
    assert (
        kernels.steps_near(4.0, 5.0, 0.0, 3.0)
        == kernels.steps_far(9.0, INF, 0.0, 1.0, 9.0)
        == kernels.steps_shaft(1, 2, 0, 0)
        == 1
    )


def test_where_the_last_layer_is_needed():
    rng = np.random.default_rng(6)
    for _ in range(2 * RNG_ROWS):
        unit, dl, is_box = scale_of(rng), log_uniform(rng, -8, -0.5), bool(rng.integers(2))
        t_far = unit * log_uniform(rng, -2, 4) if rng.random() < 0.85 else INF
        f0, f1, m = (unit * float(rng.choice([0.0, 1.0, 1.0])) * log_uniform(rng, -9, 4) for _ in range(3))
        if not is_box:
            f1 = m = 0.0
        b = ((f1 - f0) / m if m > 0 else 0.0) if is_box else log_uniform(rng, -6, 1)
        found = kernels.last_layer(t_far, f0, f1, b, m, is_box, dl)
        wanted = exact.last_layer(t_far, f0, f1, b, m, is_box, dl)
        if is_box and not mp.isinf(wanted):  # F1 / (...) - m may cancel: errs by that of m
            assert abs(exact.number(found) - wanted) <= LIMIT * (abs(wanted) + m) * float(
                exact.depth_safe_condition(unit, 0, b, INF, dl)
            )
        else:
            assert near(found, wanted, exact.depth_safe_condition(unit, 0, b, INF, dl)), (t_far, f0, b, is_box, dl)


def test_the_general_form():
    rng = np.random.default_rng(7)
    finite = 0
    for _ in range(RNG_ROWS):
        unit = scale_of(rng)
        depth = np.concatenate([[0.0], unit * 10 ** rng.uniform(-4, 3, 3)])
        s, t = unit * float(rng.choice([0.0, 1.0])) * log_uniform(rng, -9, 3), unit * log_uniform(rng, -2, 3)
        low = rng.choice([-1, 1]) * log_uniform(rng, -6, 0.5)
        high = low + log_uniform(rng, -9, 0.5)
        delta = (high - low) / float(rng.choice([1, 2, 4, 333]))
        term, wanted = np.empty(4), []
        for j, d in enumerate(depth):
            x, r = (
                unit * rng.choice([-1, 0, 1]) * log_uniform(rng, -6, 3),
                unit * float(rng.choice([0, 1])) * log_uniform(rng, -6, 2),
            )
            found, true = (
                kernels.vertex_terms(x, d, r, s, low, high, delta),
                exact.vertex_terms(x, d, r, s, low, high, delta),
            )
            size = (abs(low) + abs(high) + delta) * (s + d) + abs(x) + r
            assert true <= found <= true + 40 * U * size  # never less than the exact one
            term[j] = found / delta
            wanted.append(true / exact.number(delta))
        limit = float(rng.choice([0.0, 1.0])) * log_uniform(rng, -3, 4)
        found = kernels.spacing_any(t, s, depth, term, limit)
        exactly = exact.spacing_any(t, s, depth, term.tolist(), limit)
        largest = exact.largest_over(t, depth, term.tolist(), limit)
        assert near(found, exactly, largest / abs(largest - 1)), (t, s, depth, term, limit)
        finite += found < INF
        swing = kernels.swing_any(t, depth, np.abs(term), limit)
        assert near(swing, exact.largest_over(t, depth, np.abs(term).tolist(), limit))
        dl = log_uniform(rng, -8, -0.5)
        if swing > 0:
            condition = (swing + dl) / max(abs(swing - dl), 1e-300)
            assert near(kernels.behind(t, swing, dl), exact.behind(t, swing, dl), condition)
            assert near(kernels.before(t, swing, dl), exact.before(t, swing, dl))
    assert finite > 60


def test_resolution_in_the_centre_and_anywhere():
    for fov, width, height in ((45.0, 1280, 720), (0.01, 16, 16), (150.0, 16384, 16), (90.0, 100, 3000)):
        for error in (1e-6, 0.5, 1.0, 64.0):
            for at in ("centre", "anywhere"):
                camera = CameraSettings(fov_deg=fov, width=width, height=height)
                found = precision(Settings(camera=camera, quality=QualitySettings(pixel_error=error, pixels_at=at)))
                delta, dl = exact.texel_slope(fov, width, height, error, at == "anywhere")
                assert near(found.delta, delta) and near(found.dl, dl)
