"""Numba: lay an impostor out in one frame for one view cell: reference viewpoint, texel grid, layers, crops.

Problem  A cluster's box and a view cell, both in world axes, and a frame (right, up, forward) that faces the cluster.
         Find the reference viewpoint behind the cell's nearest plane, the texel grid that covers the box, the layers
         that hold for every viewpoint of the cell, and how many texels each layer can hold at most.
Method   General form of error-metric.md sections 3 and 5, from the vertices of a box cell (8) or of a truncated cone
         (its two discs: centre and radius). Resolution by section 2. A dozen reference viewpoints are tried;
         texels decide.
         A layer holds no more than the part of the box inside its slab projects to.
Errs     Towards more layers and texels: coordinates are padded by their rounding errors.
"""

import math

import numpy as np
from numba import njit

from farfield.impostor.kernels import stack, vertex_terms
from farfield.impostor.weight import IMPOSTOR_BYTES, LAYER_BYTES, MAX_LAYERS, MAX_SIDE, TEXEL_BYTES

SHAFT, BOX = 0, 1  # as in farfield.candidates.model
# reference viewpoints that are tried: of a box cell's depth, of the width of a shaft's near end
BOX_VIEWPOINTS = np.array([0.0, 0.025, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.75, 1.0])
SHAFT_VIEWPOINTS = np.array([0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0])
ONE_VIEWPOINT = np.array([0.15])  # where many impostors are compared in a hurry
ROUNDING = 1e-12  # relative; rotating a point in float64 errs by less than 1e-15 of its length
TOUCH = 1.0 / 64  # texels: content snapped to 1/256 texel may touch texels this far beyond its exact projection

TOO_NEAR, TOO_MANY, TOO_LARGE = -1, -2, -3  # instead of a count of layers

# columns of the scalars of a frame
EYE_X, EYE_Y, PLANE_Z, S, LOW_X, LOW_Y, TEXEL, RES_X, RES_Y, TEXELS = range(10)

_EDGES = np.array(
    [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]], dtype=np.int64
)


@njit(cache=True)
def turn(axes: np.ndarray, p0: float, p1: float, p2: float, out: np.ndarray) -> None:
    """Write the frame's coordinates of a point; axes (3,3): right, up, forward."""
    for i in range(3):
        out[i] = axes[i, 0] * p0 + axes[i, 1] * p1 + axes[i, 2] * p2


@njit(cache=True)
def corners(axes: np.ndarray, box: np.ndarray, origin: np.ndarray, out: np.ndarray) -> None:
    """Write the (8,3) corners of a box relative to `origin`, in the frame; bits 2, 1, 0 of k choose x, y, z."""
    for k in range(8):
        turn(
            axes, box[(k >> 2) & 1, 0] - origin[0], box[(k >> 1) & 1, 1] - origin[1], box[k & 1, 2] - origin[2], out[k]
        )


@njit(cache=True)
def _slopes(points: np.ndarray, eye_x: float, eye_y: float, back: float, out: np.ndarray) -> None:
    """Write the extremes (low x, high x, low y, high y) of the slopes of (8,3) points, seen from depth -back."""
    out[0], out[1], out[2], out[3] = np.inf, -np.inf, np.inf, -np.inf
    for k in range(8):
        z = points[k, 2] + back
        a, b = (points[k, 0] - eye_x) / z, (points[k, 1] - eye_y) / z
        out[0], out[1] = min(out[0], a), max(out[1], a)
        out[2], out[3] = min(out[2], b), max(out[3], b)


@njit(cache=True)
def _count(low: float, high: float, texel: float) -> float:
    """Return how many texels may hold content between two slopes: at least 4 (section 2)."""
    return max(4.0, math.ceil((high - low) / texel * (1 + ROUNDING)))


