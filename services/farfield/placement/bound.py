"""A lower bound on the bytes of any placement: how far from the lightest can the chosen one be?

Problem  No choice of these candidates meets every target with fewer bytes than ... how many?
Method   Lagrangian duality. Price each view's need: price[v] >= 0 a unit of cost saved. Split each candidate's bytes over
         the views it serves: share[i, v] >= 0 with sum at most bytes[i]. In a view that meets its target the antichain
         shown saves need[v] or more, with g = min(saved, need[v]); hence for any prices and shares

             bytes of any placement >= sum_v (price[v] need[v] - max over antichains of sum (price[v] g[i, v] - share[i, v]))

         Shares in proportion to price g: only candidates whose bytes are less than what they earn in all their views
         enter the maximum, which is a best antichain (`antichain`). Prices rise by a factor where the maximum saves less
         than the view needs and fall where it saves more, in ever smaller steps; the best bound counts. Prices are
         integers of 2**-shift byte and shares are rounded down, so each step's bound is proven, not approximate.
         Not in `place`: it takes longer than all the rest (the demo city 90 s: 152 MB, placed 236), and decides nothing.
Tried    A made-up town of 4,000 houses, 6,343 views, 7.1 M entries, 19.8 MB placed; 60 passes, 2.7 s: this 15.6 MB.
         Without antichains (all that candidates earn above their bytes, which counts nested ones of a view together):
         12.7 MB. That with additive subgradient steps (Polyak): 8.4 MB. First and last step 0.3 and 0.02: 12.8 MB, 2 and
         0.1: 15.3 MB, 16 and 0.4: 15.5 MB, 30 and 0.4: 14.9 MB. 20 passes: 13 MB at best.
"""

import numpy as np
from numba import njit

from farfield.candidates.model import Candidates
from farfield.placement.antichain import Offers, best_antichain
from farfield.placement.tighten import Impostors

ITERATIONS = 60
FIRST_STEP, LAST_STEP = 8.0, 0.4
MOMENTUM = 0.5
ROUNDING = 2.0**-30  # more than float64 sums of ten million terms can be wrong by, relatively
BITS = 60  # prices are scaled so that all needs together cost less than 2**BITS


@njit(cache=True)
def _earnings(row: np.ndarray, view: np.ndarray, saved: np.ndarray, price: np.ndarray, need: np.ndarray) -> np.ndarray:
    """Return (N,) f64, rounded: what candidates earn in all their views, sum of price * min(saved, need)."""
    earned = np.zeros(len(row) - 1)
    for i in range(len(earned)):
        total = 0.0
        for e in range(row[i], row[i + 1]):
            total += float(price[view[e]]) * min(saved[e], need[view[e]])
        earned[i] = total
    return earned


