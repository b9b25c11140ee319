"""Problem views by plain loops: every cell, every interval, every object, no early end."""

import functools

import numpy as np
from farfield.geometry.frusta import enclosing_frustum
from naive import frusta as naive

frustum = functools.lru_cache(maxsize=None)(enclosing_frustum)


def problem_views(boxes, cost, cell_box, *, visible, n, camera, target):
    """Return {interval: (bound, objects)} of one cell. cost(o): bound of object o from this cell."""
    found = {}
    objects = [o for o in range(len(boxes)) if o in visible]
    if sum(cost[o] for o in objects) <= target:
        return found

    def descend(face, i, j, side, objects):
        normals, pad = frustum(face, i, j, side, fov_deg=camera.fov_deg, width=camera.width, height=camera.height)
        objects = [o for o in objects if naive.accepts(normals, pad, boxes[o], cell_box)]
        bound = sum(int(cost[o]) for o in objects)
        if bound <= target:
            return
        if side == n:
            found[(face * n + j) * n + i] = (bound, objects)
            return
        for dj in (0, 1):
            for di in (0, 1):
                descend(face, 2 * i + di, 2 * j + dj, 2 * side, objects)

    for face in range(6):
        descend(face, 0, 0, 1, objects)
    return found


def cluster_cost(views, cost, v, a, b):
    """Cost of objects [a, b) in view v: a sum. cost (N,) of the view's cell."""
    low, high = views.list_row[views.list[v]], views.list_row[views.list[v] + 1]
    objects = views.list_object[low:high]
    shown = [int(objects[p]) for first, stop in views.run[views.row[v] : views.row[v + 1]] for p in range(first, stop)]
    return int(np.sum([cost[o] for o in shown if a <= o < b], dtype=np.int64))
