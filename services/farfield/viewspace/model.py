"""The output of stage 6."""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class ProblemViews:
    """V problem views: a leaf cell and a smallest direction interval whose enclosing frustum costs more than the target.

    Sorted by (cell, interval). Costs leave the per-frame cost out: a view is a problem because cost > model.target.
    What an object costs depends on the cell alone, so each cell has a list of objects with running costs (cells with
    equal lists share one), and a view is a set of runs in it: ids are in Morton order, so that neighbours in space are
    mostly neighbours in the list, and a run is about forty objects. Read through `farfield.viewspace.cost`: the cost of
    a cluster [a, b) in a view is two binary searches, `view_objects` lists a view's objects.
    """

    cell: np.ndarray  # (V,) i32  leaf of the CellTree
    interval: np.ndarray  # (V,) i32  see farfield.geometry.intervals
    cost: np.ndarray  # (V,) i64  bound, of everything in the enclosing frustum
    row: np.ndarray  # (V+1,) i64  view v is runs [row[v], row[v+1])
    run: np.ndarray  # (R,2) i32  positions [first, stop) in the list of the view's cell, ascending, apart
    before: np.ndarray  # (R,) i64  cost of the earlier runs of the view
    list: np.ndarray  # (V,) i32  the list of the view's cell
    list_row: np.ndarray  # (K+1,) i64
    list_object: np.ndarray  # (D,) i32  ascending within a list
    list_through: np.ndarray  # (D,) i64  cost of the list's objects up to and with this one
    cell_cost: np.ndarray  # (L,) i64  worst bound over the intervals of each leaf cell that were looked at (the map)
    worst_nonproblem: int  # largest bound of a leaf interval or pruned node that is within the target


def take(views: ProblemViews, which: np.ndarray) -> ProblemViews:
    """Return the views of these ids (M,), ascending; id k of the result is which[k]. Lists stay as they are."""
    first, count = views.row[which], np.diff(views.row)[which]
    row = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    at = np.repeat(first - row[:-1], count) + np.arange(row[-1])
    return replace(
        views, cell=views.cell[which], interval=views.interval[which], cost=views.cost[which], row=row, run=views.run[at],
        before=views.before[at], list=views.list[which],
    )  # fmt: skip
