"""A lower bound on the bytes of any placement: how far from the lightest can the chosen one be?

Problem  No choice of these candidates meets every target with fewer bytes than ... how many?
Method   Lagrangian duality. Price each view's need: price[v] >= 0 a unit of cost saved. Split each candidate's bytes over
         the views it serves: share[i, v] >= 0 with sum at most bytes[i]. In a view that meets its target the antichain
         shown saves need[v] or more, with g = min(saved, need[v]); hence for any prices and shares

             bytes of any placement >= sum_v (price[v] need[v] - max over antichains of sum (price[v] g[i, v] - share[i, v]))

         A candidate that earns less than its bytes, sum_v price[v] g[i, v], gets shares that take its earnings away and
         never enters the maximum, which is a best antichain (`antichain`). The others' shares are learned: a view whose
         best antichain leaves a candidate out needs less of its share. Prices rise by a factor where the maximum saves
         less than the view needs and fall where it saves more, in ever smaller steps; the best bound counts. Small
         problems take prices and shares from the linear programme instead, whose dual this is (`bound_lp`).
         Prices are integers of 2**-shift byte and shares are rounded down, so each bound is proven, not approximate,
         wherever the prices came from.
Tried    60 passes each, over generated candidates and those placed. Shares in proportion to what a view pays: towns of
         400 houses 486 and 4,116 MB, the cut-out of the demo city 777 MB; learned shares: 540, 4,960 and 960. Longer
         runs gain 1 %. On a town of 100 houses the linear programme's optimum is 652.9 MB, learned shares find 651.8.
         Without antichains (nested ones of a view counted together) a fifth less. Additive steps (Polyak): half.
         The whole demo city (57.6 M entries), shares in proportion, 60 passes, 90 s: 152 MB; learned, 24 passes, 72 s:
         170.5 MB.
         Averages of what views took before learning from them: 1 to 2 % less. Views as whole numbers, their knapsack by
         dynamic programming over 64 quanta of the need: 0.3 to 0.7 % more on small towns, at five times the time.
"""

import numpy as np
from numba import njit

from farfield.candidates.model import Candidates
from farfield.hierarchy.model import Hierarchy
from farfield.placement.antichain import Offers, best_antichain, subtree_end
from farfield.placement.bound_lp import FEW_ENTRIES, MOST_ENTRIES, dual_prices
from farfield.placement.model import Bound, Placement
from farfield.placement.repair import offers_in_cell
from farfield.placement.tighten import Impostors
from farfield.viewspace.model import ProblemViews

ITERATIONS, FEW_ITERATIONS = 60, 24
MANY_ENTRIES = 10_000_000  # from there on the latter
FIRST_STEP, LAST_STEP = 8.0, 0.4  # of prices
MOMENTUM = 0.5
LEARNING = 0.2  # of shares
LEAST_WEIGHT = 1e-4
ROUNDING = 2.0**-24  # more than float64 sums of a hundred million terms can be wrong by, relatively
BITS = 60  # prices are scaled so that all needs together cost less than 2**BITS


@njit(cache=True)
def _part(e: int, i: int, weight: np.ndarray, scale: np.ndarray) -> float:
    """Return the part of candidate i's earning at entry e that its bytes pay."""
    return min(1.0, scale[i, 0] * weight[e]) * scale[i, 1]


@njit(cache=True)
def _split(
    row: np.ndarray, view: np.ndarray, saved: np.ndarray, bytes: np.ndarray, price: np.ndarray, need: np.ndarray,
    weight: np.ndarray, scale: np.ndarray,
) -> None:  # fmt: skip
    """Split bytes (N,) f64 by the weights of entries: `scale` (N,2) f64 is such that parts of earnings sum to at most that.

    scale is 0 for what earns less than its bytes. Weights of the others are made 1 at most, LEAST_WEIGHT at least.
    """
    for i in range(len(bytes)):
        total, most = 0.0, 0.0
        for e in range(row[i], row[i + 1]):
            total += float(price[view[e]] * min(saved[e], need[view[e]]))
        scale[i, 0] = scale[i, 1] = 0.0
        if total <= bytes[i] * (1 - ROUNDING):
            continue
        for e in range(row[i], row[i + 1]):
            most = max(most, weight[e])
        for e in range(row[i], row[i + 1]):
            weight[e] = max(weight[e] / max(most, 1e-30), LEAST_WEIGHT)
        factor = 0.0
        for _ in range(8):  # parts are 1 at most: what is cut off there is spread over the rest
            whole, rest = 0.0, 0.0
            for e in range(row[i], row[i + 1]):
                earning = float(price[view[e]] * min(saved[e], need[view[e]]))
                if factor * weight[e] >= 1:
                    whole += earning
                else:
                    rest += earning * weight[e]
            if rest <= 0 or whole >= bytes[i] or (bytes[i] - whole) / rest <= factor * (1 + 1e-6):
                break
            factor = (bytes[i] - whole) / rest
        scale[i, 0], scale[i, 1] = factor, 1.0
        paid = 0.0
        for e in range(row[i], row[i + 1]):
            paid += float(price[view[e]] * min(saved[e], need[view[e]])) * _part(e, i, weight, scale)
        scale[i, 1] = min(1.0, bytes[i] / max(paid, 1.0)) * (1 - ROUNDING)


