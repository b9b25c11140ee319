"""Memory over budget: what the placement would weigh if a frame might cost more.

Problem  A director asks what 18 ms instead of 16 would save, before anything is baked, and without another job.
Method   From the chosen impostors on, budget after budget: every view that they bring to the new budget may now cost that
         much (others keep their target); the reverse delete goes on from there, and view cells are tightened again. At
         some budgets the greedy also runs anew, among the candidates that it had chosen once, with rescue, reverse
         delete and tightening; the lighter set goes on. So bytes never rise with the budget, nor do the views above it.
         Large pools (LARGE) are given fewer points, and the reverse delete alone: with all of it the curve of the demo
         city takes 137 s, beside 60 s for its placement.
Errs     Each point is a set that was found, hence an upper bound. A job at that budget has candidates made for its own
         problem views: tests/services/placement/test_curve.py compares, and says how far.
         Nothing is said of smaller budgets: views that are no problem today would be then.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from farfield.candidates.model import Candidates
from farfield.placement.antichain import Offers, best_in_views, offers_of
from farfield.placement.assign import least
from farfield.placement.choose import choose
from farfield.placement.prune import keep, prune
from farfield.placement.rescue import rescue
from farfield.placement.tighten import Impostors
from farfield.rendertime.model import CostModel

Fit = Callable[[Impostors, Offers, np.ndarray], tuple[Impostors, Offers]]
"""impostors, what they offer, which offers are needed (S,) b1 -> the same, tightened"""

PERCENT = (102, 105, 110, 115, 120, 130, 140, 150, 175, 200, 250, 300, 400, 500, 700, 1000)  # of the job's budget
CHOSEN_ANEW = (105, 110, 120, 140, 175, 250)
LARGE = 4_000_000  # entries of the pool, from which on only CHOSEN_ANEW are looked at, by the reverse delete alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """These impostors keep every problem view but `over` within `budget`, per_frame included."""

    budget: int
    bytes: int
    over: int
    impostors: Impostors
    offers: Offers


def trace(
    impostors: Impostors, offers: Offers, pool: Candidates, *, model: CostModel, cost: np.ndarray, target: np.ndarray,
    end: np.ndarray, fit: Fit, stop: Callable[[], bool] = lambda: False,
) -> Iterator[Point]:  # fmt: skip
    """Yield points of rising budgets, from the model's with the impostors given to the one that needs none.

    impostors, offers  of the placement: every view can meet its target by them; ascending clusters
    pool    what else may be chosen
    cost    (V,) i64 of each problem view as geometry; target  (V,) i64 of the job
    end     (C,) i32, see `antichain.subtree_end`
    stop    asked before each point: True leaves out all but the last
    """
    target, n_views = target.copy(), len(cost)
    reached = cost - _saved(impostors, offers, end)
    yield _point(model.budget, impostors, offers, reached > model.target)
    worst, budget = int(cost.max(initial=0)) + model.per_frame, model.budget
    large = int(pool.row[-1]) > LARGE
    for percent in CHOSEN_ANEW if large else PERCENT:
        before, budget = budget, -(-model.budget * percent // 100)
        if budget <= before:
            continue
        if budget >= worst or stop():
            break
        within = budget - model.per_frame
        target = np.where(reached <= within, within, target)
        need = cost - target
        if large:
            impostors, offers = _pruned(impostors, offers, need, end)
            reached = cost - _saved(impostors, offers, end)
            yield _point(budget, impostors, offers, reached > within)
            continue
        found = [_lighter(impostors, offers, need=need, end=end, fit=fit)]
        if percent in CHOSEN_ANEW and _reaches(pool, need, end):
            chosen = choose(pool, excess=np.maximum(need, 0), end=end).chosen
            anew = gather(pool, rescue(pool, chosen, need=need, end=end), n_views)
            found.append(_lighter(*anew, need=need, end=end, fit=fit))
        impostors, offers = min(found, key=lambda f: int(f[0].bytes.sum()))
        reached = cost - _saved(impostors, offers, end)
        yield _point(budget, impostors, offers, reached > within)
    if worst > model.budget:
        none = np.zeros(len(impostors.cluster), dtype=bool)
        yield _point(worst, impostors.take(none), keep(offers, none), np.zeros(0, bool))


def gather(candidates: Candidates, chosen: np.ndarray, n_views: int) -> tuple[Impostors, Offers]:
    """Return the candidates `chosen` (I,), ascending, as impostors, and what they offer to views."""
    everywhere = np.ones(n_views, dtype=bool)
    row, id, saved = offers_of(chosen, candidates.row, candidates.view, candidates.saved, everywhere)
    impostors = Impostors(
        cluster=candidates.cluster[chosen], kind=candidates.kind[chosen], view_cell=candidates.view_cell[chosen],
        bytes=candidates.bytes[chosen], layers=candidates.layers[chosen], cost=candidates.cost[chosen],
        base=candidates.base[chosen] if len(candidates.base) else candidates.base,
    )  # fmt: skip
    return impostors, Offers(row=row, id=id, saved=saved)


def _point(budget: int, impostors: Impostors, offers: Offers, over: np.ndarray) -> Point:
    size = int(impostors.bytes.sum())
    return Point(budget=budget, bytes=size, over=int(over.sum()), impostors=impostors, offers=offers)


def _saved(impostors: Impostors, offers: Offers, end: np.ndarray) -> np.ndarray:
    shown = np.empty(len(offers.id), dtype=bool)
    return np.asarray(best_in_views(offers.row, offers.id, offers.saved, impostors.cluster, end, shown))


def _reaches(pool: Candidates, need: np.ndarray, end: np.ndarray) -> bool:
    """True if the pool alone meets every target: tightened impostors may reach what no candidate does."""
    impostors, offers = gather(pool, np.arange(len(pool.cluster), dtype=np.int32), len(need))
    return bool((_saved(impostors, offers, end) >= need).all())


def _lighter(
    impostors: Impostors, offers: Offers, *, need: np.ndarray, end: np.ndarray, fit: Fit
) -> tuple[Impostors, Offers]:
    """Return what the reverse delete leaves, tightened to where it is needed, once more thinned out."""
    impostors, offers = _pruned(impostors, offers, need, end)
    impostors, offers = fit(impostors, offers, least(offers, cluster=impostors.cluster, end=end, need=need))
    return _pruned(impostors, offers, need, end)


def _pruned(impostors: Impostors, offers: Offers, need: np.ndarray, end: np.ndarray) -> tuple[Impostors, Offers]:
    stay = prune(offers, cluster=impostors.cluster, bytes=impostors.bytes, need=need, end=end)
    return impostors.take(stay), keep(offers, stay)
