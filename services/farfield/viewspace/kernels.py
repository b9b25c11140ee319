"""Numba kernels of the search for problem views. Integers are summed; every float decision is in a fixed order."""

import math

import numpy as np
from numba import njit

from farfield.geometry.kernels import accepts


@njit(cache=True)
def seen_from(boxes, cell, box):
    """Fill box (7,N): centre and half sizes of object - viewpoint differences, and |centre| + |half sizes|."""
    for i in range(len(boxes)):
        q2 = 0.0
        g2 = 0.0
        for k in range(3):
            q = (boxes[i, 0, k] + boxes[i, 1, k] - (cell[0, k] + cell[1, k])) / 2
            g = (boxes[i, 1, k] - boxes[i, 0, k] + (cell[1, k] - cell[0, k])) / 2
            box[k, i] = q
            box[3 + k, i] = g
            q2 += q * q
            g2 += g * g
        box[6, i] = math.sqrt(q2) + math.sqrt(g2)


@njit(cache=True)
def descend(box, cost, n_first, lists, normals, row, pad, n, target, out_view, out_object):
    """Descend the six quadtrees of one cell; return (views, entries, worst, worst within target).

    box (7,N), cost (N,) are of n_first objects; lists (levels + 2, N) i32 is scratch, its first row 0 .. n_first.
    Interval by interval, depth first: out_view (6 n^2, 4) i64 gets interval, cost and the range of out_object with the
    accepted objects, as places in box.
    Entries beyond the length of out_object are counted, not written.
    """
    count = np.zeros(len(lists), dtype=np.int64)
    count[0] = n_first
    stack = np.empty((6 + 3 * len(lists), 4), dtype=np.int64)  # depth (a face is 1), face, i, j
    for face in range(6):
        stack[5 - face, 0], stack[5 - face, 1], stack[5 - face, 2], stack[5 - face, 3] = 1, face, 0, 0
    size = 6
    views = 0
    entries = 0
    worst = 0
    worst_within = 0
    while size > 0:
        size -= 1
        depth, face, i, j = stack[size, 0], stack[size, 1], stack[size, 2], stack[size, 3]
        side = 1 << (depth - 1)
        frustum = 2 * (side * side - 1) + (face * side + j) * side + i
        start, stop = row[frustum], row[frustum + 1]
        parent = lists[depth - 1]
        here = lists[depth]
        total = 0
        kept = 0
        for m in range(count[depth - 1]):
            o = parent[m]
            rejected = accepts(
                normals, start, stop, pad[frustum],
                box[0, o], box[1, o], box[2, o], box[3, o], box[4, o], box[5, o], box[6, o],
            )  # fmt: skip
            if rejected < 0:
                here[kept] = o
                kept += 1
                total += cost[o]
        count[depth] = kept
        if total > target and side < n:
            for child in range(3, -1, -1):
                stack[size, 0], stack[size, 1] = depth + 1, face
                stack[size, 2], stack[size, 3] = 2 * i + (child & 1), 2 * j + (child >> 1)
                size += 1
            continue
        worst = max(worst, total)
        if total <= target:
            worst_within = max(worst_within, total)
            continue
        if entries + kept <= len(out_object):
            out_object[entries : entries + kept] = here[:kept]
        out_view[views, 0], out_view[views, 1] = (face * n + j) * n + i, total
        out_view[views, 2], out_view[views, 3] = entries, entries + kept
        views += 1
        entries += kept
    return views, entries, worst, worst_within


@njit(cache=True)
def count_runs(views, entries):
    """Return how many runs of consecutive places the entries of `views` (V,4) make."""
    total = 0
    for v in range(len(views)):
        last = -2
        for e in range(views[v, 2], views[v, 3]):
            total += entries[e] != last + 1
            last = entries[e]
    return total


@njit(cache=True)
def gather(views, entries, cost, row, run, before):
    """Fill row (V+1,), run (R,2) and before (R,) from the entries of `views`, already in order."""
    at = 0
    for v in range(len(views)):
        last = -2
        running = 0
        for e in range(views[v, 2], views[v, 3]):
            p = entries[e]
            if p != last + 1:
                run[at, 0], before[at] = p, running
                at += 1
            run[at - 1, 1] = p + 1
            running += cost[p]
            last = p
        row[v + 1] = at


@njit(cache=True)
def first_at_least(objects, start, stop, o):
    """Return the first position in [start, stop) whose object id is >= o, or stop."""
    while start < stop:
        middle = (start + stop) // 2
        if objects[middle] < o:
            start = middle + 1
        else:
            stop = middle
    return start


@njit(cache=True)
def _cost_below(views, v, begin, p):
    """Return the cost of view v's objects at positions < p of its cell's list, which begins at `begin`."""
    low, high = views.row[v], views.row[v + 1]
    stop = high
    while low < stop:  # the first run that ends past p
        middle = (low + stop) // 2
        if views.run[middle, 1] <= p:
            low = middle + 1
        else:
            stop = middle
    if low == high:
        return views.cost[v]
    first = views.run[low, 0]
    if p <= first:
        return views.before[low]
    skipped = views.list_through[begin + first - 1] if first > 0 else np.int64(0)
    return views.before[low] + views.list_through[begin + p - 1] - skipped


@njit(cache=True)
def cluster_cost(views, v, a, b):
    """Return the cost of objects [a, b) in view v. views: `farfield.viewspace.cost.Runs`."""
    list_id = views.list[v]
    begin, end = views.list_row[list_id], views.list_row[list_id + 1]
    low = first_at_least(views.list_object, begin, end, a)
    high = first_at_least(views.list_object, low, end, b)
    if low == high:
        return np.int64(0)
    return _cost_below(views, v, begin, high - begin) - _cost_below(views, v, begin, low - begin)


@njit(cache=True)
def cluster_costs(views, v, a, b, out):
    for k in range(len(out)):
        out[k] = cluster_cost(views, v[k], a[k], b[k])
