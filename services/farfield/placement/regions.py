"""Optimise parts of the view space apart, for levels that are too large for one optimiser.

Problem  The greedy does not shard: each choice changes what all others gain. Past some size one worker takes too long.
Method   Cut the view space into subtrees of its kd-tree with about equally many problem views. In each, the greedy and
         the rescue choose among all candidates, as if there were no other views: pure functions, run in parallel.
         `greedy.place` then chooses among what any region chose (those it displaced again included): few candidates, by
         which every view can meet its target, because the targets are the same.
Errs     Towards more bytes: a region weighs an impostor's bytes against its own views only, so that it prefers smaller
         view cells than a level at once would. docs/decisions/0011-regions-and-the-papers-way.md says how much.
"""

from collections.abc import Callable

import numpy as np
from numba import njit

from farfield.candidates.alone import Alone
from farfield.candidates.model import Candidates
from farfield.geometry.cells import CellTree
from farfield.hierarchy.model import Hierarchy
from farfield.placement.antichain import subtree_end
from farfield.placement.checkpoint import Checkpoint
from farfield.placement.choose import Progress, choose
from farfield.placement.complete import complete
from farfield.placement.limit import Limit
from farfield.placement.model import RegionChoice
from farfield.placement.prospects import best_costs, targets
from farfield.placement.rescue import rescue
from farfield.rendertime.model import CostModel
from farfield.settings import Settings
from farfield.viewspace.model import ProblemViews


def plan_regions(cells: CellTree, views: ProblemViews, n: int) -> list[tuple[int, int]]:
    """Return at most n ranges [a, b) of leaf cells, ascending: the subtrees that hold all problem views, cut evenly."""
    before = np.searchsorted(views.cell, np.arange(cells.n_cells + 1))
    held: Callable[[int], int] = lambda node: int(before[cells.stop[node]] - before[cells.start[node]])  # noqa: E731
    nodes = [0]
    while len(nodes) < n:
        inner = [node for node in nodes if cells.low[node] >= 0]
        if not inner:
            break
        fullest = max(inner, key=lambda node: (held(node), -node))
        nodes.remove(fullest)
        nodes += [int(child) for child in (cells.low[fullest], cells.high[fullest]) if held(int(child))]
    return sorted((int(cells.start[node]), int(cells.stop[node])) for node in nodes if held(node))


def choose_in_region(
    hierarchy: Hierarchy, model: CostModel, views: ProblemViews, candidates: Candidates, *, settings: Settings,
    region: tuple[int, int], alone: Alone | None, checkpoint: Checkpoint | None = None, progress: Progress | None = None,
) -> RegionChoice:  # fmt: skip
    """Return what the problem views of the cells [a, b) = region need, chosen as if there were no others.

    candidates  all of them; read only (memory maps will do)
    progress    as in `choose`
    alone       as in `greedy.place`: every region completes the candidates alike, so that ids mean the same
    """
    policy, limit = settings.placement, Limit(settings.placement.time_limit_s)
    end = subtree_end(hierarchy.start, hierarchy.stop)
    if alone is not None:
        candidates = complete(candidates, views, target=model.target, end=end, alone=alone)
    first, last = (int(v) for v in np.searchsorted(views.cell, region))
    some, which = within(candidates, first, last)
    cost = views.cost[first:last]
    need = cost - targets(cost, best_costs(some, cost, end), model.target, policy)
    choice = choose(
        some, excess=np.maximum(need, 0), end=end, everywhere=policy.assignment == "all", stop=limit.over,
        checkpoint=checkpoint, progress=progress,
    )  # fmt: skip
    chosen = rescue(some, choice.chosen, need=need, end=end, stop=limit.over)
    return RegionChoice(candidate=which[np.union1d(choice.step, chosen)], stopped=limit.stopped)


def within(candidates: Candidates, first: int, last: int) -> tuple[Candidates, np.ndarray]:
    """Return the candidates that serve problem views [first, last), those views being 0, 1, ..., and their ids (M,) i32."""
    low, high = _spans(candidates.row, candidates.view, first, last)
    which = np.flatnonzero(low < high).astype(np.int32)
    count = (high - low)[which]
    row = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    at = np.repeat(low[which] - row[:-1], count) + np.arange(row[-1])
    some = Candidates(
        cluster=candidates.cluster[which], kind=candidates.kind[which], view_cell=candidates.view_cell[which],
        bytes=candidates.bytes[which], layers=candidates.layers[which], cost=candidates.cost[which], row=row,
        view=candidates.view[at] - np.int32(first), saved=candidates.saved[at],
    )  # fmt: skip
    return some, which


@njit(cache=True)
def _spans(row: np.ndarray, view: np.ndarray, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (low, high) (N,) i64: the entries of each row with a view in [first, last)."""
    n = len(row) - 1
    low, high = np.empty(n, np.int64), np.empty(n, np.int64)
    for i in range(n):
        of = view[row[i] : row[i + 1]]
        low[i] = row[i] + np.searchsorted(of, first)
        high[i] = row[i] + np.searchsorted(of, last)
    return low, high
