"""Find the problem views: leaf cells and smallest direction intervals whose enclosing frusta cost more than the target.

Problem  A camera anywhere in the view space, looking anywhere, must not be shown more than the target. Which (cell,
         interval) pairs may break that, and with which objects? Miss none; name few too many.
Method   Down the view-space tree, then for each leaf cell the whole sphere, six faces, and a quadtree of intervals down
         to the smallest. A node whose enclosing frusta cost at most the target is done: everything below it costs less.
         Only the objects that a node accepts are looked at below it, and only those that some cell of it sees at all.
         What an object costs depends on the cell alone.
Errs     upwards: enclosing frusta accept a few objects that no view shows (farfield.geometry.frusta), and pixels are
         counted from the nearest point of the cell (farfield.rendertime.cost). No view costs more than its bound.
Shards   Subtrees of the view-space tree, cut by a rule that knows nothing of workers; cells are independent.
Tried    Not tried: accepting and rejecting whole clusters. Object by object, 4,735 objects, 540 cells and 41,550
         problem views with 76 M entries take 6 s on one thread.
After    Jeschke et al., Automatic Impostor Placement for Guaranteed Frame Rates, I3D 2005, section 3.
"""

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from farfield.geometry.camera import Camera
from farfield.geometry.cells import CellTree, build_cells, subtrees
from farfield.geometry.frusta import enclosing_frusta
from farfield.hierarchy.model import Hierarchy
from farfield.rendertime.cost import least_cost, object_cost
from farfield.rendertime.model import CostModel
from farfield.scene.model import Scene
from farfield.settings import Settings
from farfield.viewspace import kernels
from farfield.viewspace.cost import n_incidences
from farfield.viewspace.model import ProblemViews
from farfield.visibility.model import VisibleSets

SHARDS = 32  # about as many subtrees, unless that makes a shard smaller or larger than
CELLS_A_SHARD = (8, 64)  # ... these: starting one costs a second, and its entries should stay within some 100 MB


def plan_subtrees(cells: CellTree) -> list[int]:
    """Return the nodes whose subtrees are the shards, in preorder: together they hold every leaf cell once."""
    low, high = CELLS_A_SHARD
    return subtrees(cells, most=min(high, max(low, math.ceil(cells.n_cells / SHARDS))))


def find_problem_views(
    scene: Scene, hierarchy: Hierarchy, model: CostModel, visible: VisibleSets, *, settings: Settings, node: int
) -> ProblemViews:
    """Return the problem views of the leaf cells under `node` of the view-space tree.

    hierarchy  of the scene: its depth-first order is the order of object ids, so that entries of a cluster are a range
    node       a node of build_cells(scene.view_boxes, scene.cell_m); 0 is all of it
    `cell_cost` has a row for every leaf cell of the tree, 0 outside the node. `worst_nonproblem` and `cell_cost` hold
    bounds of the nodes where the descent stopped, so they depend on where it began, on `plan_subtrees`.
    """
    assert (hierarchy.start[0], hierarchy.stop[0]) == (0, scene.n_objects)
    cells = build_cells(scene.view_boxes, scene.cell_m)
    search = _Search(scene, model, visible, settings)
    cell_cost = np.zeros(cells.n_cells, dtype=np.int64)
    found: list[_CellViews] = []
    worst_nonproblem = 0
    least = least_cost(model)
    stack = [node]
    while stack:
        here = stack.pop()
        leaves = slice(cells.start[here], cells.stop[here])
        below = search.seen_below(leaves)
        # Pixels and finer levels only add to that, so where it is above the target already the sum is not worth it.
        whole = int(least[below].sum())
        if whole <= model.target:
            whole = int(object_cost(model, scene.object_box, cells.box[here], objects=below).sum())
        if whole <= model.target:
            cell_cost[leaves] = whole
            worst_nonproblem = max(worst_nonproblem, whole)
        elif cells.axis[here] >= 0:
            stack += [int(cells.high[here]), int(cells.low[here])]
        else:
            cell = int(cells.start[here])
            views, worst, within = search.cell(cell, cells.box[here])
            cell_cost[cell], worst_nonproblem = worst, max(worst_nonproblem, within)
            if views is not None:
                found.append(views)
    return _concatenate(found, cell_cost, worst_nonproblem)


def merge_problem_views(parts: list[ProblemViews]) -> ProblemViews:
    """Return the problem views of all shards, sorted by (cell, interval). `parts` in any order; at least one."""
    assert parts
    cells = [cell for part in parts for cell in _split_cells(part)]
    assert len({c.cell for c in cells}) == len(cells), "shards overlap"
    cell_cost = np.max([p.cell_cost for p in parts], axis=0)
    return _concatenate(cells, cell_cost, max(p.worst_nonproblem for p in parts))


def summary(views: ProblemViews) -> dict[str, int]:
    """Return what the report says of the problem views: counts, and costs in the model's unit."""
    return {
        "problem_views": len(views.cell),
        "problem_cells": len(np.unique(views.cell)),
        "cells": len(views.cell_cost),
        "visible_incidences": int(n_incidences(views).sum()),
        "most_objects_in_a_view": int(n_incidences(views).max(initial=0)),
        "worst_cost": int(views.cell_cost.max(initial=0)),
        "worst_nonproblem": int(views.worst_nonproblem),
    }


