"""View cells of impostors: shafts and boxes, and the tightest ones around given boxes.

A SHAFT is a round cone cut off by two planes across its axis; a BOX lies along the world's axes. Both are kept as 9
numbers, see `farfield.candidates.model.Candidates.view_cell`.

Problem  Given the boxes of the cells that an impostor serves: the shaft with the smallest apex angle, the largest near
         and the smallest far distance, from a given apex, that holds them all; or their bounding box.
Method   A convex cone holds a box iff it holds its corners. The smallest cone is the smallest cap on the sphere of
         directions: fixed by two or three of them. Start with one, add the direction farthest outside, exchange (the
         smallest cap through at most three of the four that holds all four), until none is outside.
Errs     Outwards: the cone found is widened by rounding until `contains` holds for every box.
After    Welzl. Smallest enclosing disks (balls and ellipsoids). 1991. (The exchange; there it is randomised.)
"""

import math

import numpy as np
from numba import njit

from farfield.impostor.frames import BOX, SHAFT

__all__ = ["BOX", "SHAFT", "contains", "fit_box", "fit_shaft"]

SLACK = 1e-12  # relative widening, far above the rounding of the test and far below anything that matters


@njit(cache=True)
def shaft_holds(cell: np.ndarray, box: np.ndarray) -> bool:
    """Return whether a shaft (9,) holds a box (2,3): |p x A| <= T (p . A) and near <= p . A <= far at every corner."""
    for k in range(8):
        x = box[(k >> 2) & 1, 0] - cell[0]
        y = box[(k >> 1) & 1, 1] - cell[1]
        z = box[k & 1, 2] - cell[2]
        along = x * cell[3] + y * cell[4] + z * cell[5]
        cx, cy, cz = y * cell[5] - z * cell[4], z * cell[3] - x * cell[5], x * cell[4] - y * cell[3]
        if not (cell[7] <= along <= cell[8]) or not math.sqrt(cx * cx + cy * cy + cz * cz) <= cell[6] * along:
            return False
    return True


@njit(cache=True)
def _cap(points: np.ndarray, use: np.ndarray, n: int, axis: np.ndarray) -> bool:
    """Write the unit axis of the smallest cap through n = 1, 2, 3 directions `points[use]`; False if degenerate."""
    p = points[use[0]]
    if n == 1:
        axis[:] = p
        return True
    q = points[use[1]]
    if n == 2:
        axis[:] = p + q
    else:
        # the plane through three points of the sphere: its normal is the axis
        u, v = q - p, points[use[2]] - p
        axis[0] = u[1] * v[2] - u[2] * v[1]
        axis[1] = u[2] * v[0] - u[0] * v[2]
        axis[2] = u[0] * v[1] - u[1] * v[0]
        if axis[0] * p[0] + axis[1] * p[1] + axis[2] * p[2] < 0:
            axis[:] = -axis
    length = math.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    if not length > 1e-14:
        return False
    axis /= length
    return True


@njit(cache=True)
def _distance(axis: np.ndarray, p: np.ndarray) -> float:
    """Return the squared chord between two unit directions: monotone in the angle, and exact for small ones."""
    x, y, z = axis[0] - p[0], axis[1] - p[1], axis[2] - p[2]
    return x * x + y * y + z * z


@njit(cache=True)
def smallest_cap(points: np.ndarray, n: int, axis: np.ndarray) -> None:
    """Write the unit axis of the smallest cap around unit directions points[:n]; they must fit into a half space."""
    support, size = np.zeros(4, dtype=np.int64), 1
    axis[:] = points[0]
    trial, best = np.empty(3), np.empty(3)
    chosen, chosen_size = np.zeros(4, dtype=np.int64), 0
    subset = np.zeros(4, dtype=np.int64)
    reach = 0.0
    for _ in range(64):
        worst, outside = -1, reach * (1 + 1e-10) + 1e-28
        for i in range(n):
            d = _distance(axis, points[i])
            if d > outside:
                worst, outside = i, d
        if worst < 0:
            return
        support[size] = worst
        total = size + 1
        least = np.inf
        # subsets of the support that hold the new direction, at most three
        for mask in range(1 << size):
            k = 1
            subset[0] = worst
            for j in range(size):
                if mask >> j & 1:
                    if k < 3:
                        subset[k] = support[j]
                    k += 1
            if k > 3 or not _cap(points, subset, k, trial):
                continue
            r = _distance(trial, points[worst])
            if r >= least:
                continue
            holds = True
            for j in range(total):
                if _distance(trial, points[support[j]]) > r * (1 + 1e-9) + 1e-28:
                    holds = False
                    break
            if holds:
                least, chosen_size = r, k
                best[:] = trial
                chosen[:] = subset
        if least == np.inf or least <= reach:  # rounding: no progress is left
            return
        axis[:] = best
        support[:] = chosen
        size, reach = chosen_size, least


