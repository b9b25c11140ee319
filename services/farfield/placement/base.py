"""Keep what a level's earlier placement has that still holds.

Problem  Of a placement of a level that has changed since: which impostors show what they showed, are as they would be
         baked now, and where may they be shown? What comes nearest to those that do not?
Method   Objects are matched by what they are (`scene.identity`). An impostor holds if its cluster is a cluster still, of
         the same objects, no object that came, went or moved meets the cluster's box (the bake looks at what stands
         beside), and it was shown somewhere (else its layers are not stored). It serves every cell that its view cell
         holds. Others are fitted anew, where the objects that are left of their cluster still make one up with what is
         new: the same cells, the new box.
Errs     Towards change: a box that is met need not change a texel.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from farfield.candidates.model import Candidates, take
from farfield.geometry.cells import CellTree
from farfield.hierarchy.model import Hierarchy
from farfield.impostor.cells import contains
from farfield.placement.antichain import best_in_views, offers_of
from farfield.placement.choose import choose
from farfield.placement.rescue import rescue
from farfield.placement.tighten import Refit
from farfield.scene.model import Scene
from farfield.viewspace.cost import cluster_costs
from farfield.viewspace.model import ProblemViews

MARGIN = 1e-3  # of a cluster's diagonal: what stands nearer may be beside it; the bake looks 1e-5 of it around


@dataclass(frozen=True, slots=True, kw_only=True)
class Base:
    """An earlier placement: N objects, L leaf cells, I impostors, all as they were then."""

    object_digest: np.ndarray  # (N,16) u1  see farfield.scene.identity
    object_box: np.ndarray  # (N,2,3) f64  relative to origin_m
    origin_m: np.ndarray  # (3,) f64
    cell_box: np.ndarray  # (L,2,3) f64
    start: np.ndarray  # (I,) i32  objects [start, stop) of its cluster
    stop: np.ndarray  # (I,) i32
    kind: np.ndarray  # (I,) u1
    view_cell: np.ndarray  # (I,9) f64
    bytes: np.ndarray  # (I,) i64  measured
    layers: np.ndarray  # (I,) i32
    cost: np.ndarray  # (I,) i64  measured
    cell_row: np.ndarray  # (I+1,) i64
    cell: np.ndarray  # (S,) i32  leaf cells in which it is shown, ascending


def keep(base: Base, scene: Scene, digest: np.ndarray, hierarchy: Hierarchy, cells: CellTree, views: ProblemViews, *,
         refit: Refit) -> Candidates:  # fmt: skip
    """Return what the base offers the problem views of the level as it is now: impostors that hold, and some fitted anew.

    digest  (N,16) u1 of the scene's objects
    Sorted by cluster, those that hold first; `base` says which they are.
    """
    new_of = match(base.object_digest, digest)
    came = np.ones(scene.n_objects, dtype=bool)
    came[new_of[new_of >= 0]] = False
    boxes = [scene.object_box[came]]
    if np.array_equal(base.origin_m, scene.origin_m):
        boxes.append(base.object_box[new_of < 0])
    changed = np.concatenate(boxes)
    cell_of = _places(base.cell_box, cells.cell_box)
    node, whole = _clusters(base, new_of, hierarchy)
    holds = whole & ~_met(hierarchy.box, node, changed) & (np.diff(base.cell_row) > 0)
    found = []
    for i in range(len(base.start)):
        if holds[i]:
            inside = contains(int(base.kind[i]), base.view_cell[i], cells.cell_box)
            served, cost = np.flatnonzero(inside), int(base.cost[i])
            row = (i, int(node[i]), int(base.kind[i]), base.view_cell[i], int(base.bytes[i]), int(base.layers[i]), cost)
        else:
            served = cell_of[base.cell[base.cell_row[i] : base.cell_row[i + 1]]]
            served = np.unique(served[served >= 0])
            c = int(node[i]) if whole[i] else _left_of(base, i, new_of, came, hierarchy)
            if c < 0 or not len(served) or not hierarchy.replaceable[c]:
                continue
            kind, view_cell, size, layers, cost = refit(hierarchy.box[c], cells.cell_box[served])
            row = (-1, c, kind, view_cell, size, layers, cost)
        view, saved = _gains(views, hierarchy, row[1], served, cost)
        if len(view):
            found.append((*row, view, saved))
    return _candidates(found)


def match(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return (N,) i64: the row of `new` (K,16) that equals each row of `old` (N,16), each once, in order; -1: none."""
    places: dict[bytes, list[int]] = {}
    for i in reversed(range(len(new))):
        places.setdefault(new[i].tobytes(), []).append(i)
    return np.array([(places.get(d.tobytes()) or [-1]).pop() for d in old], dtype=np.int64)


