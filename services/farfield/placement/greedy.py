"""Choose which impostor candidates to build: lazy greedy, least memory that meets the budget in every view.

Problem  Candidate i weighs bytes[i] and saves saved[i, v] in the problem views it serves; of nested clusters only one
         is shown. View v costs more than its target. Find a light set under which no view does.
Method   `prospects` finds what is out of reach and sets the targets; `choose` runs the lazy greedy; `rescue` adds what
         views need that the greedy stranded; `prune` deletes in reverse; `tighten` fits view cells to where they are
         needed, and once more `prune`, because tightened impostors cost less; `assign` says what each view shows;
         `evaluate` adds everything up from scratch, and must agree. Integers throughout, ties by id.
After    Jeschke, Wimmer, Schumann, Purgathofer. Automatic Impostor Placement for Guaranteed Frame Rates and Low Memory
         Requirements. I3D 2005, sections 5.1 to 5.5. All around the greedy loop is ours.
"""

from functools import partial

import numpy as np

from farfield.candidates.model import Candidates
from farfield.errors import StageFailed
from farfield.geometry.cells import CellTree
from farfield.hierarchy.model import Hierarchy
from farfield.placement.antichain import Offers, offers_of, subtree_end
from farfield.placement.assign import fastest, least
from farfield.placement.choose import Progress, choose
from farfield.placement.evaluate import evaluate
from farfield.placement.model import Placement
from farfield.placement.prospects import find_prospects
from farfield.placement.prune import keep, prune
from farfield.placement.rescue import rescue
from farfield.placement.tighten import Impostors, Refit, tighten
from farfield.rendertime.model import CostModel
from farfield.scene.model import Scene
from farfield.settings import Settings
from farfield.stages import Stage
from farfield.viewspace.model import ProblemViews


def place(
    scene: Scene | None, hierarchy: Hierarchy, model: CostModel, cells: CellTree, views: ProblemViews,
    candidates: Candidates, *, settings: Settings, refit: Refit | None = None, progress: Progress | None = None,
) -> Placement:  # fmt: skip
    """Return the chosen impostors and what each problem view shows. Raises StageFailed if its own proof fails.

    candidates  read only (memory maps will do); sorted by cluster, bytes > 0, saved > 0, views ascending in a row
    refit       fits a view cell to given cells, see `tighten.Refit`; None: the candidates' own
    progress    called with a share in [0, 1] and counters, at most a few times a second
    """
    _check(hierarchy, views, candidates)
    if not len(views.cell):
        return _nothing_to_place(model, views)
    tell = progress or (lambda share, counters: None)
    end = subtree_end(hierarchy.start, hierarchy.stop)
    prospects = find_prospects(hierarchy, model, views, candidates, end=end)
    need = views.cost - prospects.target
    tell(0.1, {"hopeless": int(prospects.hopeless.sum())})

    choice = choose(
        candidates, excess=np.maximum(need, 0), end=end,
        progress=lambda share, counters: tell(0.1 + 0.6 * share, counters),
    )  # fmt: skip
    chosen = rescue(candidates, choice.chosen, need=need, end=end)
    tell(0.75, {"choices": len(choice.step), "impostors": len(chosen)})

    impostors, offers = _gather(candidates, chosen, len(need))
    impostors, offers = _pruned(impostors, offers, need=need, end=end)
    tell(0.85, {"impostors": len(impostors.cluster), "bytes": int(impostors.bytes.sum())})
    impostors, offers = tighten(
        impostors, offers, needed=least(offers, cluster=impostors.cluster, end=end, need=need), view_cell=views.cell,
        hierarchy=hierarchy, cells=cells, refit=refit or _candidates_refit(model, settings),
    )  # fmt: skip
    impostors, offers = _pruned(impostors, offers, need=need, end=end)
    impostors, offers = _ordered(impostors, offers)
    if settings.placement.assignment == "least":
        shown = least(offers, cluster=impostors.cluster, end=end, need=need)
    else:
        shown = fastest(offers, cluster=impostors.cluster, end=end)
    serve_row = np.concatenate([[0], np.cumsum(shown)])[offers.row].astype(np.int64)
    serve = offers.id[shown]
    view_cost = evaluate(
        hierarchy, views, cluster=impostors.cluster, cost=impostors.cost, serve_row=serve_row, serve=serve
    )
    summed = views.cost - np.diff(np.concatenate([[0], np.cumsum(offers.saved[shown])])[serve_row])
    if not np.array_equal(view_cost, summed):
        raise StageFailed(Stage.PLACEMENT, f"problem view {int(np.argmax(view_cost != summed))} adds up differently")
    if (view_cost > prospects.target).any():
        raise StageFailed(
            Stage.PLACEMENT, f"problem view {int(np.argmax(view_cost > prospects.target))} missed its target"
        )
    tell(1.0, {"impostors": len(impostors.cluster), "bytes": int(impostors.bytes.sum())})
    return Placement(
        cluster=impostors.cluster, kind=impostors.kind, view_cell=impostors.view_cell, bytes=impostors.bytes,
        layers=impostors.layers, cost=impostors.cost, serve_row=serve_row, serve=serve, view_cost=view_cost,
        view_target=prospects.target, view_best=prospects.best, hopeless=prospects.hopeless,
        culprit_row=prospects.culprit_row, culprit=prospects.culprit, smallest_budget=prospects.smallest_budget,
        step_view_cost=choice.step_over, step_bytes=choice.step_bytes,
    )  # fmt: skip


