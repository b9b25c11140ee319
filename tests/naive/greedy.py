"""Slow, obvious twins of placement: the greedy scores all before each choice; antichains are tried one by one."""

from fractions import Fraction
from itertools import combinations

import numpy as np
from farfield.viewspace.cost import view_objects


def inside(hierarchy, a, b):
    """True if cluster b holds cluster a (or is it)."""
    return hierarchy.start[b] <= hierarchy.start[a] and hierarchy.stop[a] <= hierarchy.stop[b]


def geometry_cost(hierarchy, views, cluster, v):
    objects = zip(*(a.tolist() for a in view_objects(views, v)))
    return sum(cost for o, cost in objects if hierarchy.start[cluster] <= o < hierarchy.stop[cluster])


def place(hierarchy, views, candidates, target):
    """Return (candidates in the order chosen, {view: {candidates shown}}); scores everything before each choice."""
    n = len(candidates.cluster)
    served = [[int(v) for v in candidates.view[candidates.row[i] : candidates.row[i + 1]]] for i in range(n)]
    shown = {v: set() for v in range(len(views.cell))}
    cost = [int(c) for c in views.cost]
    geometry = {(i, v): geometry_cost(hierarchy, views, candidates.cluster[i], v) for i in range(n) for v in served[i]}

    def drawn(i, v):
        """What is drawn now for candidate i's cluster; None under an impostor of a larger cluster."""
        total = geometry[i, v]
        for j in shown[v]:
            if inside(hierarchy, candidates.cluster[j], candidates.cluster[i]):
                total += int(candidates.cost[j]) - geometry[j, v]
            elif inside(hierarchy, candidates.cluster[i], candidates.cluster[j]):
                return None
        return total

    def gain(i, v):
        now = drawn(i, v)
        return 0 if now is None else max(0, min(now - int(candidates.cost[i]), cost[v] - int(target[v])))

    order = []
    while True:
        scores = [Fraction(sum(gain(i, v) for v in served[i]), int(candidates.bytes[i])) for i in range(n)]
        if not scores or max(scores) == 0:
            return order, shown
        i = scores.index(max(scores))
        order.append(i)
        for v in served[i]:
            if gain(i, v) > 0:
                cost[v] -= drawn(i, v) - int(candidates.cost[i])
                covered = {j for j in shown[v] if inside(hierarchy, candidates.cluster[j], candidates.cluster[i])}
                shown[v] = shown[v] - covered | {i}


def antichains(hierarchy, cluster):
    """Yield every set of positions in `cluster` of which no two nest."""
    for size in range(len(cluster) + 1):
        for chosen in combinations(range(len(cluster)), size):
            if not any(
                inside(hierarchy, cluster[a], cluster[b]) or inside(hierarchy, cluster[b], cluster[a])
                for a, b in combinations(chosen, 2)
            ):
                yield chosen


def best_saving(hierarchy, cluster, saved):
    return max(sum(int(saved[k]) for k in chosen) for chosen in antichains(hierarchy, cluster))


def least(hierarchy, cluster, saved, need):
    """Return (size, saving) of the antichain that saves `need` with fewest, then saves most; None: none does."""
    found = [(len(c), -sum(int(saved[k]) for k in c)) for c in antichains(hierarchy, cluster)]
    met = [(size, -saving) for size, saving in sorted(found) if -saving >= need]
    return met[0] if met else None


def lightest(hierarchy, cluster, saved, price, need):
    """Return the least price of an antichain that saves `need`; None: none does."""
    return min(
        (
            sum(int(price[k]) for k in c)
            for c in antichains(hierarchy, cluster)
            if sum(int(saved[k]) for k in c) >= need
        ),
        default=None,
    )


def reaches(hierarchy, views, candidates, chosen, target):
    """True if in every view some antichain of the chosen candidates meets the target."""
    for v in range(len(views.cell)):
        options = [
            (candidates.cluster[i], candidates.saved[e])
            for i in chosen
            for e in range(candidates.row[i], candidates.row[i + 1])
            if candidates.view[e] == v
        ]
        clusters, saved = [o[0] for o in options], [o[1] for o in options]
        if views.cost[v] - best_saving(hierarchy, clusters, saved) > target[v]:
            return False
    return True


def lightest_bytes(hierarchy, views, candidates, target):
    """Return the least bytes of any set of candidates that reaches every target, by trying all sets."""
    n = len(candidates.cluster)
    sizes = [int(b) for b in candidates.bytes]
    sets = sorted((sum(sizes[i] for i in s), s) for k in range(n + 1) for s in combinations(range(n), k))
    return next(total for total, s in sets if reaches(hierarchy, views, candidates, s, target))


def view_costs(hierarchy, views, cluster, cost, serve_row, serve):
    """Return the cost of each view by walking over its objects and over what it shows."""
    total = np.zeros(len(views.cell), dtype=np.int64)
    for v in range(len(views.cell)):
        shown = serve[serve_row[v] : serve_row[v + 1]]
        for o, geometry in zip(*view_objects(views, v)):
            if not any(hierarchy.start[cluster[s]] <= o < hierarchy.stop[cluster[s]] for s in shown):
                total[v] += geometry
        total[v] += sum(int(cost[s]) for s in shown)
    return total
