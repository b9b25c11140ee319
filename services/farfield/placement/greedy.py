"""Choose which impostor candidates to build: lazy greedy, least memory that meets the budget in every view.

Problem  Candidate i weighs bytes[i] and saves saved[i, v] in the problem views it serves; of nested clusters only one
         is shown. View v costs more than its target. Find a light set under which no view does.
Method   `prospects` finds what is out of reach and sets the targets; `choose` runs the lazy greedy; `rescue` adds what
         views need that the greedy stranded; `improve` deletes in reverse and searches near by for a lighter set;
         `tighten` fits view cells to where they are needed, and `prune` follows, because tightened impostors cost less;
         `assign` says what each view shows; `evaluate` adds everything up from scratch, and must agree. Integers
         throughout, ties by id.
Base     Candidates that a base has built (`base`) are chosen from the start, and stay as they are unless no view needs them.
         No search near by, and no curve: either would build the level anew.
Anytime  Where time is limited, the greedy, then the rescue, are cut short: every view then meets its target at the price
         of more bytes. What comes after only saves bytes, and stops where it is.
After    Jeschke, Wimmer, Schumann, Purgathofer. Automatic Impostor Placement for Guaranteed Frame Rates and Low Memory
         Requirements. I3D 2005, sections 5.1 to 5.5. All around the greedy loop is ours.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from farfield.candidates.alone import Alone, candidates_for
from farfield.candidates.model import Candidates, take
from farfield.errors import StageFailed
from farfield.geometry.cells import CellTree
from farfield.hierarchy.model import Hierarchy
from farfield.placement.antichain import Offers, subtree_end
from farfield.placement.assign import fastest, least
from farfield.placement.base import choose_from
from farfield.placement.checkpoint import Checkpoint
from farfield.placement.choose import Progress, choose
from farfield.placement.complete import complete
from farfield.placement.curve import gather, trace
from farfield.placement.evaluate import evaluate
from farfield.placement.improve import MOVES_AN_IMPOSTOR, improve
from farfield.placement.limit import Limit
from farfield.placement.maps import place_maps
from farfield.placement.model import Placement, RegionChoice
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
    candidates: Candidates, *, settings: Settings, regions: Sequence[RegionChoice] = (), refit: Refit | None = None,
    alone: Alone | None = None, progress: Progress | None = None, checkpoint: Checkpoint | None = None,
) -> Placement:  # fmt: skip
    """Return the chosen impostors and what each problem view shows. Raises StageFailed if its own proof fails.

    candidates  read only (memory maps will do); sorted by cluster, bytes > 0, saved > 0, views ascending in a row
    regions     what parts of the view space chose, all of them: nothing else is chosen from; none: all candidates
    refit       fits a view cell to given cells, see `tighten.Refit`; None: the candidates' own
    alone       offers a cell what is made for it alone; None: `candidates.alone`, or nothing where `refit` is given
    progress    called with a share in [0, 1] and counters, at most a few times a second; of arrays among them ("hopeless"
                (V,) b1, "over" (V,) i64: cost above the target) a copy is to be kept, if anything
    checkpoint  where the greedy keeps its choices
    """
    check_inputs(hierarchy, views, candidates)
    if not len(views.cell):
        return _nothing_to_place(model, views)
    if settings.placement.candidates == "environment":
        return place_maps(hierarchy, model, views, candidates, settings=settings)
    tell = progress or (lambda share, counters: None)
    policy, limit = settings.placement, Limit(settings.placement.time_limit_s)
    end = subtree_end(hierarchy.start, hierarchy.stop)
    if alone is None and refit is None:
        alone = cells_alone(hierarchy, model, cells, views, settings)
    if alone is not None:
        candidates = complete(candidates, views, target=model.target, end=end, alone=alone)
    prospects = find_prospects(hierarchy, model, views, candidates, end=end, policy=policy)
    need = views.cost - prospects.target
    facts = {"hopeless": prospects.hopeless, "smallest_budget": prospects.smallest_budget}
    tell(0.1, {"bytes": 0, "over": need, **facts})

    some, based = candidates, len(candidates.base) > 0
    if based:
        step = chosen = choose_from(candidates, need=need, end=end, stop=limit.over)
    else:
        if regions:
            some = take(candidates, np.unique(np.concatenate([r.candidate for r in regions])))
        choice = choose(
            some, excess=np.maximum(need, 0), end=end, everywhere=policy.assignment == "all", stop=limit.over,
            checkpoint=checkpoint, progress=lambda share, counters: tell(0.1 + 0.6 * share, counters),
        )  # fmt: skip
        step, chosen = choice.step, rescue(some, choice.chosen, need=need, end=end, stop=limit.over)
    solved = np.zeros(len(need), np.int64)  # the rescue leaves no view above its target
    tell(0.75, {"impostors": len(chosen), "bytes": int(some.bytes[chosen].sum()), "over": solved})

    if policy.reverse_delete and not limit.over():
        chosen = improve(some, chosen, need=need, end=end, moves=0 if based else MOVES_AN_IMPOSTOR, stop=limit.over)
    impostors, offers = gather(some, chosen, len(need))
    tell(0.85, {"impostors": len(impostors.cluster), "bytes": int(impostors.bytes.sum())})

    def fit(impostors: Impostors, offers: Offers, needed: np.ndarray) -> tuple[Impostors, Offers]:
        return tighten(
            impostors, offers, needed=needed, view_cell=views.cell, hierarchy=hierarchy, cells=cells,
            refit=refit or candidates_refit(model, settings), stop=limit.over,
        )  # fmt: skip

    tight = policy.view_cells == "tight"
    if tight and not limit.over():
        impostors, offers = fit(
            impostors, offers, least(offers, cluster=impostors.cluster, end=end, need=need)
        )  # fmt: skip
        if policy.reverse_delete:
            impostors, offers = _pruned(impostors, offers, need=need, end=end, limit=limit)
    impostors, offers = _ordered(impostors, offers)
    if policy.assignment == "least":
        shown = least(offers, cluster=impostors.cluster, end=end, need=need)
    else:
        shown = fastest(offers, cluster=impostors.cluster, end=end)
    impostors, offers, shown = _only_shown(impostors, offers, shown)
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
    points = list(
        trace(
            impostors, offers, take(some, np.union1d(step, chosen)), model=model, cost=views.cost,
            target=prospects.target, end=end, fit=fit if tight else lambda impostors, offers, needed: (impostors, offers),
            stop=(lambda: True) if based else limit.over,
        )
    )  # fmt: skip
    tell(1.0, {"impostors": len(impostors.cluster), "bytes": int(impostors.bytes.sum())})
    return Placement(
        cluster=impostors.cluster, kind=impostors.kind, view_cell=impostors.view_cell, bytes=impostors.bytes,
        layers=impostors.layers, cost=impostors.cost, serve_row=serve_row, serve=serve, view_cost=view_cost,
        view_target=prospects.target, view_best=prospects.best, hopeless=prospects.hopeless,
        culprit_row=prospects.culprit_row, culprit=prospects.culprit, smallest_budget=prospects.smallest_budget,
        curve_budget=np.array([p.budget for p in points], np.int64), curve_bytes=np.array([p.bytes for p in points], np.int64),
        curve_over=np.array([p.over for p in points], np.int64),
        stopped=limit.stopped or any(r.stopped for r in regions), base=impostors.base,
    )  # fmt: skip


def check_inputs(hierarchy: Hierarchy, views: ProblemViews, candidates: Candidates) -> None:
    """Assert what the stage before promises."""
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
        curve_budget=np.array([model.budget]), curve_bytes=np.zeros(1, np.int64), curve_over=np.zeros(1, np.int64),
        stopped=False,
    )  # fmt: skip


def cells_alone(
    hierarchy: Hierarchy, model: CostModel, cells: CellTree, views: ProblemViews, settings: Settings
) -> Alone | None:
    """Return what makes candidates for a cell alone; None where view cells are to be as generated."""
    if settings.placement.view_cells == "raw":
        return None
    return partial(candidates_for, hierarchy=hierarchy, model=model, cells=cells, views=views, settings=settings)


def candidates_refit(model: CostModel, settings: Settings) -> Refit:
    """Return what fits a view cell to given cells as candidates are fitted."""
    from farfield.candidates.generate import refit

    return partial(refit, model=model, settings=settings)


def _pruned(
    impostors: Impostors, offers: Offers, *, need: np.ndarray, end: np.ndarray, limit: Limit
) -> tuple[Impostors, Offers]:
    stay = prune(offers, cluster=impostors.cluster, bytes=impostors.bytes, need=need, end=end, stop=limit.over)
    return impostors.take(stay), keep(offers, stay)


def _only_shown(impostors: Impostors, offers: Offers, shown: np.ndarray) -> tuple[Impostors, Offers, np.ndarray]:
    """Drop the impostors that no view shows: none, after a reverse delete that was not cut short."""
    stay = np.bincount(offers.id[shown], minlength=len(impostors.cluster)) > 0
    return impostors.take(stay), keep(offers, stay), shown[stay[offers.id]]


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
