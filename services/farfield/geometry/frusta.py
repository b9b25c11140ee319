"""Enclosing frusta: which boxes a camera may see whose position is in a cell and whose direction is in an interval.

Problem  A box and a view cell, both axis-aligned; the camera stands anywhere in the cell and looks in any direction of
         an interval. May a part of the box be on the screen? Never no where it may be; rarely yes where it is not.
Method   The differences object point - viewpoint fill exactly the box with centre q = (o0 + o1 - v0 - v1) / 2 and half
         sizes g = (o1 - o0 + v1 - v0) / 2. The frusta of all directions, apex at the origin, lie in the convex cone K
         of their corner rays. K and the box are disjoint iff a facet normal of K, a world axis, or a world axis x an
         edge of K separates them, and a cone with its apex at 0 can only be separated by normals N with all of K on one
         side. Those do not depend on the box: about 10 an interval (100 at a pole), once for all objects and cells.
         Reject iff N.q + |N|.g + pad (|q| + |g|) < 0 for one of them [error-metric.md section 10].
Errs     towards yes: by K against the non-convex union of the frusta, and by pad, which covers corner rays between the
         sampled ones. A box that touches the cell is always accepted.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from farfield.geometry import kernels
from farfield.geometry.camera import Camera, corner_rays
from farfield.geometry.intervals import face_axes, interval_bounds

RHO = 0.02  # largest rotation between neighbouring sampled cameras; pad = rho^2 / 2
POLYGON = 32  # corners of the polygon around the circular cone at a pole
NEAR_RIGHT_ANGLE = 0.01  # cosine to the mean below which a ray counts as 90 degrees away
TINY = 1e-9  # corners of K closer than this are one: far below pad


@dataclass(frozen=True, slots=True, kw_only=True)
class Frusta:
    """The enclosing frusta of all intervals of all levels of the quadtree: n = 1, 2, 4, ... up to `n`.

    Interval (face, i, j) of the level with n_l intervals a side is number offset(n_l) + (face n_l + j) n_l + i;
    its normals are rows [row[k], row[k+1]) of `normals`. No normals: everything is accepted.
    """

    n: int
    normals: np.ndarray  # (S,6) f64  unit, inwards; then the absolute values of the three components
    row: np.ndarray  # (F+1,) i64
    pad: np.ndarray  # (F,) f64

    @staticmethod
    def offset(n: int) -> int:
        return 2 * (n * n - 1)  # 6 (1 + 4 + ... + n^2 / 4)


@lru_cache(maxsize=4)
def enclosing_frusta(n: int, camera: Camera) -> Frusta:
    """Return the enclosing frusta of every level up to n intervals a side (a power of two)."""
    assert n >= 1
    assert n & (n - 1) == 0
    normals, pads = [], []
    level = 1
    while level <= n:
        for face in range(6):
            for j in range(level):
                for i in range(level):
                    found, pad = enclosing_frustum(
                        face, i, j, level, fov_deg=camera.fov_deg, width=camera.width, height=camera.height
                    )
                    normals.append(found)
                    pads.append(pad)
        level *= 2
    flat = np.concatenate(normals)
    row = np.cumsum([0, *map(len, normals)], dtype=np.int64)
    frusta = Frusta(n=n, normals=np.hstack([flat, np.abs(flat)]), row=row, pad=np.array(pads))
    for array in (frusta.normals, frusta.row, frusta.pad):
        array.flags.writeable = False  # shared by all callers
    return frusta


def enclosing_frustum(
    face: int, i: int, j: int, n: int, *, fov_deg: float, width: int, height: int
) -> tuple[np.ndarray, float]:
    """Return (normals (K,3) f64, unit, inwards; pad >= 0) of interval (face, i, j) of n x n; K = 0 accepts everything.

    fov_deg  vertical, (0, 150]; width, height of the screen in pixels. No roll, except at a pole, where any is covered.
    """
    camera = Camera(fov_deg=fov_deg, width=width, height=height)
    bounds = interval_bounds(face, i, j, n)
    at_pole = face // 2 == 1 and bool(((bounds[:, 0] <= 0) & (bounds[:, 1] >= 0)).all())
    rays, rho = _pole_rays(face, bounds, camera) if at_pole else _grid_rays(face, bounds, camera)
    return _cone_normals(rays), rho * rho / 2


def view_frustum_normals(direction: np.ndarray, camera: Camera) -> np.ndarray:
    """Return (K,3) f64: the inward unit normals that decide, exactly, which boxes one camera sees.

    direction  (3,) any length but 0. A box with centre q (relative to the eye) and half sizes g is outside the view
    pyramid (no near or far plane) iff N.q + |N|.g < 0 for one of them. K is about ten.
    """
    return _cone_normals(corner_rays(direction, camera))


def boxes_in_frustum(normals: np.ndarray, pad: float, boxes: np.ndarray, cell_box: np.ndarray) -> np.ndarray:
    """Return (N,) bool: which boxes (N,2,3) f64 normals (K,3) and pad accept, from cell_box (2,3) (an eye twice)."""
    q = (boxes[:, 0] + boxes[:, 1] - (cell_box[0] + cell_box[1])) / 2
    g = (boxes[:, 1] - boxes[:, 0] + (cell_box[1] - cell_box[0])) / 2
    reach = np.sqrt((q * q).sum(1)) + np.sqrt((g * g).sum(1))
    inside = np.ones(len(boxes), dtype=bool)
    for x, y, z in normals:
        middle = x * q[:, 0] + y * q[:, 1] + z * q[:, 2]
        inside &= middle + (abs(x) * g[:, 0] + abs(y) * g[:, 1] + abs(z) * g[:, 2]) + pad * reach >= 0
    return inside


def _grid_rays(face: int, bounds: np.ndarray, camera: Camera) -> tuple[np.ndarray, float]:
    """Corner rays (M,3) of cameras over the interval, and the largest rotation between neighbours."""
    half_x, half_y = camera.half_tan
    steps = [8, 8]
    while True:
        forward = _directions(face, bounds, steps)
        level = np.hypot(forward[..., 0], forward[..., 2])
        zero = np.zeros_like(level)
        right = np.stack([-forward[..., 2] / level, zero, forward[..., 0] / level], -1)
        up = np.stack([
            -right[..., 2] * forward[..., 1],
            right[..., 2] * forward[..., 0] - right[..., 0] * forward[..., 2],
            right[..., 0] * forward[..., 1],
        ], -1)  # fmt: skip
        frames = np.stack([right, up, forward], -2)
        rho = [_rotation(frames[1:], frames[:-1]), _rotation(frames[:, 1:], frames[:, :-1])]
        if max(rho) <= RHO:
            break
        steps = [max(s, math.ceil(s * r / RHO * 1.01)) for s, r in zip(steps, rho)]
    corners = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    rays = [(forward + sx * half_x * right + sy * half_y * up).reshape(-1, 3) for sx, sy in corners]
    return np.concatenate(rays), max(rho)


def _pole_rays(face: int, bounds: np.ndarray, camera: Camera) -> tuple[np.ndarray, float]:
    """Rays (M,3) of polygons around circular cones, which any roll stays in, and the largest turn of neighbours."""
    steps = [8, 8]
    while True:
        forward = _directions(face, bounds, steps)
        turn = [_turn(forward[1:], forward[:-1]), _turn(forward[:, 1:], forward[:, :-1])]
        if max(turn) <= RHO:
            break
        steps = [max(s, math.ceil(s * r / RHO * 1.01)) for s, r in zip(steps, turn)]
    forward = forward.reshape(-1, 3)
    tangent = math.hypot(*camera.half_tan) / math.cos(math.pi / POLYGON)
    u = face_axes(face)[1]
    a = np.zeros_like(forward)  # across `forward`: the face's u axis made perpendicular; never degenerate on a face
    a[:, u] = 1.0
    a -= forward * forward[:, [u]]
    a /= np.sqrt((a * a).sum(1, keepdims=True))
    b = np.cross(forward, a)
    angles = 2 * np.pi / POLYGON * np.arange(POLYGON)
    rays = [forward + tangent * (math.cos(t) * a + math.sin(t) * b) for t in angles]
    return np.concatenate(rays), max(turn)


def _directions(face: int, bounds: np.ndarray, steps: list[int]) -> np.ndarray:
    """(steps_u + 1, steps_v + 1, 3) unit directions at even ratios over the closed interval."""
    m, u, v, sign = face_axes(face)
    ratio = [low + (high - low) * (np.arange(s + 1) / s) for (low, high), s in zip(bounds, steps)]
    d = np.empty((steps[0] + 1, steps[1] + 1, 3))
    d[..., m], d[..., u], d[..., v] = sign, ratio[0][:, None], ratio[1][None, :]
    return d / np.sqrt(d[..., [0]] ** 2 + d[..., [1]] ** 2 + d[..., [2]] ** 2)


def _rotation(a: np.ndarray, b: np.ndarray) -> float:
    """Largest rotation angle between frames (...,3,3): ||A - B||_F^2 = 8 sin^2(rho / 2)."""
    difference = a - b
    return 2 * math.asin(min(1.0, math.sqrt(float((difference * difference).sum((-1, -2)).max()) / 8)))


def _turn(a: np.ndarray, b: np.ndarray) -> float:
    difference = a - b
    return 2 * math.asin(min(1.0, math.sqrt(float((difference * difference).sum(-1).max())) / 2))


def _cone_normals(rays: np.ndarray) -> np.ndarray:
    """Inward unit normals (K,3) of the convex cone of rays (M,3) that can separate it from an axis-aligned box."""
    rays = rays / np.sqrt(rays[:, [0]] ** 2 + rays[:, [1]] ** 2 + rays[:, [2]] ** 2)
    mean = np.array([math.fsum(rays[:, k]) for k in range(3)])
    length = math.hypot(*mean)
    if length <= NEAR_RIGHT_ANGLE * len(rays):
        return np.empty((0, 3))
    mean /= length
    a = np.cross(np.eye(3)[int(np.argmin(np.abs(mean)))], mean)
    a /= math.hypot(*a)
    b = np.cross(mean, a)
    depth = _dot(rays, mean)
    if depth.min() <= NEAR_RIGHT_ANGLE:
        return np.empty((0, 3))
    x, y = _dot(rays, a) / depth, _dot(rays, b) / depth
    hull = rays[kernels.convex_hull(x, y, np.lexsort((y, x)))]
    apart = np.abs(hull - np.roll(hull, 1, axis=0)).max(1) > TINY
    hull = hull[apart]

    normals = list(np.cross(hull, np.roll(hull, -1, axis=0)))
    for axis in np.eye(3):
        edges = np.cross(axis, hull)
        normals += [*edges, *-edges, axis, -axis]
    found = np.array(normals)
    size = np.sqrt((found * found).sum(1))
    found = found[size > TINY] / size[size > TINY, None]
    least = np.min([_dot(found, q) for q in hull], axis=0)
    found = found[least >= -1e-12] + 0.0  # no negative zeros
    return _distinct(found)


def _dot(rows: np.ndarray, v: np.ndarray) -> np.ndarray:
    return rows[:, 0] * v[0] + rows[:, 1] * v[1] + rows[:, 2] * v[2]


def _distinct(normals: np.ndarray) -> np.ndarray:
    """Drop repeated normals; the first of each stays."""
    _, first = np.unique(np.round(normals, 12) + 0.0, axis=0, return_index=True)
    return normals[np.sort(first)]
