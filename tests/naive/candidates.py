"""Candidates by plain loops over every raw view cell: all shafts, all boxes, sets of cells as Python sets.

What one view cell weighs (`weigh_quickly`, `refit`) has tests of its own and is taken from the code.
"""

import math

import numpy as np
from farfield.candidates.generate import refit, thinning
from farfield.impostor.cells import contains, fit_box
from farfield.impostor.frames import weigh_quickly
from farfield.impostor.plan import precision
from farfield.rendertime.cost import impostor_cost
from farfield.viewspace.cost import cluster_cost


def raw_sets(box, cells, useful, *, shafts, boxes):
    """Return the distinct sets of useful cells (ascending tuples) that raw boxes and shafts hold, first found first."""
    found = {}
    if boxes:
        for node in range(len(cells.axis)):
            found.setdefault(tuple(c for c in useful if cells.start[node] <= c < cells.stop[node]))
    if shafts:
        apex, size = (box[0] + box[1]) / 2, math.dist(box[0], box[1])
        for ring in range(17):
            rise = math.sin(math.radians(-90 + ring * 11.25))
            level = math.cos(math.radians(-90 + ring * 11.25)) if 0 < ring < 16 else 0.0
            n = max(1, math.ceil(32 * level - 1e-9))
            for step in range(n):
                turn = 2 * math.pi * step / n
                axis = np.array([level * math.cos(turn), rise, level * math.sin(turn)])
                seen = [(c, *along_shaft(apex, axis, cells.cell_box[c])) for c in useful]
                for apex_angle in (11.25, 22.5, 45, 90):
                    s, r = math.sin(math.radians(apex_angle / 2)), math.cos(math.radians(apex_angle / 2))
                    for distance in range(10, -1, -1):
                        found.setdefault(tuple(
                            c for c, along, lateral, near, reach in seen
                            if near >= size * 2**distance and along * s - lateral * r >= reach
                        ))  # fmt: skip
    found.pop((), None)
    return list(found)


def along_shaft(apex, axis, box):
    """Return how far along the axis the middle of a box lies, how far off it, how far along its nearest point lies, and
    the radius of its bounding sphere: a round cone of half angle h holds the sphere iff along sin h - off cos h >= radius."""
    p = box.mean(0) - apex
    along = p @ axis
    off = np.linalg.norm(p - along * axis)
    return along, off, along - abs(axis) @ (box[1] - box[0]) / 2, np.linalg.norm(box[1] - box[0]) / 2


def candidates(hierarchy, model, cells, views, settings, nodes):
    """Return rows (cluster, kind, view cell, bytes, layers, cost, [(view, saved)]) sorted as Candidates are."""
    share, outdone = thinning(hierarchy, model, views, density=settings.placement.density)
    floor = impostor_cost(model, triangles=6, pixels=0)
    wanted = settings.placement.candidates
    p = precision(settings)
    scratch = [np.empty((3, 3)), np.empty(128), np.empty(128), np.empty(128), np.empty((128, 2)), np.empty(10)]
    best = {}  # cluster -> {cell: efficiency}, its ancestors included
    rows = []
    for c in range(*nodes):
        above = best.get(hierarchy.parent[c], {})
        best[c] = above
        if not hierarchy.replaceable[c]:
            continue
        a, b = int(hierarchy.start[c]), int(hierarchy.stop[c])
        costs = [cluster_cost(views, v, a, b) for v in range(len(views.cell))]
        gain = {}
        for v, cost in enumerate(costs):
            if cost > floor:
                cell = int(views.cell[v])
                gain[cell] = gain.get(cell, 0) + min(cost - floor, int(views.cost[v]) - model.target)
        box = hierarchy.box[c]
        sets = []
        for members in raw_sets(box, cells, sorted(gain), shafts=wanted != "boxes", boxes=wanted != "shafts"):
            weight = weigh_quickly(
                len(members) == 1, box, fit_box(cells.cell_box[list(members)]), p.delta, p.dl, *scratch
            )
            if weight < math.inf:
                sets.append((sum(gain[i] for i in members) / weight, members))
        sets.sort(key=lambda s: -s[0])
        held, reach, mine = set(), dict(above), []
        for efficiency, members in sets:
            need = [gain[i] for i in members if i not in held and above.get(i, 0) <= outdone * efficiency]
            if not need or sum(need) < share * sum(gain[i] for i in members):
                continue
            kind, view_cell, size, layers, cost = refit(
                box, cells.cell_box[list(members)], model=model, settings=settings
            )  # fmt: skip
            inside = [i for i in sorted(gain) if contains(kind, view_cell, cells.cell_box[[i]])[0]]
            served = [(v, costs[v] - cost) for v in range(len(costs)) if views.cell[v] in inside and costs[v] > cost]
            if not served:
                continue
            held |= set(inside)
            for i in inside:
                reach[i] = max(reach.get(i, 0), efficiency)
            mine.append((c, kind, tuple(view_cell), size, layers, cost, served))
        best[c] = reach
        rows += sorted(mine, key=lambda row: row[:3])
    return rows
