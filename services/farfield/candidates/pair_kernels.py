"""Numba kernel that lists which clusters cost something in which problem views."""

import numpy as np
from numba import njit

from farfield.viewspace.kernels import first_at_least


@njit(cache=True)
def _cost_below(views, v, begin, p, low, high):
    """Return (cost of view v's objects at positions < p of its list, the first run in [low, high] that ends past p)."""
    last = views.row[v + 1]
    while low < high:
        middle = (low + high) // 2
        if views.run[middle, 1] <= p:
            low = middle + 1
        else:
            high = middle
    if low == last:
        return views.cost[v], low
    first = views.run[low, 0]
    if p <= first:
        return views.before[low], low
    skipped = views.list_through[begin + first - 1] if first > 0 else np.int64(0)
    return views.before[low] + views.list_through[begin + p - 1] - skipped, low


@njit(cache=True)
def list_pairs(views, start, stop, left, right, nodes, floor, count, row, view, cost):
    """List the pairs of a cluster in nodes = [a, b) and a problem view in which it costs more than `floor` >= 0.

    views       `farfield.viewspace.cost.Runs`
    start .. right  (C,) the hierarchy in preorder
    count       (b - a,) i64 out: pairs of each cluster
    row         (b - a + 1,) i64: cluster a + i's pairs go to view (P,) i32, ascending, and cost (P,) i64 at [row[i],
                row[i + 1]); where `view` is empty they are only counted
    A cluster costs no more than one around it: each view descends from the top and leaves what costs too little, so that
    the work is linear in the pairs that are found.
    """
    a, b = nodes
    low, high = start[a], stop[a]
    tops = [a]
    for other in range(a + 1, b):
        if start[other] >= high:
            tops.append(other)
            high = stop[other]
    count[:] = 0
    fill = len(view) > 0
    n_views = len(views.cost)
    for v in range(n_views):
        list_id = views.list[v]
        begin, end = views.list_row[list_id], views.list_row[list_id + 1]
        p0 = first_at_least(views.list_object, begin, end, low) - begin
        p1 = first_at_least(views.list_object, begin + p0, end, high) - begin
        c0, r0 = _cost_below(views, v, begin, p0, views.row[v], views.row[v + 1])
        c1, r1 = _cost_below(views, v, begin, p1, r0, views.row[v + 1])
        if c1 - c0 <= floor:
            continue
        # what is waiting: cluster, its positions, the cost below each, and their runs
        waiting = [(np.int64(0), np.int64(0), np.int64(0), np.int64(0), np.int64(0), np.int64(0), np.int64(0))]
        waiting.pop()
        for top in tops:
            p = first_at_least(views.list_object, begin + p0, begin + p1, start[top]) - begin
            q = first_at_least(views.list_object, begin + p, begin + p1, stop[top]) - begin
            cp, rp = _cost_below(views, v, begin, p, r0, r1)
            cq, rq = _cost_below(views, v, begin, q, rp, r1)
            waiting.append((np.int64(top), p, q, cp, cq, rp, rq))
            while len(waiting):
                c, p, q, cp, cq, rp, rq = waiting.pop()
                if c >= b or cq - cp <= floor:
                    continue
                if fill:
                    at = row[c - a] + count[c - a]
                    view[at], cost[at] = v, cq - cp
                count[c - a] += 1
                if left[c] < 0:
                    continue
                m = first_at_least(views.list_object, begin + p, begin + q, start[right[c]]) - begin
                cm, rm = _cost_below(views, v, begin, m, rp, rq)
                waiting.append((np.int64(right[c]), m, q, cm, cq, rm, rq))
                waiting.append((np.int64(left[c]), p, m, cp, cm, rp, rm))