@njit(cache=True)
def _crop(points: np.ndarray, near: float, far: float, frame: np.ndarray, out: np.ndarray) -> None:
    """Write the most columns and rows that the box's part between the planes near and far (z >= 0 frame) touches."""
    eye_x, eye_y, s = frame[EYE_X], frame[EYE_Y], frame[S]
    a0, a1, b0, b1 = np.inf, -np.inf, np.inf, -np.inf
    for e in range(20):
        if e < 8:
            x, y, z = points[e, 0], points[e, 1], points[e, 2]
            if near <= z <= far:
                a, b = (x - eye_x) / (z + s), (y - eye_y) / (z + s)
                a0, a1, b0, b1 = min(a0, a), max(a1, a), min(b0, b), max(b1, b)
            continue
        i, j = _EDGES[e - 8]
        zi, zj = points[i, 2], points[j, 2]
        for side in range(2):
            z = near if side == 0 else far
            if min(zi, zj) <= z <= max(zi, zj) and zi != zj:
                f = (z - zi) / (zj - zi)
                x = points[i, 0] + f * (points[j, 0] - points[i, 0])
                y = points[i, 1] + f * (points[j, 1] - points[i, 1])
                a, b = (x - eye_x) / (z + s), (y - eye_y) / (z + s)
                a0, a1, b0, b1 = min(a0, a), max(a1, a), min(b0, b), max(b1, b)
    if not a0 <= a1:
        out[0] = out[1] = 0.0
        return
    texel = frame[TEXEL]
    for axis in range(2):
        low, high, start = (a0, a1, frame[LOW_X]) if axis == 0 else (b0, b1, frame[LOW_Y])
        res = frame[RES_X] if axis == 0 else frame[RES_Y]
        first = max(0.0, math.floor((low - start) / texel - TOUCH))
        last = min(res, math.ceil((high - start) / texel + TOUCH))
        out[axis] = max(0.0, last - first)


