"""The formulas against 50 digits, the layers against rays, the count in constant time against the loop."""

import math

import mpmath as mp
import numpy as np
import pytest
from farfield.errors import ObjectTouchesViewCell, OutOfDomain
from farfield.impostor import kernels
from farfield.impostor.metric import Setup, best_viewpoint, depth_range, estimate, place_layers, spacing

mp.mp.dps = 50  # of the result; `border` cancels, and gets more
INF = math.inf


def exact(x):
    return mp.mpf(float(x))


def relative(found, wanted):
    return float(abs(exact(found) - wanted) / abs(wanted)) if wanted else abs(found)


def log_uniform(rng, low, high):
    return float(10 ** rng.uniform(low, high))


def some_setup(rng, *, deep=1.5):
    """Objects and cells of all proportions, half of them boxes; depth may be infinite where that ends."""
    t0 = log_uniform(rng, -2, 4)
    w = (t0 * log_uniform(rng, -1.5, 0.6), t0 * log_uniform(rng, -1.5, 0.6))
    res = (float(rng.integers(4, 600)), float(rng.integers(4, 600)))
    alpha = 2 * math.atan(max(w[0] / res[0], w[1] / res[1]) / t0 / 2)
    n = (t0 * log_uniform(rng, -3, 0.7), t0 * log_uniform(rng, -3, 0.7)) if rng.random() < 0.9 else (0.0, 0.0)
    is_box = bool(rng.random() < 0.5)
    m = 0.0 if rng.random() < 0.1 else t0 * log_uniform(rng, -2, 0.7)
    beta = 0.0 if rng.random() < 0.1 else log_uniform(rng, -1, 2)
    depth = INF if rng.random() < 0.1 else t0 * log_uniform(rng, -2, deep)
    return Setup(
        is_box=is_box, t0=t0, t_far=t0 + depth, w=w, res=res, n=n, m=m if is_box else 0.0,
        beta_deg=0.0 if is_box else beta, alpha_rad=min(alpha, 1.5),
    )  # fmt: skip


def some_viewpoint(rng, setup):
    return float(rng.uniform(0, setup.m) if setup.is_box else rng.choice([0, max(setup.n) * rng.uniform(0, 5)]))


@mp.workdps(200)
def test_border_against_fifty_digits():
    rng = np.random.default_rng(0)
    for _ in range(2000):
        t, s = log_uniform(rng, -60, 60), rng.choice([0.0, 1.0]) * log_uniform(rng, -60, 60)
        c = t * log_uniform(rng, -13, 3)
        near, far, back = exact(t), exact(t) + exact(c), exact(s)
        if s == 0:
            wanted = 2 * near * far / (near + far) - near
        else:
            root = mp.sqrt((1 + back / near) * (1 + back / far))
            wanted = back / (root - 1) - near
        found = kernels.border(t, c, s)
        assert relative(found, wanted) < 1e-14, (t, c, s)
        assert 0 <= found <= c / 2 * (1 + 1e-15)
    # infinity is the limit
    assert kernels.border(3.0, INF, 2.0) == pytest.approx(kernels.border(3.0, 1e18, 2.0), rel=1e-8)
    assert kernels.border(1e200, INF, 0.0) == pytest.approx(1e200)


def test_spacing_never_exceeds_the_exact_one():
    rng = np.random.default_rng(1)
    tight = 0
    for _ in range(3000):
        setup = some_setup(rng)
        s = some_viewpoint(rng, setup)
        t = setup.t0 * log_uniform(rng, 0, 3)
        wanted = exact_spacing(setup, exact(t), exact(s))
        found = spacing(setup, t, s)
        if wanted is None:
            tight += found == INF
            continue
        assert found <= wanted, (setup, t, s)
        if found < INF and found < 1e3 * (t + s):  # far from the infinite case rounding is all that is lost
            assert relative(found, wanted) < 1e-10
    assert tight > 50