@njit(cache=True)
def wrap_shaft(apex: np.ndarray, boxes: np.ndarray, use: np.ndarray, points: np.ndarray, out: np.ndarray) -> bool:
    """Write the tightest shaft (9,) from `apex` around boxes[use]; False if they surround the apex or touch it.

    boxes  (L,2,3); use (K,) rows; points  scratch (8 K, 3) at least
    """
    n = 0
    for i in use:
        for k in range(8):
            x = boxes[i, (k >> 2) & 1, 0] - apex[0]
            y = boxes[i, (k >> 1) & 1, 1] - apex[1]
            z = boxes[i, k & 1, 2] - apex[2]
            length = math.sqrt(x * x + y * y + z * z)
            if not length > 0:
                return False
            points[n, 0], points[n, 1], points[n, 2] = x / length, y / length, z / length
            n += 1
    axis = np.empty(3)
    smallest_cap(points, n, axis)
    tangent, near, far = 0.0, np.inf, 0.0
    for i in use:
        for k in range(8):
            x = boxes[i, (k >> 2) & 1, 0] - apex[0]
            y = boxes[i, (k >> 1) & 1, 1] - apex[1]
            z = boxes[i, k & 1, 2] - apex[2]
            along = x * axis[0] + y * axis[1] + z * axis[2]
            if not along > 0:
                return False
            cx, cy, cz = y * axis[2] - z * axis[1], z * axis[0] - x * axis[2], x * axis[1] - y * axis[0]
            tangent = max(tangent, math.sqrt(cx * cx + cy * cy + cz * cz) / along)
            near, far = min(near, along), max(far, along)
    for i in range(3):
        out[i], out[3 + i] = apex[i], axis[i]
    # A box seen from afar subtends so little that rounding of the corners, not of the test, sets the absolute part.
    out[6] = tangent * (1 + SLACK) + SLACK
    out[7], out[8] = near * (1 - SLACK), far * (1 + SLACK)
    return True


@njit(cache=True)
def wrap_box(boxes: np.ndarray, use: np.ndarray, out: np.ndarray) -> None:
    """Write the bounding box of boxes[use] as a view cell (9,)."""
    for k in range(3):
        low, high = np.inf, -np.inf
        for i in use:
            low, high = min(low, boxes[i, 0, k]), max(high, boxes[i, 1, k])
        out[k], out[3 + k], out[6 + k] = low, high, 0.0


def fit_shaft(apex: np.ndarray, cell_boxes: np.ndarray) -> np.ndarray | None:
    """Return the tightest shaft (9,) f64 from `apex` (3,) around the boxes (K,2,3), K >= 1; None if there is none."""
    boxes = np.ascontiguousarray(cell_boxes, dtype=np.float64).reshape(-1, 2, 3)
    out = np.empty(9)
    use = np.arange(len(boxes))
    apex = np.ascontiguousarray(apex, dtype=np.float64)
    return out if wrap_shaft(apex, boxes, use, np.empty((8 * len(boxes), 3)), out) else None


def fit_box(cell_boxes: np.ndarray) -> np.ndarray:
    """Return the bounding box of the boxes (K,2,3) f64, K >= 1, as a view cell (9,) f64."""
    boxes = np.ascontiguousarray(cell_boxes, dtype=np.float64).reshape(-1, 2, 3)
    out = np.empty(9)
    wrap_box(boxes, np.arange(len(boxes)), out)
    return out


def contains(kind: int, view_cell: np.ndarray, cell_boxes: np.ndarray) -> np.ndarray:
    """Return (K,) b1: which boxes (K,2,3) lie in the view cell (9,). Exact (error-metric.md section 10)."""
    boxes = np.ascontiguousarray(cell_boxes, dtype=np.float64).reshape(-1, 2, 3)
    if kind == BOX:
        low, high = view_cell[:3], view_cell[3:6]
        return np.asarray(((boxes[:, 0] >= low) & (boxes[:, 1] <= high)).all(1))
    cell = np.ascontiguousarray(view_cell, dtype=np.float64)
    return np.array([shaft_holds(cell, box) for box in boxes], dtype=np.bool_)