@njit(cache=True)
def lay_out(
    is_shaft: bool, axes: np.ndarray, cluster: np.ndarray, cell: np.ndarray, viewpoints: np.ndarray, delta: float,
    dl: float, plane: np.ndarray, near: np.ndarray, far: np.ndarray, crop: np.ndarray, frame: np.ndarray,
) -> int:  # fmt: skip
    """Lay an impostor out in the frame `axes`; return its count of layers, or TOO_NEAR, TOO_MANY, TOO_LARGE.

    axes     (3,3) right, up, forward (unit); for a shaft forward = -axis
    cluster  (2,3) box
    cell     (9,) as in Candidates.view_cell
    viewpoints  (V,) the reference viewpoints to try, ascending: BOX_VIEWPOINTS or SHAFT_VIEWPOINTS
    delta    admissible slope of a texel at the cell's nearest plane; dl  2 tan(alpha / 2)
    plane, near, far  (limit,) out: distances from the cell's nearest plane; crop  (limit,2) out: most texels of a layer
    frame    (10,) out: eye's x, y and z of the cell's nearest plane (in the frame, from the cluster's centre), s,
             slopes at the grid's low corner, slope of a texel, texels x, y, texels of all crops
    """
    centre = np.empty(3)
    for i in range(3):
        centre[i] = (cluster[0, i] + cluster[1, i]) / 2
    points = np.empty((8, 3))
    corners(axes, cluster, centre, points)
    scale = 0.0
    for i in range(3):
        scale += cluster[1, i] - cluster[0, i]
    # The cell as discs: centre (x, y), radius, depth behind its nearest plane.
    x, y, radius, depth = np.empty(8), np.empty(8), np.zeros(8), np.empty(8)
    tangent = 0.0
    if is_shaft:
        n_vertices = 1
        apex, end = np.empty(3), cell[7]
        turn(axes, cell[0] - centre[0], cell[1] - centre[1], cell[2] - centre[2], apex)
        top = apex[2] - cell[7]
        x[0], y[0], radius[0], depth[0] = apex[0], apex[1], cell[7] * cell[6], 0.0
        if cell[8] < np.inf:
            n_vertices = 2
            end = cell[8]
            x[1], y[1], radius[1], depth[1] = apex[0], apex[1], cell[8] * cell[6], cell[8] - cell[7]
        else:
            tangent = cell[6]
        scale += abs(cell[0] - centre[0]) + abs(cell[1] - centre[1]) + abs(cell[2] - centre[2]) + end * (1 + cell[6])
        eye_x, eye_y = apex[0], apex[1]
        unit = 2 * radius[0]
    else:
        n_vertices = 8
        vertices = np.empty((8, 3))
        corners(axes, cell[:6].reshape(2, 3), centre, vertices)
        top, bottom = vertices[:, 2].max(), vertices[:, 2].min()
        for k in range(8):
            x[k], y[k], depth[k] = vertices[k, 0], vertices[k, 1], top - vertices[k, 2]
            scale = max(scale, abs(x[k]) + abs(y[k]) + abs(vertices[k, 2]))
        eye_x, eye_y = (x.min() + x.max()) / 2, (y.min() + y.max()) / 2
        unit = top - bottom
    pad = scale * ROUNDING
    t0, t_far = np.inf, -np.inf
    for k in range(8):
        points[k, 2] -= top
        t0, t_far = min(t0, points[k, 2]), max(t_far, points[k, 2])
    t0, t_far = t0 - pad, t_far + pad
    if not t0 > pad:
        return TOO_NEAR

    edge = np.empty(4)
    term, offset = np.empty(n_vertices), np.empty(n_vertices)
    best, best_texels, best_s = TOO_MANY, np.inf, 0.0
    tried = len(viewpoints) if unit > 0 else 1
    attempt, held = 0, False  # held: the arrays hold the best
    while attempt < tried or (best > 0 and not held):
        # one layer cannot be beaten: more viewpoints only after more layers
        again = attempt >= tried or best == 1
        s = best_s if again else viewpoints[attempt] * unit
        attempt = tried if again else attempt + 1
        if again and held:
            break
        texel = delta * (t0 / (t0 + s))
        _slopes(points, eye_x, eye_y, s, edge)
        slack = pad / (t0 + s)
        res_x = _count(edge[0] - slack, edge[1] + slack, texel)
        res_y = _count(edge[2] - slack, edge[3] + slack, texel)
        if max(res_x, res_y) > MAX_SIDE:
            best = TOO_LARGE if best < 0 else best
            held = False
            continue
        low_x, low_y = (edge[0] + edge[1]) / 2 - res_x * texel / 2, (edge[2] + edge[3]) / 2 - res_y * texel / 2
        high_x, high_y = low_x + res_x * texel, low_y + res_y * texel
        for j in range(n_vertices):
            dx, dy, r, d = x[j] - eye_x, y[j] - eye_y, radius[j] + pad, depth[j]
            term[j] = vertex_terms(dx, d, r, s, low_x, high_x, texel) / texel
            term[j] = max(term[j], vertex_terms(dy, d, r, s, low_y, high_y, texel) / texel)
            worst = 0.0
            for k in range(4):
                u = edge[k & 1] * (s - d) - dx
                v = edge[2 + (k >> 1)] * (s - d) - dy
                worst = max(worst, math.hypot(u, v))
            offset[j] = worst + r
        term_limit = offset_limit = 0.0
        if tangent > 0:
            term_limit = max(max(-low_x, high_x), max(-low_y, high_y)) / texel + tangent / texel
            offset_limit = math.hypot(max(-edge[0], edge[1]), max(-edge[2], edge[3])) + tangent
        room = len(plane)
        if not again and best > 0:  # more layers than this would weigh more
            room = min(room, int(best_texels / (res_x * res_y)) + 1)
        count = stack(
            t0, t_far, s, dl, depth[:n_vertices], term, offset, term_limit, offset_limit, plane[:room], near, far
        )
        texels = count * res_x * res_y
        held = again or (count > 0 and texels < best_texels)
        if held:
            best, best_texels, best_s = count, texels, s
            frame[EYE_X], frame[EYE_Y], frame[PLANE_Z], frame[S] = eye_x, eye_y, top, s
            frame[LOW_X], frame[LOW_Y], frame[TEXEL], frame[RES_X], frame[RES_Y] = low_x, low_y, texel, res_x, res_y
    if best < 0:
        return best
    total = 0.0
    for k in range(best):
        _crop(points, near[k] - pad, far[k] + pad, frame, crop[k])
        total += crop[k, 0] * crop[k, 1]
    frame[TEXELS] = total
    return best


@njit(cache=True)
def _complete(axes: np.ndarray) -> None:
    """Fill right and up of a frame whose forward (row 2) is unit: right is level, or x where forward is vertical."""
    x, z = axes[2, 0], axes[2, 2]
    level = math.hypot(x, z)
    if level < 1e-9:
        axes[0, 0], axes[0, 1], axes[0, 2] = 1.0, 0.0, 0.0
        # right must be exactly perpendicular to forward
        along = axes[2, 0]
        axes[0, 0], axes[0, 1], axes[0, 2] = 1 - along * axes[2, 0], -along * axes[2, 1], -along * axes[2, 2]
        length = math.sqrt(axes[0, 0] ** 2 + axes[0, 1] ** 2 + axes[0, 2] ** 2)
        for i in range(3):
            axes[0, i] /= length
    else:
        axes[0, 0], axes[0, 1], axes[0, 2] = -z / level, 0.0, x / level
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        axes[1, i] = axes[0, j] * axes[2, k] - axes[0, k] * axes[2, j]


