"""Layers of a centred impostor, in the frame of the papers: `farfield layers`, and a check on `farfield.impostor.plan`.

Problem  An object lies between t0 and t_far in front of a view cell. Where must layers stand so that, from anywhere in
         the cell, no gap of more than a texel opens between them and nothing is seen off by more than alpha?
Method   First layer as far behind t0 as may be (7), then the largest gap-free step (2), (3), (5), until a layer
         serves to t_far; borders by (6). A count in constant time comes first, so that no loop is entered in vain. The
         reference viewpoint s is searched: the estimate decides, ties go to the smallest.
After    Jeschke and Wimmer. An Error Metric for Layered Environment Map Impostors. 2002. Changed: parallax from every
         viewpoint in 3D (`depth_safe`), the last layer clamped to t_far, stable forms.
"""

import math
from dataclasses import dataclass

import numpy as np

from farfield.errors import ObjectTouchesViewCell, OutOfDomain
from farfield.impostor import kernels

MOST_LAYERS = 100_000  # beyond this no list is made
BOX_VIEWPOINTS = (0.0, 0.025, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.75, 1.0)  # of the cell's depth
SHAFT_VIEWPOINTS = (0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0)  # of its near end's width


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """A centred object and view cell; lengths in one unit, t from the cell's near face, pairs are (x, y)."""

    is_box: bool  # else a shaft of square section
    t0: float  # > 0
    t_far: float  # >= t0, may be inf
    w: tuple[float, float]  # width of the object, > 0
    res: tuple[float, float]  # texels across w, >= 1
    n: tuple[float, float] = (0.0, 0.0)  # width of the cell, of a shaft's near end; >= 0
    m: float = 0.0  # depth of a box cell, >= 0
    beta_deg: float = 0.0  # apex angle of a shaft, [0, 180)
    alpha_rad: float  # admissible parallax, (0, pi / 2)

    @property
    def tangent(self) -> float:
        """T = tan(beta / 2), without losing digits towards 180 degrees."""
        if self.beta_deg <= 90:
            return math.tan(math.radians(self.beta_deg) / 2)
        return 1 / math.tan(math.radians(180 - self.beta_deg) / 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Layers:
    """Layers near to far: positions t and adjoining slabs [near, far]; `estimate` bounds their count without a loop."""

    s: float
    estimate: int
    t: np.ndarray  # (K,) f64
    near: np.ndarray  # (K,) f64
    far: np.ndarray  # (K,) f64


@dataclass(frozen=True, slots=True, kw_only=True)
class _Terms:
    """What the kernels take, for one s."""

    a: float
    far: float  # d of (3) for a box, eps - 1 of (5) for a shaft
    f0: float
    f1: float
    b: float
    depth: float  # of the cell; inf for a shaft
    r: float  # axis to corner of the near face
    dl: float


def check(setup: Setup) -> None:
    """Refuse what the formulas do not hold for. Raises ObjectTouchesViewCell, OutOfDomain."""

    def need(condition: bool, what: str) -> None:
        if not condition:  # NaN fails every comparison
            raise OutOfDomain(what)

    s = setup
    need(not math.isnan(s.t0) and s.t0 < math.inf, "t0 must be a finite distance")
    if s.t0 <= 0:
        raise ObjectTouchesViewCell(f"the object touches the view cell: t0 = {s.t0:g}")
    need(s.t_far >= s.t0, "the object's depth must not be negative")
    for axis, w, res, n in zip("xy", s.w, s.res, s.n, strict=True):
        need(0 < w < math.inf, f"the object's width in {axis} must be positive and finite")
        need(1 <= res < math.inf, f"the resolution in {axis} must be at least 1")
        need(0 <= n < math.inf, f"the view cell's width in {axis} must be finite and not negative")
    need(0 <= s.m < math.inf, "the view cell's depth must be finite and not negative")
    need(0 <= s.beta_deg < 180, "the shaft's apex angle must be in [0, 180) degrees")
    need(0 < s.alpha_rad < math.pi / 2, "the parallax angle must be in (0, pi / 2)")


def _check_s(setup: Setup, s: float) -> None:
    if not 0 <= s < math.inf:
        raise OutOfDomain("the reference viewpoint s must be finite and not negative")
    if setup.is_box and s > setup.m:
        raise OutOfDomain(f"the reference viewpoint s = {s:g} lies behind the box cell of depth {setup.m:g}")


def _terms(setup: Setup, s: float) -> _Terms:
    at = setup.t0 + s
    tau = [w / at / 2 for w in setup.w]
    delta = [w / res / at for w, res in zip(setup.w, setup.res, strict=True)]
    t = 0.0 if setup.is_box else setup.tangent
    m = setup.m if setup.is_box else 0.0
    axes = list(zip(setup.n, setup.res, delta, strict=True))
    if setup.is_box:
        far = max(kernels.far_term(n, m, s, res, d) for n, res, d in axes)
        f1 = math.hypot(*(n / 2 + x * abs(m - s) for n, x in zip(setup.n, tau, strict=True)))
    else:
        far = max(kernels.shaft_term(t, res, d) for _, res, d in axes)
        f1 = 0.0
    f0 = math.hypot(*(n / 2 + x * s for n, x in zip(setup.n, tau, strict=True)))
    b = math.hypot(*(x + t for x in tau)) if not setup.is_box else (f1 - f0) / m if m > 0 else 0.0
    return _Terms(
        a=max(kernels.near_term(n, s, res, d) for n, res, d in axes), far=far, f0=f0, f1=f1, b=b,
        depth=m if setup.is_box else math.inf, r=math.hypot(*(n / 2 for n in setup.n)),
        dl=2 * math.tan(setup.alpha_rad / 2),
    )  # fmt: skip


def spacing(setup: Setup, t: float, s: float) -> float:
    """Return the largest gap-free distance from a layer at t to the one behind it; may be infinite."""
    q = _terms(setup, s)
    return float(kernels.spacing(t, s, setup.is_box, setup.m, q.a, q.far))


def depth_range(setup: Setup, t: float, s: float) -> float:
    """Return e: how far behind t points may lie that a layer at t shows (or one at t + e, before it); may be inf."""
    return _depth(setup, t, s, _terms(setup, s))


def _depth(setup: Setup, t: float, s: float, q: _Terms) -> float:
    e = float(kernels.depth_safe(t, q.f0, q.b, q.depth, q.dl))
    if setup.is_box and 2 * s >= setup.m:
        e = max(e, float(kernels.depth_near(t, s, q.r, setup.alpha_rad)))
    return e


def estimate(setup: Setup, s: float) -> float:
    """Return an upper bound of the number of layers, in constant time; whole, or infinite."""
    q = _terms(setup, s)
    first = setup.t0 + _depth(setup, setup.t0, s, q)
    if first >= setup.t_far:
        return 1
    last = kernels.last_layer(setup.t_far, q.f0, q.f1, q.b, setup.m, setup.is_box, q.dl)
    count = float(kernels.steps(first, last, s, setup.is_box, setup.m, q.a, q.far))
    return 1 + math.ceil(count * (1 + 1e-9)) if count < math.inf else math.inf


def best_viewpoint(setup: Setup) -> float:
    """Return the s of a dozen that needs the fewest layers by estimate; ties to the smallest."""
    if setup.is_box:
        choices = [setup.m * x for x in BOX_VIEWPOINTS]
    else:
        choices = [max(setup.n) * x for x in SHAFT_VIEWPOINTS]
    return min(choices, key=lambda s: (estimate(setup, s), s))


def place_layers(setup: Setup, *, s: float | None = None) -> Layers:
    """Return the layers of `setup`, seen from the reference viewpoint s (None: searched).

    Raises ObjectTouchesViewCell, OutOfDomain; the latter also for more than MOST_LAYERS layers.
    """
    check(setup)
    if s is None:
        s = best_viewpoint(setup)
    _check_s(setup, s)
    bound = estimate(setup, s)
    if not bound <= MOST_LAYERS:
        raise OutOfDomain(f"this needs about {bound:.3g} layers, more than {MOST_LAYERS}")
    q = _terms(setup, s)
    end = setup.t_far
    t = setup.t0 + _depth(setup, setup.t0, s, q)
    if t >= end:
        t = setup.t0 + float(kernels.border(setup.t0, end - setup.t0, s))
        return Layers(s=s, estimate=int(bound), t=np.array([t]), near=np.array([setup.t0]), far=np.array([end]))
    planes, nears = [t], [setup.t0]
    while t + _depth(setup, t, s, q) < end:
        c = min(float(kernels.spacing(t, s, setup.is_box, setup.m, q.a, q.far)), end - t)
        nears.append(t + float(kernels.border(t, c, s)))
        t += c
        planes.append(t)
        if t == end:  # also a last layer at infinity, whose own range is not a number
            break
        assert len(planes) <= 2 * MOST_LAYERS
    near = np.array(nears)
    return Layers(s=s, estimate=int(bound), t=np.array(planes), near=near, far=np.append(near[1:], end))
