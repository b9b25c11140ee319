"""What each problem view could reach at best, hence which are hopeless, whose fault that is, and what the targets are.

Problem  A budget may be out of reach in some views whatever is chosen. Chasing it there would eat the memory (in a
         prototype 2.7 % hopeless views took 30 % of all bytes).
Method   The best antichain over all candidates bounds every combination of them from below. Views above the budget even
         so are hopeless, and the objects that stay geometry there are to blame. `near_best`: their target is a little
         above their best, as if that were their budget. `geometry`: their target is what they cost, so that nothing is
         spent on them; what others need is shown there too, for nothing.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from farfield.candidates.model import Candidates
from farfield.hierarchy.model import Hierarchy
from farfield.placement.antichain import best_in_views, cheapest_offers
from farfield.rendertime.model import CostModel
from farfield.settings import PlacementSettings
from farfield.viewspace.cost import view_objects
from farfield.viewspace.model import ProblemViews

CULPRITS = 16


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
    hierarchy: Hierarchy, model: CostModel, views: ProblemViews, candidates: Candidates, *, end: np.ndarray,
    policy: PlacementSettings | None = None,
) -> Prospects:  # fmt: skip
    """Return the best that candidates allow in each view, the targets, and the smallest budget that all views can meet.

    end     (C,) i32, see `antichain.subtree_end`
    policy  what hopeless views get; None: the default
    smallest_budget  with these candidates; least where something is hopeless. Where nothing is, views that are no
                     problem today, of which nobody knows what impostors could do, bound it from above.
    """
    row, id, saved = cheapest_offers(
        candidates.cluster, candidates.row, candidates.view, candidates.saved, len(views.cell)
    )
    take = np.empty(len(id), dtype=bool)
    best = views.cost - best_in_views(row, id, saved, candidates.cluster, end, take)
    hopeless = best > model.target
    target = targets(views.cost, best, model.target, policy or PlacementSettings())
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


def best_costs(candidates: Candidates, cost: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the least that each view (V,) i64 can cost with these candidates; cost (V,) i64 is that of its geometry."""
    row, id, saved = cheapest_offers(candidates.cluster, candidates.row, candidates.view, candidates.saved, len(cost))
    take = np.empty(len(id), dtype=bool)
    return cost - np.asarray(best_in_views(row, id, saved, candidates.cluster, end, take))


def targets(cost: np.ndarray, best: np.ndarray, target: int, policy: PlacementSettings) -> np.ndarray:
    """Return what each view is to cost at most (V,) i64: `target`, or where `best` is above it what the policy says."""
    out = np.full(len(best), target, dtype=np.int64)
    slack = Fraction(str(policy.hopeless_slack))
    for v in np.flatnonzero(best > target):
        near = -(-int(best[v]) * slack.numerator // slack.denominator)
        out[v] = cost[v] if policy.hopeless == "geometry" else min(int(cost[v]), near)
    return out


def _culprits(views: ProblemViews, v: int, hierarchy: Hierarchy, replaced: np.ndarray) -> np.ndarray:
    """Return up to CULPRITS objects of view v outside the clusters `replaced`, most expensive first, ties by id."""
    objects, cost = view_objects(views, v)
    kept = np.ones(len(objects), dtype=bool)
    for c in replaced:
        kept[np.searchsorted(objects, hierarchy.start[c]) : np.searchsorted(objects, hierarchy.stop[c])] = False
    objects, cost = objects[kept], cost[kept]
    return objects[np.argsort(-cost, kind="stable")[:CULPRITS]]