@njit(cache=True)
def _surplus(
    row: np.ndarray, id: np.ndarray, entry: np.ndarray, cluster: np.ndarray, end: np.ndarray, saved: np.ndarray,
    weight: np.ndarray, scale: np.ndarray, price: np.ndarray, need: np.ndarray, covered: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return (V,) i64 max over antichains of sum (price g - share); `covered` (V,) f64: what share of its need that saves.

    entry  (S,) i64 of `weight` for each offer; weights of those left out shrink
    """
    widest = 0
    for v in range(len(need)):
        widest = max(widest, row[v + 1] - row[v])
    node, stack_node = np.empty(widest, np.int32), np.empty(widest, np.int32)
    value, stack_sum, take = np.empty(widest, np.int64), np.empty(widest, np.int64), np.empty(widest, np.bool_)
    surplus = np.zeros(len(need), np.int64)
    shrink = np.exp(-LEARNING)
    for v in range(len(need)):
        low, n = row[v], row[v + 1] - row[v]
        for k in range(n):
            i = id[low + k]
            node[k] = cluster[i]
            earning = price[v] * min(saved[low + k], need[v])
            value[k] = earning - np.int64(float(earning) * _part(entry[low + k], i, weight, scale))
        surplus[v] = best_antichain(node[:n], value[:n], end, take[:n], stack_node, stack_sum)
        reached = np.int64(0)
        for k in range(n):
            if take[k]:
                reached += min(saved[low + k], need[v])
            else:
                weight[entry[low + k]] *= shrink
        covered[v] = reached / need[v] if need[v] > 0 else 1.0
    return surplus


@njit(cache=True)
def _offers_of_two(
    order: np.ndarray, row_a: np.ndarray, view_a: np.ndarray, saved_a: np.ndarray, row_b: np.ndarray,
    view_b: np.ndarray, saved_b: np.ndarray, n_views: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return (row, id, entry, saved) of what `order` offers to views; b's ids and entries come after a's."""
    n_first = len(row_a) - 1
    count = np.zeros(n_views + 1, np.int64)
    for s in range(len(order)):
        i, row, view = (order[s], row_a, view_a) if order[s] < n_first else (order[s] - n_first, row_b, view_b)
        for e in range(row[i], row[i + 1]):
            count[view[e] + 1] += 1
    offer_row = np.cumsum(count)
    id, entry, saving = (
        np.empty(offer_row[-1], np.int32), np.empty(offer_row[-1], np.int64), np.empty(offer_row[-1], np.int64)
    )  # fmt: skip
    fill = offer_row[:-1].copy()
    for s in range(len(order)):
        second = order[s] >= n_first
        i = order[s] - n_first if second else order[s]
        row, view, saved = (row_b, view_b, saved_b) if second else (row_a, view_a, saved_a)
        for e in range(row[i], row[i + 1]):
            k = fill[view[e]]
            id[k], entry[k], saving[k] = order[s], e + (row_a[-1] if second else 0), saved[e]
            fill[view[e]] += 1
    return offer_row, id, entry, saving


def lower_bound_bytes(
    candidates: Candidates, impostors: Impostors, offers: Offers, *, need: np.ndarray, end: np.ndarray,
    method: str = "auto", iterations: int | None = None,
) -> int:  # fmt: skip
    """Return bytes that no choice from candidates and impostors together can stay below and meet every target.

    impostors, offers  of the placement: tightened ones weigh less than any candidate, and their bytes give first prices
    need               (V,) i64 cost of each view minus its target
    end                (C,) i32, see `antichain.subtree_end`
    method             "lp", "lagrangian", or "auto": see `uses_lp`
    """
    return _prove(candidates, impostors, offers, need=need, end=end, method=method, iterations=iterations)[0]


def _prove(
    candidates: Candidates, impostors: Impostors, offers: Offers, *, need: np.ndarray, end: np.ndarray, method: str,
    iterations: int | None,
) -> tuple[int, bool]:  # fmt: skip
    """Return the bound, and whether its prices are those of the linear programme."""
    need, lp = np.maximum(need, 0), False
    if not len(impostors.cluster):
        return 0, lp
    chosen = by_impostor(offers, len(impostors.cluster))
    n_first, first_entries = len(candidates.cluster), int(candidates.row[-1])
    cluster = np.concatenate([candidates.cluster, impostors.cluster])
    size = np.concatenate([candidates.bytes, impostors.bytes])
    offered = (candidates.row, candidates.view, candidates.saved)
    budget, weight = first_prices(*chosen, impostors.bytes, need), np.ones(first_entries + len(chosen[1]), np.float32)
    if uses_lp(method, len(weight)):
        row = np.concatenate([offered[0], first_entries + chosen[0][1:]])
        view, saved = (np.concatenate([a, b]) for a, b in zip(offered[1:], chosen[1:], strict=True))
        duals = dual_prices(row, view, saved, cluster=cluster, bytes=size, need=need, end=end)
        if duals is not None:
            (budget, weight), iterations, lp = duals, 1, True
    if iterations is None:
        iterations = ITERATIONS if len(weight) < MANY_ENTRIES else FEW_ITERATIONS
    shift = BITS - 2 - int(max(1.0, budget.sum())).bit_length()
    scaled, scale = size.astype(np.float64) * 2.0**shift, np.empty((len(size), 2))
    best, pull, covered = 0, np.zeros(len(need)), np.empty(len(need))
    for step in np.geomspace(FIRST_STEP, LAST_STEP, iterations):
        budget *= min(1.0, 2.0 ** (BITS - shift) / (1 + budget.sum()))
        price = np.floor(budget * 2.0**shift / np.maximum(need, 1)).astype(np.int64)
        _split(*offered, scaled[:n_first], price, need, weight[:first_entries], scale[:n_first])
        _split(*chosen, scaled[n_first:], price, need, weight[first_entries:], scale[n_first:])
        rich = np.flatnonzero(scale[:, 1])
        order = rich[np.argsort(cluster[rich], kind="stable")]
        row, id, entry, saved = _offers_of_two(order, *offered, *chosen, len(need))
        surplus = _surplus(row, id, entry, cluster, end, saved, weight, scale, price, need, covered)
        total = sum((price * need - surplus).tolist())
        best = max(best, -(-total >> shift) if shift >= 0 else total << -shift)
        pull = MOMENTUM * pull + (1 - MOMENTUM) * np.maximum(1 - covered, -2.0)
        budget *= np.exp(step * pull)
        del row, id, entry, saved  # gigabytes on a whole city: gone before the next pass makes its own
    return best, lp


def bound_of(
    placement: Placement, hierarchy: Hierarchy, views: ProblemViews, candidates: Candidates, *, method: str
) -> Bound:
    """Return the bound for a placement before its bake: over the candidates, and the placed impostors wherever in their
    cells they help.

    method  "auto", "lp" or "lagrangian"
    """
    p = placement
    impostors = Impostors(
        cluster=p.cluster, kind=p.kind, view_cell=p.view_cell, bytes=p.bytes, layers=p.layers, cost=p.cost
    )  # fmt: skip
    offers = offers_in_cell(p, hierarchy, views, p.cost, np.ones(len(views.cell), dtype=bool))
    low, lp = _prove(
        candidates, impostors, offers, need=views.cost - p.view_target,
        end=subtree_end(hierarchy.start, hierarchy.stop), method=method, iterations=None,
    )  # fmt: skip
    return Bound(
        method="lp" if lp else "lagrangian", lower_bytes=low, placed_bytes=int(p.bytes.sum()),
        choices=len(candidates.cluster) + len(p.cluster),
    )  # fmt: skip


def uses_lp(method: str, entries: int) -> bool:
    """Return whether to try the linear programme: "auto" with at most FEW_ENTRIES entries, "lp" with MOST_ENTRIES."""
    return entries <= {"auto": FEW_ENTRIES, "lp": MOST_ENTRIES}.get(method, -1)


def by_impostor(offers: Offers, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (row, view, saved) as in Candidates of n impostors."""
    order = np.argsort(offers.id, kind="stable")
    view = np.repeat(np.arange(len(offers.row) - 1, dtype=np.int32), np.diff(offers.row))
    row = np.concatenate([[0], np.cumsum(np.bincount(offers.id, minlength=n))]).astype(np.int64)
    return row, view[order], offers.saved[order]


def first_prices(
    row: np.ndarray, view: np.ndarray, saved: np.ndarray, bytes: np.ndarray, need: np.ndarray
) -> np.ndarray:
    """Return (V,) f64 bytes a view: each impostor's bytes split over its views as it saves there."""
    gain = np.minimum(saved, need[view]).astype(np.float64)
    owner = np.repeat(np.arange(len(bytes)), np.diff(row))
    total = np.bincount(owner, weights=gain, minlength=len(bytes))
    return np.bincount(view, weights=gain * (bytes / np.maximum(total, 1))[owner], minlength=len(need))