def _places(old: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return (L,) i64: the cell of `new` that has the box of each cell of `old`, bit for bit; -1: none."""
    at = {box.tobytes(): i for i, box in enumerate(np.ascontiguousarray(new))}
    return np.array([at.get(box.tobytes(), -1) for box in np.ascontiguousarray(old)], dtype=np.int64)


def _clusters(base: Base, new_of: np.ndarray, hierarchy: Hierarchy) -> tuple[np.ndarray, np.ndarray]:
    """Return (node (I,) i64, whole (I,) b1): the cluster of the very objects of each impostor, where there is one."""
    broken = np.ones(len(new_of) + 1, np.int64)  # object k does not follow object k - 1 as it did
    broken[1:-1] = (new_of[1:] < 0) | (new_of[:-1] < 0) | (new_of[1:] != new_of[:-1] + 1)
    through = np.cumsum(broken)
    n = int(hierarchy.stop[0]) + 1
    key = hierarchy.start.astype(np.int64) * n + hierarchy.stop
    order = np.argsort(key)
    first = new_of[base.start]
    wanted = first * n + first + (base.stop - base.start)
    at = np.minimum(np.searchsorted(key[order], wanted), len(key) - 1)
    node = order[at]
    whole = (first >= 0) & (through[base.stop - 1] == through[base.start]) & (key[node] == wanted)
    return node, whole


def _met(box: np.ndarray, node: np.ndarray, changed: np.ndarray) -> np.ndarray:
    """Return (I,) b1: whether one of the boxes `changed` (K,2,3) reaches into the box of the cluster, or nearly."""
    out = np.zeros(len(node), dtype=bool)
    low, high = box[node, 0], box[node, 1]
    grown = MARGIN * np.sqrt(((high - low) ** 2).sum(1))[:, None]
    for low_k, high_k in changed:
        out |= ((low - grown <= high_k) & (low_k <= high + grown)).all(1)
    return out


def _left_of(base: Base, i: int, new_of: np.ndarray, came: np.ndarray, hierarchy: Hierarchy) -> int:
    """Return the least cluster with all that is left of impostor i's, if all else in it is new; -1: none is."""
    left = new_of[base.start[i] : base.stop[i]]
    left = left[left >= 0]
    if not len(left):
        return -1
    node, low, high = 0, left.min(), left.max()
    while hierarchy.left[node] >= 0:
        child = hierarchy.left[node] if high < hierarchy.stop[hierarchy.left[node]] else hierarchy.right[node]
        if not (hierarchy.start[child] <= low and high < hierarchy.stop[child]):
            break
        node = child
    others = np.setdiff1d(np.arange(hierarchy.start[node], hierarchy.stop[node]), left)
    return int(node) if came[others].all() else -1


def _gains(
    views: ProblemViews, hierarchy: Hierarchy, cluster: int, served: np.ndarray, cost: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return (view, saved) of the problem views of the cells `served`, ascending, in which the impostor saves something."""
    first, last = np.searchsorted(views.cell, served), np.searchsorted(views.cell, served + 1)
    count = last - first
    view = np.repeat(first - (np.cumsum(count) - count), count) + np.arange(count.sum())
    saved = cluster_costs(views, view, hierarchy.start[cluster], hierarchy.stop[cluster]) - cost
    return view[saved > 0], saved[saved > 0]


def _candidates(found: list[tuple]) -> Candidates:
    """Return rows of (base, cluster, kind, view cell, bytes, layers, cost, view, saved) as candidates."""
    found = sorted(found, key=lambda row: (row[1], row[0] < 0))
    column = lambda k, dtype: np.array([row[k] for row in found], dtype=dtype)  # noqa: E731
    return Candidates(
        cluster=column(1, np.int32), kind=column(2, np.uint8), view_cell=column(3, np.float64).reshape(-1, 9),
        bytes=column(4, np.int64), layers=column(5, np.int32), cost=column(6, np.int64),
        row=np.cumsum([0, *(len(row[7]) for row in found)], dtype=np.int64),
        view=np.concatenate([np.zeros(0, np.int32), *(row[7].astype(np.int32) for row in found)]),
        saved=np.concatenate([np.zeros(0, np.int64), *(row[8] for row in found)]), base=column(0, np.int32),
    )  # fmt: skip


def choose_from(
    candidates: Candidates, *, need: np.ndarray, end: np.ndarray, stop: Callable[[], bool] = lambda: False
) -> np.ndarray:
    """Return candidates (I,) i32, ascending, by which every view can save what it needs: all kept ones, and what the
    views that these leave above their target lack.

    need  (V,) i64 cost of each view minus its target
    end   (C,) i32, see `antichain.subtree_end`
    stop  asked now and then: True ends the search for few bytes
    """
    kept = np.flatnonzero(candidates.base >= 0).astype(np.int32)
    short = lacking(candidates, need=need, end=end)
    if not len(short):
        return kept
    mine = np.zeros(len(need), dtype=bool)
    mine[short] = True
    entry = mine[candidates.view]
    row = np.concatenate([[0], np.cumsum(entry)])[candidates.row].astype(np.int64)
    some = replace(
        candidates, row=row, view=(np.cumsum(mine) - 1).astype(np.int32)[candidates.view[entry]],
        saved=candidates.saved[entry], bytes=np.where(candidates.base >= 0, 1, candidates.bytes),
    )  # fmt: skip
    choice = choose(some, excess=need[short], end=end, stop=stop)
    return rescue(candidates, np.union1d(kept, choice.chosen).astype(np.int32), need=need, end=end, stop=stop)


def lacking(candidates: Candidates, *, need: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the views (K,) i64, ascending, that the kept ones of the candidates cannot save what they need."""
    kept = np.flatnonzero(candidates.base >= 0).astype(np.int32)
    everywhere = np.ones(len(need), dtype=bool)
    row, id, saved = offers_of(kept, candidates.row, candidates.view, candidates.saved, everywhere)
    reached = best_in_views(row, id, saved, candidates.cluster[kept], end, np.empty(len(id), dtype=bool))
    return np.flatnonzero(need > reached)


def with_fresh(kept: Candidates, fresh: Candidates) -> Candidates:
    """Return both, sorted by cluster; of one cluster, those kept first."""
    join = lambda name: np.concatenate([getattr(kept, name), getattr(fresh, name)])  # noqa: E731
    names = ("cluster", "kind", "view_cell", "bytes", "layers", "cost", "view", "saved")
    both = Candidates(
        **{name: join(name) for name in names}, row=np.concatenate([kept.row, fresh.row[1:] + kept.row[-1]]),
        base=np.concatenate([kept.base, np.full(len(fresh.cluster), -1, np.int32)]),
    )  # fmt: skip
    return take(both, np.argsort(both.cluster, kind="stable"))