@njit(cache=True)
def _face(axes: np.ndarray, x: float, y: float, z: float) -> bool:
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 0:
        return False
    axes[2, 0], axes[2, 1], axes[2, 2] = x / length, y / length, z / length
    _complete(axes)
    return True


@njit(cache=True)
def face_cluster(is_shaft: bool, cluster: np.ndarray, cell: np.ndarray, choice: int, axes: np.ndarray) -> bool:
    """Write the frame (right, up, forward) of a choice; False if there is none.

    Shaft: 0 is against its axis. Box: 0 from centre to centre in the level, 1 the world axis of the widest gap, 2 from
    closest point to closest point (the one with the greatest t0). Each is the best for some; a fourth from centre to
    centre saved 0.03 % on a city.
    """
    if is_shaft:
        return choice == 0 and _face(axes, -cell[3], -cell[4], -cell[5])
    gap, middle = np.zeros(3), np.zeros(3)
    widest, axis, apart = 0.0, -1, 0
    for i in range(3):
        middle[i] = (cluster[0, i] + cluster[1, i]) / 2 - (cell[i] + cell[3 + i]) / 2
        if cluster[0, i] > cell[3 + i]:
            gap[i] = cluster[0, i] - cell[3 + i]
        elif cluster[1, i] < cell[i]:
            gap[i] = cluster[1, i] - cell[i]
        if gap[i] != 0:
            apart += 1
        if abs(gap[i]) > widest:
            widest, axis = abs(gap[i]), i
    if axis < 0:
        return False
    if choice == 0:
        return _face(axes, middle[0], 0.0, middle[2])
    if choice == 1:
        return _face(axes, gap[0] if axis == 0 else 0.0, gap[1] if axis == 1 else 0.0, gap[2] if axis == 2 else 0.0)
    return apart > 1 and _face(axes, gap[0], gap[1], gap[2])


CHOICES = 3


@njit(cache=True)
def lay_out_best(
    is_shaft: bool, cluster: np.ndarray, cell: np.ndarray, delta: float, dl: float, axes: np.ndarray,
    plane: np.ndarray, near: np.ndarray, far: np.ndarray, crop: np.ndarray, frame: np.ndarray,
) -> int:  # fmt: skip
    """As `lay_out`, in the frame of `face_cluster` that weighs least from one viewpoint, ties to the first; axes is out."""
    chosen, least, worst = -1, np.inf, TOO_NEAR
    for choice in range(1 if is_shaft else CHOICES):
        if not face_cluster(is_shaft, cluster, cell, choice, axes):
            continue
        count = lay_out(is_shaft, axes, cluster, cell, ONE_VIEWPOINT, delta, dl, plane, near, far, crop, frame)
        if count <= 0:
            worst = min(worst, count)
        weight = TEXEL_BYTES * frame[TEXELS] + LAYER_BYTES * count if count > 0 else 1e300
        if count != TOO_NEAR and weight < least:
            chosen, least = choice, weight
    if chosen < 0:
        return worst
    face_cluster(is_shaft, cluster, cell, chosen, axes)
    viewpoints = SHAFT_VIEWPOINTS if is_shaft else BOX_VIEWPOINTS
    return lay_out(is_shaft, axes, cluster, cell, viewpoints, delta, dl, plane, near, far, crop, frame)


@njit(cache=True)
def weigh_quickly(
    patient: bool, cluster: np.ndarray, cell: np.ndarray, delta: float, dl: float, axes: np.ndarray,
    plane: np.ndarray, near: np.ndarray, far: np.ndarray, crop: np.ndarray, frame: np.ndarray,
) -> float:  # fmt: skip
    """Return the bytes of an impostor for a box cell from one viewpoint in one frame, infinite if none: to compare many.

    patient  try the other frames too, and with all the room that the arrays have; else MAX_LAYERS. (One viewpoint takes
             more layers than the best of a dozen.)
    """
    room = len(plane) if patient else min(MAX_LAYERS, len(plane))
    for choice in (0, 2, 1):
        if face_cluster(False, cluster, cell, choice, axes):
            count = lay_out(False, axes, cluster, cell, ONE_VIEWPOINT, delta, dl, plane[:room], near, far, crop, frame)
            if count > 0:
                return TEXEL_BYTES * frame[TEXELS] + IMPOSTOR_BYTES + LAYER_BYTES * count
            if not patient and count != TOO_NEAR:
                return np.inf
    return np.inf
