"""After the bake: measured bytes and costs replace the estimates, and every view is added up again.

Problem  The greedy saw upper bounds only, so measured impostors should be no heavier and no dearer. If one is dearer
         all the same, or was not baked, the views that show it may miss their targets.
Method   Measurements enter in id order, once. Views that meet their targets keep what they show; the others show the
         best antichain of what is valid there: the impostors that some view of the same cell shows. Nothing is chosen
         anew, since that would need another bake; what still fails makes the verdict `unproven`. A view that no
         combination of candidates could bring to the budget, but what was built does, is hopeless no longer.
"""

from dataclasses import replace
from typing import Literal

import numpy as np

from farfield.candidates.model import Candidates
from farfield.geometry.cells import CellTree
from farfield.hierarchy.model import Hierarchy
from farfield.placement.antichain import Offers, subtree_end
from farfield.placement.assign import fastest
from farfield.placement.evaluate import evaluate
from farfield.placement.model import Placement, fresh_of
from farfield.rendertime.model import CostModel
from farfield.viewspace.cost import cluster_costs
from farfield.viewspace.model import ProblemViews


def repair(
    placement: Placement, hierarchy: Hierarchy, model: CostModel, cells: CellTree, views: ProblemViews,
    candidates: Candidates, *, measured_bytes: np.ndarray, measured_cost: np.ndarray, layers: np.ndarray,
) -> Placement:  # fmt: skip
    """Return the placement with measured figures, each view evaluated from scratch on them.

    measured_bytes, measured_cost, layers  (F,) i64, i64, i32, of the impostors that no base has baked. One that could not
                                           be is given a cost that nothing exceeds, such as 2**40, and so is shown
                                           nowhere new.
    """
    bytes, cost = np.asarray(measured_bytes, np.int64), np.asarray(measured_cost, np.int64)
    if len(placement.base):  # those of the base were measured then
        fresh = fresh_of(placement)
        bytes, cost, layers = (
            _put(old, fresh, new)
            for old, new in ((placement.bytes, bytes), (placement.cost, cost), (placement.layers, layers))
        )
    assert bytes.shape == cost.shape == placement.cluster.shape == np.shape(layers)

    def costs(row: np.ndarray, serve: np.ndarray) -> np.ndarray:
        return evaluate(hierarchy, views, cluster=placement.cluster, cost=cost, serve_row=row, serve=serve)

    row, serve = placement.serve_row, placement.serve
    view_cost = costs(row, serve)
    missed = view_cost > placement.view_target
    if missed.any():
        offers = offers_in_cell(placement, hierarchy, views, cost, missed)
        shown = fastest(offers, cluster=placement.cluster, end=subtree_end(hierarchy.start, hierarchy.stop))
        row, serve = _with_rows(row, serve, offers, shown, missed)
        view_cost = costs(row, serve)
    mended = replace(
        placement, bytes=bytes, cost=cost, layers=np.asarray(layers, np.int32), serve_row=row, serve=serve,
        view_cost=view_cost,
    )  # fmt: skip
    return _without_false_despair(mended, model, views)


def _put(column: np.ndarray, at: np.ndarray, values: np.ndarray) -> np.ndarray:
    out = column.copy()
    out[at] = values
    return out


def _without_false_despair(placement: Placement, model: CostModel, views: ProblemViews) -> Placement:
    """Return the placement without hopeless views that meet the budget: what was built can cost less than candidates."""
    hopeless = placement.hopeless & (placement.view_cost > model.target)
    kept = hopeless[placement.hopeless]
    counts = np.diff(placement.culprit_row)
    smallest = placement.smallest_budget
    if not hopeless.any():  # then what is shown now proves a budget
        worst = max(int(placement.view_cost.max(initial=0)), int(views.worst_nonproblem))
        smallest = min(smallest, model.per_frame + worst)
    return replace(
        placement, hopeless=hopeless, view_best=np.minimum(placement.view_best, placement.view_cost),
        view_target=np.where(hopeless, placement.view_target, model.target),
        culprit_row=np.concatenate([[0], np.cumsum(counts[kept])]).astype(np.int64),
        culprit=placement.culprit[np.repeat(kept, counts)], smallest_budget=smallest,
    )  # fmt: skip


def verdict(placement: Placement, model: CostModel) -> Literal["valid", "infeasible", "unproven"]:
    """Return what the figures prove: every view within budget; all but hopeless ones; or neither."""
    over = placement.view_cost > model.target
    if (over & ~placement.hopeless).any():
        return "unproven"
    return "infeasible" if placement.hopeless.any() else "valid"


def offers_in_cell(
    placement: Placement, hierarchy: Hierarchy, views: ProblemViews, cost: np.ndarray, wanted: np.ndarray
) -> Offers:
    """Return what wanted (V,) b1 views are offered by the impostors that are shown anywhere in their cells."""
    view_of = np.repeat(np.arange(len(wanted)), np.diff(placement.serve_row))
    pairs = np.unique(np.stack([views.cell[view_of].astype(np.int64), placement.serve.astype(np.int64)], -1), axis=0)
    row, ids, saved = [0], [np.zeros(0, np.int32)], [np.zeros(0, np.int64)]
    for v in range(len(wanted)):
        if wanted[v]:
            first, last = np.searchsorted(pairs[:, 0], [views.cell[v], views.cell[v] + 1])
            id = pairs[first:last, 1].astype(np.int32)
            start, stop = hierarchy.start[placement.cluster[id]], hierarchy.stop[placement.cluster[id]]
            gain = cluster_costs(views, np.array(v), start, stop) - cost[id]
            ids.append(id[gain > 0])
            saved.append(gain[gain > 0])
        row.append(row[-1] + (len(ids[-1]) if wanted[v] else 0))
    return Offers(row=np.array(row, np.int64), id=np.concatenate(ids), saved=np.concatenate(saved))


def _with_rows(
    row: np.ndarray, serve: np.ndarray, offers: Offers, shown: np.ndarray, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return what views show, with the rows of wanted (V,) b1 views taken from the offers shown (S,) b1."""
    parts = [
        offers.id[offers.row[v] : offers.row[v + 1]][shown[offers.row[v] : offers.row[v + 1]]]
        if wanted[v]
        else serve[row[v] : row[v + 1]]
        for v in range(len(wanted))
    ]
    return np.cumsum([0, *map(len, parts)], dtype=np.int64), np.concatenate(parts).astype(np.int32)
