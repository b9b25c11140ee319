"""The output of stage 5."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class ProblemViews:
    """V problem views: leaf cell and smallest direction interval whose enclosing frustum costs more than the target.

    Sorted by (cell, interval). Costs leave the per-frame cost out: a view is a problem because cost > model.target.
    Entries of view v are [row[v], row[v+1]): the objects that its enclosing frustum may show, ascending; `before` is
    the cost of the entries before this one in the same view, so the cost of a cluster [a, b) is two binary searches
    (see `farfield.viewspace.cost.cluster_cost`).
    """

    cell: np.ndarray  # (V,) i32  leaf of the CellTree
    interval: np.ndarray  # (V,) i32  see farfield.geometry.intervals
    cost: np.ndarray  # (V,) i64  bound, of everything in the enclosing frustum
    row: np.ndarray  # (V+1,) i64
    object: np.ndarray  # (E,) i32
    before: np.ndarray  # (E,) i64
    cell_cost: np.ndarray  # (L,) i64  worst bound over the intervals of each leaf cell that were looked at (the map)
    worst_nonproblem: int  # largest bound of a leaf interval or pruned node that is within the target