class _Search:
    """One shard's arrays, and its scratch space that grows to the largest cell."""

    def __init__(self, scene: Scene, model: CostModel, visible: VisibleSets, settings: Settings) -> None:
        camera = Camera(fov_deg=model.fov_deg, width=model.width, height=model.height)
        self.n = round(90 / settings.view_space.interval_deg)
        self.frusta = enclosing_frusta(self.n, camera)
        self.model, self.visible, self.boxes = model, visible, scene.object_box
        n_objects = scene.n_objects
        self.seen = np.empty((7, n_objects))
        self.lists = np.empty((self.n.bit_length() + 1, n_objects), dtype=np.int32)
        self.views = np.empty((6 * self.n * self.n, 4), dtype=np.int64)
        self.entries = np.empty(16 * n_objects, dtype=np.int32)
        self.everything = np.arange(n_objects, dtype=np.int32)

    def seen_below(self, leaves: slice) -> np.ndarray:
        """Return the objects (K,) i32 that some of the leaf cells see, ascending."""
        if self.visible.mode == "off":
            return self.everything
        of_cells = self.visible.object[self.visible.row[leaves.start] : self.visible.row[leaves.stop]]
        return of_cells if leaves.stop == leaves.start + 1 else np.unique(of_cells)

    def cell(self, cell: int, box: np.ndarray) -> tuple["_CellViews | None", int, int]:
        """Return the cell's problem views if any, the worst bound where the descent stopped, the worst within target."""
        # Only what the cell sees is looked at; places in that list stand for its objects.
        everything = self.visible.mode == "off"
        first = self.seen_below(slice(cell, cell + 1))
        cost = object_cost(self.model, self.boxes, box, objects=first)
        whole = int(cost.sum())
        if whole <= self.model.target:
            return None, whole, whole
        kernels.seen_from(self.boxes if everything else self.boxes[first], box, self.seen)
        while True:
            self.lists[0, : len(first)] = self.everything[: len(first)]
            n_views, n_entries, worst, within = kernels.descend(
                self.seen, cost, len(first), self.lists, self.frusta.normals, self.frusta.row, self.frusta.pad, self.n,
                self.model.target, self.views, self.entries,
            )  # fmt: skip
            if n_entries <= len(self.entries):
                return self._gather(cell, self.views[:n_views], first, cost), worst, within
            self.entries = np.empty(n_entries + n_entries // 4, dtype=np.int32)

    def _gather(self, cell: int, found: np.ndarray, first: np.ndarray, cost: np.ndarray) -> "_CellViews | None":
        if not len(found):
            return None
        found = found[np.argsort(found[:, 0], kind="stable")]
        n_runs = kernels.count_runs(found, self.entries)
        row = np.zeros(len(found) + 1, dtype=np.int64)
        run, before = np.empty((n_runs, 2), dtype=np.int32), np.empty(n_runs, dtype=np.int64)
        kernels.gather(found, self.entries, cost, row, run, before)
        return _CellViews(
            cell=cell, interval=found[:, 0].astype(np.int32), cost=found[:, 1].copy(), row=row, run=run, before=before,
            objects=np.ascontiguousarray(first, dtype=np.int32), through=np.cumsum(cost, dtype=np.int64),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class _CellViews:
    """The problem views of one cell, as columns of ProblemViews, and the list its runs are positions of."""

    cell: int
    interval: np.ndarray
    cost: np.ndarray
    row: np.ndarray
    run: np.ndarray
    before: np.ndarray
    objects: np.ndarray
    through: np.ndarray


def _split_cells(views: ProblemViews) -> list[_CellViews]:
    cells, first = np.unique(views.cell, return_index=True)
    found = []
    for cell, low, high in zip(cells.tolist(), first.tolist(), [*first.tolist()[1:], len(views.cell)], strict=False):
        begin, end = views.row[low], views.row[high]
        start, stop = views.list_row[views.list[low] : views.list[low] + 2]
        found.append(_CellViews(
            cell=cell, interval=views.interval[low:high], cost=views.cost[low:high], row=views.row[low : high + 1] - begin,
            run=views.run[begin:end], before=views.before[begin:end], objects=views.list_object[start:stop],
            through=views.list_through[start:stop],
        ))  # fmt: skip
    return found


def _concatenate(parts: list[_CellViews], cell_cost: np.ndarray, worst_nonproblem: int) -> ProblemViews:
    """Join the views of cells, put in order of the cells; equal lists are stored once."""
    parts = sorted(parts, key=lambda p: p.cell)
    ends = np.cumsum([0, *(len(p.run) for p in parts)])
    of_list: list[int] = []
    known: dict[bytes, int] = {}
    lists: list[_CellViews] = []
    for part in parts:
        digest = hashlib.sha256(part.objects.tobytes() + part.through.tobytes()).digest()
        if digest not in known:
            known[digest] = len(lists)
            lists.append(part)
        of_list += [known[digest]] * len(part.cost)

    def join(arrays: Iterable[np.ndarray], empty: np.ndarray) -> np.ndarray:
        return np.concatenate([empty, *arrays])

    none32, none64 = np.empty(0, dtype=np.int32), np.empty(0, dtype=np.int64)
    return ProblemViews(
        cell=join((np.full(len(p.cost), p.cell, dtype=np.int32) for p in parts), none32),
        interval=join((p.interval for p in parts), none32),
        cost=join((p.cost for p in parts), none64),
        row=join((p.row[1:] + first for p, first in zip(parts, ends, strict=False)), np.zeros(1, dtype=np.int64)),
        run=join((p.run for p in parts), np.empty((0, 2), dtype=np.int32)),
        before=join((p.before for p in parts), none64),
        list=np.array(of_list, dtype=np.int32),
        list_row=np.cumsum([0, *(len(p.objects) for p in lists)], dtype=np.int64),
        list_object=join((p.objects for p in lists), none32),
        list_through=join((p.through for p in lists), none64),
        cell_cost=cell_cost,
        worst_nonproblem=worst_nonproblem,
    )
