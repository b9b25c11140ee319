"""Candidates for one cell alone: the cheapest way to see a cluster from there.

Problem  `generate` keeps few sets of cells for each cluster. Whether a view is beyond help must not depend on which.
Method   Every cluster that costs more than the cheapest impostor in some problem view of the cell is fitted to that cell
         and nothing else, as `generate` fits. A view cell around more cells needs no fewer layers: it is the cheapest
         candidate for the cell, up to layouts that trade a texel for a triangle.
"""

from collections.abc import Callable

import numpy as np

from farfield.candidates.generate import cheapest_cost, refit
from farfield.candidates.model import Candidates
from farfield.candidates.pair_kernels import list_pairs
from farfield.geometry.cells import CellTree
from farfield.hierarchy.model import Hierarchy
from farfield.rendertime.model import CostModel
from farfield.settings import Settings
from farfield.viewspace.cost import runs_of
from farfield.viewspace.model import ProblemViews

Alone = Callable[[int], Candidates]
"""leaf cell -> the candidates for it alone; views are numbered as in ProblemViews"""


def candidates_for(
    cell: int, *, hierarchy: Hierarchy, model: CostModel, cells: CellTree, views: ProblemViews, settings: Settings
) -> Candidates:
    """Return a candidate for each replaceable cluster that gains by it in a problem view of the leaf cell."""
    first, last = (int(v) for v in np.searchsorted(views.cell, [cell, cell + 1]))
    runs = runs_of(views)
    of_cell = runs._replace(
        cost=runs.cost[first:last], row=runs.row[first : last + 1], list=runs.list[first:last]
    )  # fmt: skip
    n = len(hierarchy.start)
    tree = hierarchy.start, hierarchy.stop, hierarchy.left, hierarchy.right
    given, floor, count = (0, n), cheapest_cost(model), np.zeros(n, np.int64)
    none = np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros(0, np.int64)
    list_pairs(of_cell, *tree, given, floor, count, *none)
    row = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    view, cost = np.empty(row[-1], np.int32), np.empty(row[-1], np.int64)
    if row[-1]:
        list_pairs(of_cell, *tree, given, floor, np.empty(n, np.int64), row, view, cost)
    box = cells.cell_box[[cell]]
    rows: list[tuple[int, int, np.ndarray, int, int, int, np.ndarray, np.ndarray]] = []
    for c in np.flatnonzero((count > 0) & hierarchy.replaceable):
        kind, view_cell, size, layers, price = refit(hierarchy.box[c], box, model=model, settings=settings)
        of = slice(row[c], row[c + 1])
        helped = cost[of] > price
        if helped.any():
            rows.append(
                (
                    int(c),
                    kind,
                    view_cell,
                    size,
                    layers,
                    price,
                    view[of][helped] + np.int32(first),
                    cost[of][helped] - price,
                )
            )
    column = lambda k, dtype: np.array([r[k] for r in rows], dtype=dtype)  # noqa: E731
    return Candidates(
        cluster=column(0, np.int32), kind=column(1, np.uint8), view_cell=column(2, np.float64).reshape(-1, 9),
        bytes=column(3, np.int64), layers=column(4, np.int32), cost=column(5, np.int64),
        row=np.cumsum([0, *(len(r[6]) for r in rows)], dtype=np.int64),
        view=np.concatenate([np.zeros(0, np.int32), *(r[6] for r in rows)]),
        saved=np.concatenate([np.zeros(0, np.int64), *(r[7] for r in rows)]),
    )  # fmt: skip