def _check(hierarchy: Hierarchy, views: ProblemViews, candidates: Candidates) -> None:
    assert len(candidates.row) == len(candidates.cluster) + 1 and candidates.row[-1] == len(candidates.view)
    assert (np.diff(candidates.cluster) >= 0).all(), "candidates must be sorted by cluster"
    assert (candidates.bytes > 0).all() and (candidates.cost >= 0).all()
    assert len(views.row) == len(views.cell) + 1 and len(hierarchy.start) == 2 * int(hierarchy.stop[0]) - 1


def _nothing_to_place(model: CostModel, views: ProblemViews) -> Placement:
    i64, i32, row = np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros(1, np.int64)
    return Placement(
        cluster=i32, kind=np.zeros(0, np.uint8), view_cell=np.zeros((0, 9)), bytes=i64, layers=i32, cost=i64,
        serve_row=row, serve=i32, view_cost=i64, view_target=i64, view_best=i64, hopeless=np.zeros(0, bool),
        culprit_row=row, culprit=i32, smallest_budget=model.per_frame + int(views.worst_nonproblem),
        step_view_cost=i64, step_bytes=i64,
    )  # fmt: skip


def _candidates_refit(model: CostModel, settings: Settings) -> Refit:
    from farfield.candidates.generate import refit

    return partial(refit, model=model, settings=settings)


def _gather(candidates: Candidates, chosen: np.ndarray, n_views: int) -> tuple[Impostors, Offers]:
    row, id, saved = offers_of(
        chosen, candidates.row, candidates.view, candidates.saved, np.ones(n_views, dtype=bool)
    )  # fmt: skip
    impostors = Impostors(
        cluster=candidates.cluster[chosen], kind=candidates.kind[chosen], view_cell=candidates.view_cell[chosen],
        bytes=candidates.bytes[chosen], layers=candidates.layers[chosen], cost=candidates.cost[chosen],
    )  # fmt: skip
    return impostors, Offers(row=row, id=id, saved=saved)


def _pruned(impostors: Impostors, offers: Offers, *, need: np.ndarray, end: np.ndarray) -> tuple[Impostors, Offers]:
    stay = prune(offers, cluster=impostors.cluster, bytes=impostors.bytes, need=need, end=end)
    return impostors.take(stay), keep(offers, stay)


def _ordered(impostors: Impostors, offers: Offers) -> tuple[Impostors, Offers]:
    """Number the impostors by (cluster, kind, view cell), and sort each view's offers by that number."""
    keys = [*impostors.view_cell.T[::-1], impostors.kind, impostors.cluster]
    order = np.lexsort(keys)
    number = np.empty(len(order), np.int32)
    number[order] = np.arange(len(order), dtype=np.int32)
    id = number[offers.id]
    view = np.repeat(np.arange(len(offers.row) - 1), np.diff(offers.row))
    at = np.lexsort([id, view])
    return impostors.take(order), Offers(row=offers.row, id=id[at], saved=offers.saved[at])