def exact_spacing(setup, t, s):
    """Equations (2), (3), (5) as published; None: infinite."""
    found = []
    terms = {"near": [], "far": []}
    for w, res, n in zip(setup.w, setup.res, setup.n, strict=True):
        w, res, n = exact(w), exact(res), exact(n)
        delta = w / (res * (exact(setup.t0) + s))
        terms["near"].append(n / (2 * delta) + (res / 2 - 1) * s)
        tangent = mp.tan(mp.radians(exact(setup.beta_deg)) / 2)
        far = n / (2 * delta) + res / 2 * (exact(setup.m) - s) if setup.is_box else tangent / delta + res / 2
        terms["far"].append(far)
    a, far, m = max(terms["near"]), max(terms["far"]), exact(setup.m)
    if t < a:
        found.append(t * (t + s) / (a - t))
    if setup.is_box and t + m < far:
        found.append((t + m) * (t + s) / (far - t - m))
    if not setup.is_box and far > 1:
        found.append((t + s) / (far - 1))
    return min(found) if found else None


def test_depth_near_against_the_least_over_all_directions():
    rng = np.random.default_rng(2)
    for _ in range(300):
        t, s, r = log_uniform(rng, -1, 3), rng.choice([0, log_uniform(rng, -1, 2)]), log_uniform(rng, -2, 2)
        alpha = log_uniform(rng, -4, -1)
        found = kernels.depth_near(t, float(s), r, alpha)
        # a point of the layer, in every direction from the viewpoint (r, 0), and one e behind it on the ray of slope x from
        # the reference viewpoint
        x = (r + t * np.tan(np.linspace(-1.57, 1.57, 20001))) / (t + s)
        if found == INF:
            found = 1e9 * t
        a, b = np.arctan2(x * (t + s) - r, t), np.arctan2(x * (t + found + s) - r, t + found)
        worst = abs(a - b).max()
        assert worst <= alpha * (1 + 1e-6)
        assert found == 1e9 * t or worst >= alpha * (1 - 1e-5)


def test_no_viewpoint_sees_a_point_off_by_more_than_alpha():
    rng = np.random.default_rng(3)
    worst = 0.0
    for _ in range(400):
        setup = some_setup(rng)
        s = some_viewpoint(rng, setup)
        t = setup.t0 * log_uniform(rng, 0, 1)
        e = depth_range(setup, t, s)
        if e == INF:
            e = 1e6 * t
        k = 150
        d = rng.choice([0.0, 1.0, rng.random()], k) * (setup.m if setup.is_box else 50 * setup.t0)
        half = np.array(setup.n) / 2 + d[:, None] * (0 if setup.is_box else setup.tangent)
        view = np.column_stack([rng.choice([-1, 1], (k, 2)) * half * rng.choice([1, 1, rng.random()], (k, 1)), -d])
        tau = np.array(setup.w) / 2 / (setup.t0 + s)
        slope = rng.choice([-1, 1], (k, 2)) * tau * rng.choice([1, 1, rng.random()], (k, 1))
        a, b = (np.column_stack([slope * (z + s), np.full(k, z)])[None] - view[:, None] for z in (t, t + e))
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))
        assert angle.max() <= setup.alpha_rad * (1 + 1e-6) + 1e-12, (setup, t, s, e)
        worst = max(worst, angle.max() / setup.alpha_rad)
    assert worst > 0.9


