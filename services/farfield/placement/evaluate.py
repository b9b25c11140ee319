"""Evaluate a placement from scratch: what each problem view costs with the impostors it shows.

Problem  Everything before keeps running sums. Before a placement is handed on, one function that shares none of that
         code adds up each view again, from the objects it may show and the impostors that replace them.
Method   For each view, the cost of every object outside the shown clusters plus the cost of each impostor shown.
         Overlapping clusters are refused: they would draw an object twice.
"""

import numpy as np

from farfield.errors import StageFailed
from farfield.hierarchy.model import Hierarchy
from farfield.stages import Stage
from farfield.viewspace.cost import view_objects
from farfield.viewspace.model import ProblemViews


def evaluate(
    hierarchy: Hierarchy, views: ProblemViews, *, cluster: np.ndarray, cost: np.ndarray, serve_row: np.ndarray,
    serve: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return what each problem view costs (V,) i64 with the impostors it shows. StageFailed where clusters overlap.

    cluster, cost     (I,) i32, i64 of the impostors
    serve_row, serve  (V+1,) i64, (S,) i32: as in Placement
    """
    total = np.zeros(len(views.cell), dtype=np.int64)
    for v in range(len(views.cell)):
        objects, costs = view_objects(views, v)
        until = np.concatenate([[0], np.cumsum(costs)])  # cost of the objects before each, then of all
        shown = serve[serve_row[v] : serve_row[v + 1]]
        shown = shown[np.argsort(hierarchy.start[cluster[shown]], kind="stable")]
        start, stop = hierarchy.start[cluster[shown]], hierarchy.stop[cluster[shown]]
        if (start[1:] < stop[:-1]).any():
            raise StageFailed(Stage.PLACEMENT, f"problem view {v} shows two impostors of one object")
        replaced = until[np.searchsorted(objects, stop)] - until[np.searchsorted(objects, start)]
        total[v] = until[-1] - replaced.sum() + cost[shown].sum()
    return total
