"""What each problem view could reach at best, hence which are hopeless, whose fault that is, and what the targets are.

Problem  A budget may be out of reach in some views whatever is chosen. Chasing it there would eat the memory (in a
         prototype 2.7 % hopeless views took 30 % of all bytes).
Method   The best antichain over all candidates bounds every combination of them from below. Views above the budget even
         so are hopeless; their target is 1.05 of their best, and the objects that stay geometry there are to blame.
"""

from dataclasses import dataclass

import numpy as np

from farfield.candidates.model import Candidates
from farfield.hierarchy.model import Hierarchy
from farfield.placement.antichain import best_in_views, cheapest_offers
from farfield.rendertime.model import CostModel
from farfield.viewspace.cost import view_objects
from farfield.viewspace.model import ProblemViews

CULPRITS = 16
SLACK_PERCENT = 105  # target of a hopeless view, in percent of its best


@dataclass(frozen=True, slots=True, kw_only=True)
class Prospects:
    """Columns as in Placement."""

    best: np.ndarray  # (V,) i64
    hopeless: np.ndarray  # (V,) b1
    target: np.ndarray  # (V,) i64
    culprit_row: np.ndarray  # (H+1,) i64
    culprit: np.ndarray  # (U,) i32
    smallest_budget: int


def find_prospects(
    hierarchy: Hierarchy, model: CostModel, views: ProblemViews, candidates: Candidates, *, end: np.ndarray
) -> Prospects:
    """Return the best that candidates allow in each view, the targets, and the smallest budget that all views can meet.

    end  (C,) i32, see `antichain.subtree_end`
    smallest_budget is proven for these candidates: where nothing is hopeless, views that are no problem today bound it.
    """
    row, id, saved = cheapest_offers(
        candidates.cluster, candidates.row, candidates.view, candidates.saved, len(views.cell)
    )
    take = np.empty(len(id), dtype=bool)
    best = views.cost - best_in_views(row, id, saved, candidates.cluster, end, take)
    hopeless = best > model.target
    target = np.where(hopeless, (best * SLACK_PERCENT + 99) // 100, model.target)
    culprits = [
        _culprits(views, int(v), hierarchy, candidates.cluster[id[row[v] : row[v + 1]][take[row[v] : row[v + 1]]]])
        for v in np.flatnonzero(hopeless)
    ]
    return Prospects(
        best=best, hopeless=hopeless, target=target,
        culprit_row=np.cumsum([0, *map(len, culprits)], dtype=np.int64),
        culprit=np.concatenate([np.zeros(0, np.int32), *culprits]).astype(np.int32),
        smallest_budget=model.per_frame + max(int(best.max(initial=0)), int(views.worst_nonproblem)),
    )  # fmt: skip


def _culprits(views: ProblemViews, v: int, hierarchy: Hierarchy, replaced: np.ndarray) -> np.ndarray:
    """Return up to CULPRITS objects of view v outside the clusters `replaced`, most expensive first, ties by id."""
    objects, cost = view_objects(views, v)
    kept = np.ones(len(objects), dtype=bool)
    for c in replaced:
        kept[np.searchsorted(objects, hierarchy.start[c]) : np.searchsorted(objects, hierarchy.stop[c])] = False
    objects, cost = objects[kept], cost[kept]
    return objects[np.argsort(-cost, kind="stable")[:CULPRITS]]