def test_no_layer_moves_by_more_than_a_texel_against_the_next():
    rng = np.random.default_rng(4)
    checked = 0
    for _ in range(150):
        setup = some_setup(rng, deep=0.3)
        try:
            if estimate(setup, best_viewpoint(setup)) > 500:
                continue
            layers = place_layers(setup)
        except OutOfDomain:
            continue
        s, t = layers.s, layers.t[:-1]
        if not len(t):
            continue
        c = np.diff(layers.t)
        if not np.isfinite(c).all():
            c = np.minimum(c, 1e9 * t)
        checked += 1
        for w, res, n in zip(setup.w, setup.res, setup.n, strict=True):
            tau, delta = w / 2 / (setup.t0 + s), w / res / (setup.t0 + s)
            edges = np.linspace(-tau, tau, int(res) + 1)[1:-1]
            for d in (0.0, setup.m) if setup.is_box else (0.0, setup.t0, 1e3 * setup.t0):
                for x in np.array([-1, 1]) * (n / 2 + (0 if setup.is_box else d * setup.tangent)):
                    moved = c * abs(edges[:, None] * (s - d) - x) / ((t + d) * delta * (t + s + c))
                    assert moved.max() <= 1 + 1e-9, (setup, s, d, x)
    assert checked > 40


def test_no_point_of_the_object_is_shown_off_by_more_than_alpha():
    """All layers of a stack, in 3D: points anywhere in a slab, above all at its ends, from on and inside the cell."""
    rng = np.random.default_rng(7)
    worst, checked = 0.0, 0
    while checked < 150:
        setup = some_setup(rng, deep=0.5)
        if estimate(setup, best_viewpoint(setup)) > 300:
            continue
        layers = place_layers(setup)
        checked += 1
        k = rng.integers(0, len(layers.t), 300)
        near, far = layers.near[k], np.minimum(layers.far[k], 1e7 * layers.near[k])
        z = np.where(
            rng.random(300) < 0.4, near, np.where(rng.random(300) < 0.7, far, near + (far - near) * rng.random(300))
        )
        t = np.minimum(layers.t[k], 1e9 * layers.near[k])
        tau = np.array(setup.w) / 2 / (setup.t0 + layers.s)
        slope = rng.choice([-1, 1], (300, 2)) * tau * rng.choice([1, 1, rng.random()], (300, 1))
        d = rng.choice([0.0, 1.0, rng.random()], 100) * (setup.m if setup.is_box else 30 * setup.t0)
        half = np.array(setup.n) / 2 + d[:, None] * (0 if setup.is_box else setup.tangent)
        view = np.column_stack([rng.choice([-1, 1], (100, 2)) * half * rng.choice([1, 1, rng.random()], (100, 1)), -d])
        a, b = (np.column_stack([slope * (q + layers.s)[:, None], q])[None] - view[:, None] for q in (z, t))
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))
        assert angle.max() <= setup.alpha_rad * (1 + 1e-6) + 1e-12, (setup, layers.s, angle.max() / setup.alpha_rad)
        worst = max(worst, angle.max() / setup.alpha_rad)
    assert worst > 0.8


def test_the_count_in_constant_time_bounds_the_loop():
    rng = np.random.default_rng(5)
    exact_ones = many = 0
    for _ in range(3000):
        setup = some_setup(rng)
        s = some_viewpoint(rng, setup)
        bound = estimate(setup, s)
        if bound > 2000:
            continue
        layers = place_layers(setup, s=s)
        assert len(layers.t) <= bound == layers.estimate, (setup, s)
        many += len(layers.t) > 3
        exact_ones += len(layers.t) == bound
        assert layers.near[0] == setup.t0
        assert layers.far[-1] == setup.t_far
        np.testing.assert_array_equal(layers.near[1:], layers.far[:-1])
        assert (np.diff(layers.t) > 0).all()
        assert (layers.near <= layers.t).all()
        assert (layers.t <= layers.far).all()
    assert many > 300
    assert exact_ones > 0.5 * 3000 * 0.8


def test_scaling_all_lengths_scales_the_layers():
    rng = np.random.default_rng(6)
    for _ in range(300):
        setup = some_setup(rng, deep=0)
        if estimate(setup, best_viewpoint(setup)) > 1000:
            continue
        pair = lambda v: (v[0] * 1024, v[1] * 1024)  # noqa: E731
        large = Setup(
            is_box=setup.is_box, t0=setup.t0 * 1024, t_far=setup.t_far * 1024, w=pair(setup.w), res=setup.res,
            n=pair(setup.n), m=setup.m * 1024, beta_deg=setup.beta_deg, alpha_rad=setup.alpha_rad,
        )  # fmt: skip
        np.testing.assert_array_equal(place_layers(large).t, place_layers(setup).t * 1024)


