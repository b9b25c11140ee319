"""Numba: layers of an environment map's face: one frame, texel grid and stack of layers for many boxes.

Problem  What lies beyond some distance of a view cell is to be recorded as an environment map: in layers across the six
         directions of a cube around the cell. What is recorded comes as boxes of whole clusters, each to be found again.
Method   As `frames.lay_out`, but the frame is a world axis and the frustum holds all boxes of the face. Each box then
         takes its window of the common grid and those of the common layers that it reaches into.
Errs     Towards more layers and texels, as there.
After    Jeschke and Wimmer 2002, sections 3 and 4.
"""

import math

import numpy as np
from numba import njit

from farfield.impostor.frames import (
    BOX_VIEWPOINTS,
    EYE_X,
    EYE_Y,
    LOW_X,
    LOW_Y,
    PLANE_Z,
    RES_X,
    RES_Y,
    ROUNDING,
    TEXEL,
    TEXELS,
    TOO_MANY,
    TOO_NEAR,
    TOUCH,
    S,
    _count,
    _crop,
    _slopes,
    corners,
)
from farfield.impostor.kernels import stack, vertex_terms

FACES = 6  # 2 axis + 1 where it looks along the negative axis
ROOM = 1024  # layers of a face; a box takes MAX_LAYERS of them at most


@njit(cache=True)
def face_axes(face: int, axes: np.ndarray) -> None:
    """Fill (3,3) right, up, forward of a face of the cube; right x up = -forward."""
    axes[:] = 0.0
    axis, sign = face // 2, 1.0 - 2.0 * (face % 2)
    axes[2, axis] = sign
    if axis == 1:
        axes[0, 0], axes[1, 2] = 1.0, sign
    else:
        axes[1, 1] = 1.0
        if axis == 0:
            axes[0, 2] = sign
        else:
            axes[0, 0] = -sign


@njit(cache=True)
def lay_out_face(
    face: int, boxes: np.ndarray, cell: np.ndarray, delta: float, dl: float, plane: np.ndarray, near: np.ndarray,
    far: np.ndarray, frame: np.ndarray,
) -> int:  # fmt: skip
    """Lay one face of a map out; return its count of layers, or TOO_NEAR, TOO_MANY.

    boxes   (K,2,3) what the face shows, K >= 1, all in front of the cell's face
    cell    (2,3) box of the view cell; delta, dl  as in `frames.lay_out`
    plane, near, far  (limit,) out: distances from the cell's nearest plane
    frame   (10,) out, as in `frames.lay_out`, relative to the cell's centre; TEXELS is left as it is
    """
    axes, centre = np.empty((3, 3)), np.empty(3)
    face_axes(face, axes)
    for i in range(3):
        centre[i] = (cell[0, i] + cell[1, i]) / 2
    vertices = np.empty((8, 3))
    corners(axes, cell, centre, vertices)
    top, bottom = vertices[:, 2].max(), vertices[:, 2].min()
    depth = top - vertices[:, 2]
    points = np.empty((len(boxes), 8, 3))
    scale, t0, t_far = 0.0, np.inf, -np.inf
    for k in range(8):
        scale = max(scale, abs(vertices[k, 0]) + abs(vertices[k, 1]) + abs(vertices[k, 2]))
    for b in range(len(boxes)):
        corners(axes, boxes[b], centre, points[b])
        for k in range(8):
            scale = max(scale, abs(points[b, k, 0]) + abs(points[b, k, 1]) + abs(points[b, k, 2]))
            points[b, k, 2] -= top
            t0, t_far = min(t0, points[b, k, 2]), max(t_far, points[b, k, 2])
    pad = scale * ROUNDING
    t0, t_far = t0 - pad, t_far + pad
    if not t0 > pad:
        return TOO_NEAR
    eye_x, eye_y, unit = 0.0, 0.0, top - bottom
    edge, one = np.empty(4), np.empty(4)
    term, offset = np.empty(8), np.empty(8)
    best, least, best_s = TOO_MANY, np.inf, 0.0
    n = len(BOX_VIEWPOINTS) if unit > 0 else 1
    for attempt in range(n + 1):
        if attempt == n and best < 0:
            break
        s = best_s if attempt == n else BOX_VIEWPOINTS[attempt] * unit
        texel = delta * (t0 / (t0 + s))
        edge[0], edge[1], edge[2], edge[3] = np.inf, -np.inf, np.inf, -np.inf
        for b in range(len(boxes)):
            _slopes(points[b], eye_x, eye_y, s, one)
            for k in range(4):
                edge[k] = min(edge[k], one[k]) if k % 2 == 0 else max(edge[k], one[k])
        slack = pad / (t0 + s)
        res_x, res_y = _count(edge[0] - slack, edge[1] + slack, texel), _count(edge[2] - slack, edge[3] + slack, texel)
        low_x, low_y = (edge[0] + edge[1]) / 2 - res_x * texel / 2, (edge[2] + edge[3]) / 2 - res_y * texel / 2
        high_x, high_y = low_x + res_x * texel, low_y + res_y * texel
        for j in range(8):
            dx, dy, d = vertices[j, 0] - eye_x, vertices[j, 1] - eye_y, depth[j]
            term[j] = vertex_terms(dx, d, pad, s, low_x, high_x, texel) / texel
            term[j] = max(term[j], vertex_terms(dy, d, pad, s, low_y, high_y, texel) / texel)
            worst = 0.0
            for k in range(4):
                u, v = edge[k & 1] * (s - d) - dx, edge[2 + (k >> 1)] * (s - d) - dy
                worst = max(worst, math.hypot(u, v))
            offset[j] = worst + pad
        count = stack(t0, t_far, s, dl, depth, term, offset, 0.0, 0.0, plane, near, far)
        if count > 0 and (attempt == n or count * res_x * res_y < least):
            best, least, best_s = count, count * res_x * res_y, s
            frame[EYE_X], frame[EYE_Y], frame[PLANE_Z], frame[S] = eye_x, eye_y, top, s
            frame[LOW_X], frame[LOW_Y], frame[TEXEL], frame[RES_X], frame[RES_Y] = low_x, low_y, texel, res_x, res_y
    return best


