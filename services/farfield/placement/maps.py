"""Place environment maps: every cell with a problem view gets the whole map around it.

Problem  The evaluation's baseline spends memory everywhere alike: nothing is chosen, yet every view must be added up and
         judged as any placement is.
Method   All candidates are taken; each view shows those of its cell that cost less than what they replace. A view that
         costs more than the budget even so is hopeless: by maps of this distance it cannot be helped.
"""

import numpy as np

from farfield.candidates.model import Candidates
from farfield.errors import StageFailed
from farfield.hierarchy.model import Hierarchy
from farfield.placement.antichain import subtree_end
from farfield.placement.assign import fastest
from farfield.placement.curve import gather
from farfield.placement.evaluate import evaluate
from farfield.placement.model import Placement
from farfield.placement.prospects import find_prospects
from farfield.rendertime.model import CostModel
from farfield.settings import Settings
from farfield.stages import Stage
from farfield.viewspace.model import ProblemViews


def place_maps(
    hierarchy: Hierarchy, model: CostModel, views: ProblemViews, candidates: Candidates, *, settings: Settings
) -> Placement:
    """Return the placement of all candidates, one per cluster and cell. Raises StageFailed if it does not add up.

    candidates  of `farfield.candidates.environment`, sorted by (cluster, kind, view cell)
    """
    end = subtree_end(hierarchy.start, hierarchy.stop)
    prospects = find_prospects(hierarchy, model, views, candidates, end=end, policy=settings.placement)
    everything = np.arange(len(candidates.cluster), dtype=np.int32)
    impostors, offers = gather(candidates, everything, len(views.cell))
    shown = fastest(offers, cluster=impostors.cluster, end=end)
    assert shown.all(), "the parts of a map are disjoint, and all of them save something"
    view_cost = evaluate(
        hierarchy, views, cluster=impostors.cluster, cost=impostors.cost, serve_row=offers.row, serve=offers.id
    )
    if not np.array_equal(view_cost, prospects.best):
        raise StageFailed(
            Stage.PLACEMENT, f"problem view {int(np.argmax(view_cost != prospects.best))} adds up differently"
        )
    worst = int(views.cost.max(initial=0)) + model.per_frame
    over, size = int((view_cost > model.target).sum()), int(impostors.bytes.sum())
    points = [(model.budget, size, over), *([(worst, 0, 0)] if worst > model.budget else [])]
    budgets, sizes, overs = (np.array(c, np.int64) for c in zip(*points, strict=True))
    return Placement(
        cluster=impostors.cluster, kind=impostors.kind, view_cell=impostors.view_cell, bytes=impostors.bytes,
        layers=impostors.layers, cost=impostors.cost, serve_row=offers.row, serve=offers.id.astype(np.int32),
        view_cost=view_cost, view_target=prospects.target, view_best=prospects.best, hopeless=prospects.hopeless,
        culprit_row=prospects.culprit_row, culprit=prospects.culprit, smallest_budget=prospects.smallest_budget,
        curve_budget=budgets, curve_bytes=sizes, curve_over=overs, stopped=False,
    )  # fmt: skip