def test_extremes_keep_to_their_limits():
    point = Setup(is_box=True, t0=10, t_far=INF, w=(5, 5), res=(64, 64), alpha_rad=0.01)
    assert len(place_layers(point).t) == 1  # a cell that is a point, seen from it, needs one layer
    line = Setup(is_box=True, t0=10, t_far=INF, w=(5, 5), res=(64, 64), m=4, alpha_rad=0.002)
    assert 1 < len(place_layers(line, s=0.0).t) < 200
    ray = Setup(is_box=False, t0=10, t_far=500, w=(5, 5), res=(64, 64), alpha_rad=0.002)
    assert len(place_layers(ray).t) > 1  # backing off along the axis moves everything off it
    assert spacing(Setup(is_box=False, t0=10, t_far=500, w=(5, 5), res=(2, 2), alpha_rad=0.1), 10.0, 0.0) > 1e12
    for res in (1, 2, 3):
        few = Setup(is_box=True, t0=10, t_far=40, w=(5, 5), res=(res, res), n=(3, 3), m=3, alpha_rad=0.2)
        assert 1 <= len(place_layers(few).t) <= place_layers(few).estimate
    huge = Setup(is_box=True, t0=1e160, t_far=3e160, w=(1e160, 1e160), res=(64, 64), n=(1e159, 1e159), m=1e159,
                 alpha_rad=1 / 64)  # fmt: skip
    assert 1 < len(place_layers(huge).t) < 50
    wide = Setup(is_box=False, t0=1, t_far=2, w=(1, 1), res=(64, 64), beta_deg=179.999, alpha_rad=0.01)
    assert wide.tangent == pytest.approx(2 * 180 / math.pi / 0.001, rel=1e-6)


@pytest.mark.parametrize("wrong", [
    {"t0": 0.0}, {"t0": -1.0}, {"t0": math.nan}, {"t0": INF}, {"t_far": 9.0}, {"t_far": math.nan}, {"w": (0.0, 1.0)},
    {"w": (1.0, INF)}, {"res": (0.5, 4)}, {"res": (4, math.nan)}, {"n": (-1.0, 0)}, {"n": (0, INF)}, {"m": -1.0},
    {"m": math.nan}, {"beta_deg": 180.0}, {"beta_deg": 360.0}, {"beta_deg": -1.0}, {"alpha_rad": 0.0},
    {"alpha_rad": math.pi / 2},
])  # fmt: skip
def test_outside_the_domain_is_refused(wrong):
    given = {"is_box": True, "t0": 10.0, "t_far": 20.0, "w": (1.0, 1.0), "res": (8, 8), "alpha_rad": 0.01} | wrong
    with pytest.raises(ObjectTouchesViewCell if given["t0"] <= 0 else OutOfDomain):
        place_layers(Setup(**given))


def test_viewpoints_outside_the_cell_and_endless_stacks_are_refused():
    box = Setup(is_box=True, t0=10, t_far=20, w=(1, 1), res=(8, 8), m=2, n=(1, 1), alpha_rad=0.01)
    for s in (-1.0, 2.5, math.nan, INF):
        with pytest.raises(OutOfDomain):
            place_layers(box, s=s)
    with pytest.raises(OutOfDomain):  # c < u t: the loop would never end
        place_layers(Setup(is_box=True, t0=1, t_far=2, w=(1, 1), res=(64, 64), n=(1e18, 1), alpha_rad=0.01))
    with pytest.raises(OutOfDomain):  # geometric spacing never reaches infinity
        place_layers(
            Setup(is_box=False, t0=1, t_far=INF, w=(1, 1), res=(64, 64), n=(1, 1), beta_deg=30, alpha_rad=0.01)
        )
