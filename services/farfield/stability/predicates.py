"""The geometric predicates against exact arithmetic: how far from its border may a case lie and still be decided wrongly?

Problem  A predicate is the sign of a sum. Where rounding moves that sum across 0 the decision is wrong: how far from 0 was
         it, relative to what is added up? And does the predicate ever err to the side that it promises not to?
Method   Draw cases at the border, from a last digit to a thousandth away, over scales and offsets, and decide each by
         exact arithmetic on the very numbers that the predicate gets. The largest margin decided wrongly is the error.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from farfield.evaluation import kernels as clipping
from farfield.geometry import intervals
from farfield.geometry.camera import Camera, camera_frame
from farfield.geometry.frusta import enclosing_frustum
from farfield.geometry.kernels import accepts
from farfield.impostor.cells import shaft_holds
from farfield.stability.trial import as_double, in_float32

Rng = np.random.Generator


@dataclass(frozen=True, slots=True, kw_only=True)
class Decided:
    """What a predicate did over `tried` cases. `forbidden` counts errors to the side that it promises not to err to."""

    name: str
    domain: str
    tried: int
    error: float  # largest relative margin decided wrongly in float64, 0 if none
    at: str
    limit: float = 1e-12  # of the error in float64
    error_single: float | None  # the same in float32; None where the predicate exists in float64 only
    forbidden: int
    forbidden_single: int | None


def _frame_of(rng: Rng) -> tuple[float, np.ndarray]:
    """Return a unit of length and an offset: the origin, or up to 1e7 units away."""
    unit = float(rng.choice([1e-6, 1.0, 1.0, 1e6]))
    return unit, rng.uniform(-1, 1, 3) * unit * float(rng.choice([0.0, 0.0, 1e3, 1e7]))


def cell_in_shaft(tries: int, seed: int) -> Decided:
    """`shaft_holds`: |p x A| <= T (p . A), near <= p . A <= far. Never yes for a cell that sticks out by more than that."""
    import mpmath as mp

    rng = np.random.default_rng(seed)
    single = in_float32(shaft_holds)
    worst, at, worst_single = 0.0, "", 0.0
    with mp.workdps(100):
        for _ in range(tries):
            unit, apex = _frame_of(rng)
            axis = rng.normal(size=3)
            axis /= math.sqrt(float((axis**2).sum()))
            across = np.cross(axis, rng.normal(size=3))
            across /= math.sqrt(float((across**2).sum()))
            tangent, along = float(10 ** rng.uniform(-6, 3)), unit * float(10 ** rng.uniform(-2, 4))
            off = 1 + float(rng.choice([-1, 1])) * 10 ** rng.uniform(-17, -3)
            point = apex + along * axis + tangent * along * off * across
            cell = np.array([*apex, *axis, tangent, 0.0, math.inf])
            box = np.stack([point, point])
            for in_single in (False, True):
                c, b = (cell.astype(np.float32), box.astype(np.float32)) if in_single else (cell, box)
                yes = bool((single if in_single else shaft_holds)(c, b))
                margin = _shaft_margin(as_double(c), as_double(b[0]))
                if yes != (margin >= 0):
                    size = abs(float(margin))
                    if in_single:
                        worst_single = max(worst_single, size)
                    elif size > worst:
                        worst, at = size, f"shaft {c.tolist()}, corner {b[0].tolist()}"
    return Decided(
        name="cell in shaft", tried=tries, error=worst, at=at, error_single=worst_single, forbidden=0, forbidden_single=None,
        domain="units 1e-6 to 1e6, offsets to 1e7 units, T 1e-6 to 1e3, 1e-17 to 1e-3 from the cone",
    )  # fmt: skip


def _shaft_margin(cell: list[float], corner: list[float]) -> Any:
    """Return (T (p . A) - |p x A|) / (|p| (1 + T)), exactly from the numbers given, offsets subtracted exactly."""
    import mpmath as mp

    p = [mp.mpf(corner[k]) - cell[k] for k in range(3)]
    a = [mp.mpf(cell[3 + k]) for k in range(3)]
    along = sum(x * y for x, y in zip(p, a, strict=True))
    cross = [p[(k + 1) % 3] * a[(k + 2) % 3] - p[(k + 2) % 3] * a[(k + 1) % 3] for k in range(3)]
    length = mp.sqrt(sum(x * x for x in p))
    return (cell[6] * along - mp.sqrt(sum(x * x for x in cross))) / (length * (1 + cell[6])) if length else mp.mpf(0)


def enclosing_frusta(tries: int, seed: int) -> Decided:
    """`accepts`: never no to a box that a camera of the cell and the interval has on its screen.

    The box touches the ray through a screen corner of one camera, from outside. The error is that of the sum whose sign
    decides, against the exact sum, relative to |q| + |g|. It grows with the offset: corners are added before they are
    subtracted. Stages take coordinates from the scene's origin, and the pad of 1e-5 and more covers it a thousandfold.
    """
    import mpmath as mp

    rng = np.random.default_rng(seed)
    single = in_float32(accepts)
    worst, at, worst_single, missed, missed_single = 0.0, "", 0.0, 0, 0
    with mp.workdps(60):
        for _ in range(tries):
            unit, offset = _frame_of(rng)
            camera = Camera(
                fov_deg=float(rng.choice([1.0, 45.0, 60.0, 100.0])), width=int(rng.choice([320, 1280])), height=320
            )
            n = int(rng.choice([1, 4, 8, 16]))
            face, i, j = int(rng.integers(6)), int(rng.integers(n)), int(rng.integers(n))
            normals, pad = _frustum(face, i, j, n, camera)
            (u0, u1), (v0, v1) = intervals.interval_bounds(face, i, j, n)
            share = rng.choice([0.0, 1.0, rng.random()], 2)
            direction = intervals.direction_at(face, u0 + (u1 - u0) * share[0], v0 + (v1 - v0) * share[1])
            right, up, forward = camera_frame(direction)
            half_x, half_y = camera.half_tan
            ray = forward + rng.choice([-1, 1]) * half_x * right + rng.choice([-1, 1]) * half_y * up
            size = unit * 10 ** rng.uniform(-2, 2, 3)
            cell = np.stack([offset, offset + size])
            eye = cell[rng.integers(0, 2, 3), range(3)]
            touch = eye + ray * unit * 10 ** rng.uniform(-1, 5)
            away = np.where(touch >= eye, 1, -1) * unit * 10 ** rng.uniform(-2, 2, 3)
            slack = np.abs(touch) * 2.0**-50  # holds the exact touching point in spite of rounding
            box = np.stack([np.minimum(touch, touch + away) - slack, np.maximum(touch, touch + away) + slack])
            for in_single in (False, True):
                kind = np.float32 if in_single else np.float64
                b, c, table = box.astype(kind), cell.astype(kind), normals.astype(kind)
                q, g = (b[0] + b[1] - (c[0] + c[1])) / kind(2), (b[1] - b[0] + (c[1] - c[0])) / kind(2)
                reach = np.sqrt((q * q).sum()) + np.sqrt((g * g).sum())
                decide = single if in_single else accepts
                no = decide(table, 0, len(table), kind(pad), *q, *g, reach) >= 0
                if in_single:
                    missed_single += no
                else:
                    missed += no
                error = _sum_error(table, b, c, q, g, reach)
                if in_single:
                    worst_single = max(worst_single, error)
                elif error > worst:
                    worst, at = error, f"interval {(face, i, j, n)}, {camera}, box {box.tolist()}, cell {cell.tolist()}"
    return Decided(
        name="enclosing frusta", tried=tries, error=worst, at=at, error_single=worst_single, forbidden=missed,
        forbidden_single=missed_single, limit=1e-8,
        domain="units 1e-6 to 1e6, offsets to 1e7 units, intervals 90 to 5.6 degrees, fov 1 to 100; boxes that touch a "
               "screen corner's ray",
    )  # fmt: skip


_FRUSTA: dict[tuple[object, ...], tuple[np.ndarray, float]] = {}


def _frustum(face: int, i: int, j: int, n: int, camera: Camera) -> tuple[np.ndarray, float]:
    key = (face, i, j, n, camera)
    if key not in _FRUSTA:
        found, pad = enclosing_frustum(
            face, i, j, n, fov_deg=camera.fov_deg, width=camera.width, height=camera.height
        )  # fmt: skip
        _FRUSTA[key] = np.hstack([found, np.abs(found)]), pad
    return _FRUSTA[key]


def _sum_error(
    table: np.ndarray, box: np.ndarray, cell: np.ndarray, q: np.ndarray, g: np.ndarray, reach: np.floating
) -> float:
    """Return the largest error of N.q + |N|.g over the normals, relative to the exact |q| + |g|."""
    import mpmath as mp

    b, c = box.astype(np.float64).tolist(), cell.astype(np.float64).tolist()
    centre = [(mp.mpf(b[0][k]) + b[1][k] - c[0][k] - c[1][k]) / 2 for k in range(3)]
    half = [(mp.mpf(b[1][k]) - b[0][k] + c[1][k] - c[0][k]) / 2 for k in range(3)]
    length = mp.sqrt(sum(x * x for x in centre)) + mp.sqrt(sum(x * x for x in half))
    worst = 0.0
    for row in table[:: max(1, len(table) // 4)]:  # a few of them: all are alike, and exact sums are slow
        n = row.astype(np.float64).tolist()
        exactly = sum(n[k] * centre[k] + n[3 + k] * half[k] for k in range(3))
        found = row[0] * q[0] + row[1] * q[1] + row[2] * q[2] + (row[3] * g[0] + row[4] * g[1] + row[5] * g[2])
        worst = max(worst, float(abs(mp.mpf(float(found)) - exactly) / length))
    return worst


def verify_clipping(tries: int, seed: int) -> Decided:
    """`box_share` of verify: is a point on the screen of a camera? Against exact planes through the same camera axes."""
    import mpmath as mp

    rng = np.random.default_rng(seed)
    worst, at = 0.0, ""
    points, spare, corners = np.empty((16, 3)), np.empty((16, 3)), np.empty((8, 3))
    with mp.workdps(60):
        for _ in range(tries):
            unit, eye = _frame_of(rng)
            camera = Camera(fov_deg=float(rng.choice([1.0, 45.0, 100.0])), width=1280, height=720)
            right, up, forward = camera_frame(rng.normal(size=3))
            half_x, half_y = camera.half_tan
            frame = np.stack([right / half_x, up / half_y, forward])
            off = 1 + float(rng.choice([-1, 1])) * 10 ** rng.uniform(-17, -3)
            where = rng.permutation([off, rng.uniform(-1, 1)]) * rng.choice([-1, 1], 2)
            depth = unit * 10 ** rng.uniform(-2, 5)
            point = eye + depth * (forward + where[0] * half_x * right + where[1] * half_y * up)
            if (point == eye).all():
                continue
            seen = clipping.box_share(np.stack([point, point]), eye, frame, points, spare, corners) >= 0
            p = [mp.mpf(float(point[k])) - float(eye[k]) for k in range(3)]
            x, y, z = (sum(v * float(frame[a, k]) for k, v in enumerate(p)) for a in range(3))
            length = mp.sqrt(sum(v * v for v in p)) * float(np.sqrt((frame**2).sum()))
            margin = float(min(z - abs(x), z - abs(y)) / length)
            if seen != (margin >= 0) and abs(margin) > worst:
                worst, at = abs(margin), f"eye {eye.tolist()}, frame {frame.tolist()}, point {point.tolist()}"
    return Decided(
        name="clipping of verify", tried=tries, error=worst, at=at, error_single=None, forbidden=0, forbidden_single=None,
        domain="units 1e-6 to 1e6, offsets to 1e7 units, fov 1 to 100; 1e-17 to 1e-3 from the screen's border",
    )  # fmt: skip


def interval_edges(tries: int, seed: int) -> Decided:
    """`edges`: the tangents at which directions are parted, for every interval from 90 to 90 / 1024 degrees."""
    import mpmath as mp

    worst, at, count = 0.0, "", 0
    with mp.workdps(60):
        for n in (2**k for k in range(11)):
            for k, edge in enumerate(intervals.edges(n)):
                exactly = mp.tan(mp.pi / 2 * (mp.mpf(k) / n - mp.mpf(1) / 2))
                count += 1
                error = float(abs(mp.mpf(float(edge)) - exactly) / max(abs(exactly), mp.mpf(1) / n))
                if error > worst:
                    worst, at = error, f"edge {k} of {n}"
    return Decided(
        name="interval edges", tried=count, error=worst, at=at, error_single=None, forbidden=0, forbidden_single=None,
        domain="every edge of 1 to 1024 intervals a side, relative to the larger of the edge and an interval's width",
    )  # fmt: skip


PREDICATES: tuple[Callable[[int, int], Decided], ...] = (
    enclosing_frusta, cell_in_shaft, verify_clipping, interval_edges,
)  # fmt: skip