@njit(cache=True)
def _surplus(
    row: np.ndarray, id: np.ndarray, saved: np.ndarray, share: np.ndarray, cluster: np.ndarray, end: np.ndarray,
    price: np.ndarray, need: np.ndarray, covered: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return (V,) i64 max over antichains of sum (price g - share); `covered` (V,) f64: what share of its need that saves.

    share  by id, f64: the part of each earning that the bytes pay, rounded down
    """
    widest = 0
    for v in range(len(need)):
        widest = max(widest, row[v + 1] - row[v])
    node, stack_node = np.empty(widest, np.int32), np.empty(widest, np.int32)
    weight, stack_sum, take = np.empty(widest, np.int64), np.empty(widest, np.int64), np.empty(widest, np.bool_)
    surplus = np.zeros(len(need), np.int64)
    for v in range(len(need)):
        low, n = row[v], row[v + 1] - row[v]
        for k in range(n):
            node[k] = cluster[id[low + k]]
            earned = price[v] * min(saved[low + k], need[v])
            weight[k] = earned - np.int64(float(earned) * share[id[low + k]])
        surplus[v] = best_antichain(node[:n], weight[:n], end, take[:n], stack_node, stack_sum)
        reached = np.int64(0)
        for k in range(n):
            if take[k]:
                reached += min(saved[low + k], need[v])
        covered[v] = reached / need[v] if need[v] > 0 else 1.0
    return surplus


@njit(cache=True)
def _offers_of_two(
    order: np.ndarray, n_first: int, row_a: np.ndarray, view_a: np.ndarray, saved_a: np.ndarray, row_b: np.ndarray,
    view_b: np.ndarray, saved_b: np.ndarray, n_views: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return (row, id, saved) of what `order` offers to views; ids count in `order`, numbers from n_first on are b's."""
    count = np.zeros(n_views + 1, np.int64)
    for s in range(len(order)):
        i, row, view = (order[s], row_a, view_a) if order[s] < n_first else (order[s] - n_first, row_b, view_b)
        for e in range(row[i], row[i + 1]):
            count[view[e] + 1] += 1
    offer_row = np.cumsum(count)
    id, saving = np.empty(offer_row[-1], np.int32), np.empty(offer_row[-1], np.int64)
    fill = offer_row[:-1].copy()
    for s in range(len(order)):
        second = order[s] >= n_first
        i = order[s] - n_first if second else order[s]
        row, view, saved = (row_b, view_b, saved_b) if second else (row_a, view_a, saved_a)
        for e in range(row[i], row[i + 1]):
            id[fill[view[e]]] = s
            saving[fill[view[e]]] = saved[e]
            fill[view[e]] += 1
    return offer_row, id, saving


def lower_bound_bytes(
    candidates: Candidates, impostors: Impostors, offers: Offers, *, need: np.ndarray, end: np.ndarray,
    iterations: int = ITERATIONS,
) -> int:  # fmt: skip
    """Return bytes that no choice from candidates and impostors together can stay below and meet every target.

    impostors, offers  of the placement: tightened ones weigh less than any candidate, and their bytes give first prices
    need               (V,) i64 cost of each view minus its target
    end                (C,) i32, see `antichain.subtree_end`
    """
    need = np.maximum(need, 0)
    if not len(impostors.cluster):
        return 0
    chosen = _by_impostor(offers, len(impostors.cluster))
    budget = _first_prices(*chosen, impostors.bytes, need)
    shift = BITS - 2 - int(max(1.0, budget.sum())).bit_length()
    bytes = np.concatenate([candidates.bytes, impostors.bytes]).astype(np.float64) * 2.0**shift
    cluster = np.concatenate([candidates.cluster, impostors.cluster])
    offered = (candidates.row, candidates.view, candidates.saved)
    best, pull, covered = 0, np.zeros(len(need)), np.empty(len(need))
    for step in np.geomspace(FIRST_STEP, LAST_STEP, iterations):
        budget *= min(1.0, 2.0 ** (BITS - shift) / (1 + budget.sum()))
        price = np.floor(budget * 2.0**shift / np.maximum(need, 1)).astype(np.int64)
        earned = np.concatenate([_earnings(*columns, price, need) for columns in (offered, chosen)])
        rich = np.flatnonzero(earned > bytes * (1 - ROUNDING))
        order = rich[np.argsort(cluster[rich], kind="stable")]
        row, id, saved = _offers_of_two(order, len(candidates.cluster), *offered, *chosen, len(need))
        share = bytes[order] / earned[order] * (1 - ROUNDING)
        surplus = _surplus(row, id, saved, share, cluster[order], end, price, need, covered)
        total = sum((price * need - surplus).tolist())
        best = max(best, -(-total >> shift) if shift >= 0 else total << -shift)
        pull = MOMENTUM * pull + (1 - MOMENTUM) * np.maximum(1 - covered, -2.0)
        budget *= np.exp(step * pull)
    return best


def _by_impostor(offers: Offers, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (row, view, saved) as in Candidates of n impostors."""
    order = np.argsort(offers.id, kind="stable")
    view = np.repeat(np.arange(len(offers.row) - 1, dtype=np.int32), np.diff(offers.row))
    row = np.concatenate([[0], np.cumsum(np.bincount(offers.id, minlength=n))]).astype(np.int64)
    return row, view[order], offers.saved[order]


def _first_prices(
    row: np.ndarray, view: np.ndarray, saved: np.ndarray, bytes: np.ndarray, need: np.ndarray
) -> np.ndarray:
    """Return (V,) f64 bytes a view: each impostor's bytes split over its views as it saves there."""
    gain = np.minimum(saved, need[view]).astype(np.float64)
    owner = np.repeat(np.arange(len(bytes)), np.diff(row))
    total = np.bincount(owner, weights=gain, minlength=len(bytes))
    return np.bincount(view, weights=gain * (bytes / np.maximum(total, 1))[owner], minlength=len(need))