@njit(cache=True)
def window(
    face: int, box: np.ndarray, cell: np.ndarray, plane: np.ndarray, near: np.ndarray, far: np.ndarray,
    frame: np.ndarray, crop: np.ndarray, out: np.ndarray,
) -> tuple[int, int]:  # fmt: skip
    """Return the layers [a, b) of a face that one of its boxes reaches into; fill its part of the grid and its crops.

    box   (2,3); cell, frame as in `lay_out_face`; plane, near, far  (count,) as it filled them
    crop  (count,2) out, rows a .. b: most columns and rows with content; frame[TEXELS] becomes their texels in all
    out   (4,) out: first column and row of the window in the face's grid, its columns and rows
    """
    axes, centre = np.empty((3, 3)), np.empty(3)
    face_axes(face, axes)
    for i in range(3):
        centre[i] = (cell[0, i] + cell[1, i]) / 2
    points, edge = np.empty((8, 3)), np.empty(4)
    corners(axes, box, centre, points)
    scale, low, high = 0.0, np.inf, -np.inf
    for k in range(8):
        scale = max(scale, abs(points[k, 0]) + abs(points[k, 1]) + abs(points[k, 2]))
        points[k, 2] -= frame[PLANE_Z]
        low, high = min(low, points[k, 2]), max(high, points[k, 2])
    pad = scale * ROUNDING
    a, b = 0, len(plane)
    while far[a] < low - pad and a + 1 < b:
        a += 1
    while near[b - 1] > high + pad and b - 1 > a:
        b -= 1
    _slopes(points, frame[EYE_X], frame[EYE_Y], frame[S], edge)
    for axis in range(2):
        start, count = (frame[LOW_X], frame[RES_X]) if axis == 0 else (frame[LOW_Y], frame[RES_Y])
        first = math.floor((edge[2 * axis] - start) / frame[TEXEL] - TOUCH)
        last = math.ceil((edge[2 * axis + 1] - start) / frame[TEXEL] + TOUCH)
        wide = min(4.0, count)  # as few as section 2 of the error metric asks for
        first = max(0.0, min(first, count - wide))
        out[axis] = first
        out[2 + axis] = max(wide, min(last, count) - first)
    total = 0.0
    for k in range(a, b):
        _crop(points, near[k] - pad, far[k] + pad, frame, crop[k])
        total += crop[k, 0] * crop[k, 1]
    frame[TEXELS] = total
    return a, b
