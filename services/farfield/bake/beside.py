"""Which texels of an impostor hold surfaces of objects that it does not replace.

Problem  Where a surface of the cluster ends, its texels are drawn to the share that it covers. Where it ends because the
         next surface belongs to another object (the other half of a street, the ground under a wall), both sides would
         be drawn in part, and the background shine through between them.
Method   The triangles of all other objects that reach into the cluster's box, clipped to it, are cut to the slabs and
         found texel by texel as the cluster's own, some objects at a time; texels that they touch, in their layer or the
         next, are marked.
Errs     Towards marking: the box is taken a little larger, and surfaces that do not meet the cluster's are marked, too.
"""

from typing import Any

import numpy as np
from numba import njit

from farfield.bake import kernels
from farfield.bake.clip import grid
from farfield.bake.coverage import edge_bounds, piece_edges, span
from farfield.bake.records import Slabs
from farfield.columns import release
from farfield.impostor.plan import LayerPlan
from farfield.scene.model import Scene

_MARGIN = 1e-5  # of the box's diagonal
BATCH = 1 << 16  # triangles at once: 33 MB, whatever lies in the box


def mark_beside(scene: Scene, objects: tuple[int, int], box: np.ndarray, plan: LayerPlan, slabs: Slabs,
                start: np.ndarray) -> np.ndarray:  # fmt: skip
    """Return (N,) u1: 1 for each texel (see `area.layer_starts`) that an object outside [a, b) marks.

    box  (2,3) f64, of the cluster, in the frame of scene.object_box
    """
    marks = np.zeros(int(start[-1]), np.uint8)
    low, high = box[0], box[1]
    grown = _MARGIN * float(np.sqrt(((high - low) ** 2).sum()))
    low, high = low - grown, high + grown
    near = (scene.object_box[:, 0] <= high).all(1) & (scene.object_box[:, 1] >= low).all(1)
    near[objects[0] : objects[1]] = False
    others = np.flatnonzero(near)
    if not len(others):
        return marks
    axes = np.stack([plan.right, plan.up, -plan.back]).astype(np.float64)
    eye = np.ascontiguousarray(plan.eye, np.float64)
    near_end, far_end = np.array(plan.near, np.float64), np.array(plan.far, np.float64)
    near_end[0], far_end[-1] = -np.inf, np.inf
    for batch, (first, last) in _batches(others, scene.object_triangles):
        corner = np.empty((7 * (last - first), 3, 3))
        found = kernels.gather_inside(
            scene.position, scene.index, scene.primitive_triangle, scene.mesh_primitive, scene.primitive_vertex,
            scene.object_mesh, scene.object_matrix, batch, first, last, low, high, eye, axes, corner,
        )  # fmt: skip
        corner = corner[:found]
        count = np.zeros(len(near_end), np.int64)
        kernels.count_pieces(corner, near_end, far_end, count)
        row = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
        snapped = np.empty((found, 6), np.int32)
        kernels.snap_corners(corner, *grid(plan), snapped)
        piece, source = np.empty((int(row[-1]), 6), np.int32), np.empty(int(row[-1]), np.int32)
        kernels.fill_pieces(corner, snapped, near_end, far_end, *grid(plan), row[:-1].copy(), piece, source)
        _mark(row, piece, slabs, start, marks)
        release(scene.position)
    return marks


def _batches(objects: np.ndarray, triangles: np.ndarray) -> list[tuple[np.ndarray, tuple[int, int]]]:
    """Return runs of BATCH triangles: the objects that have them, and [first, last) of all triangles of these objects."""
    end = np.cumsum(triangles[objects])
    runs = []
    for low in range(0, int(end[-1]), BATCH):
        high = min(low + BATCH, int(end[-1]))
        a, b = np.searchsorted(end, low, side="right"), np.searchsorted(end, high, side="left") + 1
        before = int(end[a] - triangles[objects[a]])
        runs.append((objects[a:b], (low - before, high - before)))
    return runs


@njit(cache=True)
def _mark(row: Any, piece: Any, slabs: Any, start: Any, marks: Any) -> None:
    edge = np.empty((3, 4), np.int64)
    lo, hi = np.empty(3, np.int64), np.empty(3, np.int64)
    for k in range(len(row) - 1):
        for f in range(row[k], row[k + 1]):
            p = piece[f]
            twice = piece_edges(p, edge)
            for e in range(3):
                lo[e], hi[e] = edge_bounds(edge[e, 0], edge[e, 1], edge[e, 2], edge[e, 3], twice)
            for layer in range(max(k - 1, 0), min(k + 2, len(row) - 1)):
                low, size = slabs.low[layer], slabs.size[layer]
                i0 = max(-((-min(p[0], p[2], p[4])) // 256) - 1, low[0])
                i1 = min(max(p[0], p[2], p[4]) // 256, low[0] + size[0] - 1)
                j0 = max(-((-min(p[1], p[3], p[5])) // 256) - 1, low[1])
                j1 = min(max(p[1], p[3], p[5]) // 256, low[1] + size[1] - 1)
                for j in range(j0, j1 + 1):
                    a, b = i0, i1
                    for e in range(3):
                        a, b = span(j, lo[e], hi[e], edge[e, 2], edge[e, 3], a, b)
                    for i in range(a, b + 1):
                        marks[start[layer] + (j - low[1]) * size[0] + i - low[0]] = 1
