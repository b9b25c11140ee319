"""The lower bound where there are too many entries to learn every share: a whole city has 60 million.

Problem  As in `bound`, whose prices and shares take a hundred passes over all entries, with five more columns of them.
Method   The same bound, in two dozen passes over those candidates only that earn their bytes at the pass's prices. A share is a
         weight, normalised anew in each pass: it shrinks where a view's best antichain leaves the candidate out. Prices
         rise by a factor where the maximum saves less than the view needs and fall where it saves more, in ever
         smaller steps. Each pass is proven in integers over all candidates; the best counts. Entries are read in their
         order: a block of views gathers what it is offered, of which few megabytes are there at a time.
Tried    The whole demo city (57.6 M entries), 24 passes, 36 s: 170.7 MB; shares in proportion to what views pay, 60 passes, 90 s:
         152 MB. The method of `bound` on the 4 million entries that earn most, others joining in a second round: nothing,
         since prices rise until what was left out earns many times its bytes. All offers of a pass in one transposition, as
         in `bound`: the same result, 72 s and 2.4 GB instead of 36 s and 1.4 GB (24 passes).
"""

import numpy as np
from numba import njit

from farfield.placement.antichain import best_antichain
from farfield.placement.bound_kernels import ROUNDING

PASSES = 24
FIRST_STEP, LAST_STEP = 8.0, 0.4  # of prices
MOMENTUM = 0.5
LEARNING = 0.2  # of shares
LEAST_WEIGHT = 1e-4
BITS = 60  # prices are scaled so that all needs together cost less than 2**BITS
BLOCK = 1 << 21  # offers that are gathered at a time, 13 bytes each

Listed = tuple[np.ndarray, np.ndarray, np.ndarray]
"""(row, view, saved), as in Candidates"""


def lower_bound(
    lists: tuple[Listed, Listed], cluster: np.ndarray, bytes: np.ndarray, need: np.ndarray, end: np.ndarray,
    price: np.ndarray,
) -> int:  # fmt: skip
    """Return the best bound of PASSES passes; ids and entries of the second list come after the first's.

    cluster, bytes  (N,) of both lists; need  (V,) i64 >= 0; price  (V,) f64 bytes for a unit of need, to begin with
    """
    n_first, first_entries = len(lists[0][0]) - 1, len(lists[0][1])
    budget, weight = price * need, np.ones(first_entries + len(lists[1][1]), np.float32)
    shift = BITS - 2 - int(max(1.0, budget.sum())).bit_length()
    scaled, scale = bytes.astype(np.float64) * 2.0**shift, np.empty((len(bytes), 2))
    best, pull, covered = 0, np.zeros(len(need)), np.empty(len(need))
    for step in np.geomspace(FIRST_STEP, LAST_STEP, PASSES):
        budget *= min(1.0, 2.0 ** (BITS - shift) / (1 + budget.sum()))
        whole = np.floor(budget * 2.0**shift / np.maximum(need, 1)).astype(np.int64)
        _split(*lists[0], scaled[:n_first], whole, need, weight[:first_entries], scale[:n_first])
        _split(*lists[1], scaled[n_first:], whole, need, weight[first_entries:], scale[n_first:])
        rich = np.flatnonzero(scale[:, 1])
        order = rich[np.argsort(cluster[rich], kind="stable")]
        surplus = _surplus(order, *lists[0], *lists[1], cluster, end, weight, scale, whole, need, covered, BLOCK)
        total = sum((whole * need - surplus).tolist())
        best = max(best, -(-total >> shift) if shift >= 0 else total << -shift)
        pull = MOMENTUM * pull + (1 - MOMENTUM) * np.maximum(1 - covered, -2.0)
        budget *= np.exp(step * pull)
    return best


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
    order: np.ndarray, row_a: np.ndarray, view_a: np.ndarray, saved_a: np.ndarray, row_b: np.ndarray, view_b: np.ndarray,
    saved_b: np.ndarray, cluster: np.ndarray, end: np.ndarray, weight: np.ndarray, scale: np.ndarray, price: np.ndarray,
    need: np.ndarray, covered: np.ndarray, block: int,
) -> np.ndarray:  # fmt: skip
    """Return (V,) i64 max over antichains of sum (price g - share); `covered` (V,) f64: what share of its need that saves.

    order   ids that are looked at, ascending with the cluster; weights (E,) f32 of those left out of a maximum shrink
    block   offers gathered at a time; a view that has more is gathered alone
    """
    n_views, n_first, n_entries = len(need), len(row_a) - 1, row_a[-1]
    offer_row, at = np.zeros(n_views + 1, np.int64), np.empty(len(order), np.int64)
    for s in range(len(order)):
        i, row, view = (order[s], row_a, view_a) if order[s] < n_first else (order[s] - n_first, row_b, view_b)
        at[s] = row[i]
        for e in range(row[i], row[i + 1]):
            offer_row[view[e] + 1] += 1
    widest = offer_row.max()
    offer_row = np.cumsum(offer_row)
    room = max(widest, min(block, offer_row[-1]))
    node, value, take = np.empty(room, np.int32), np.empty(room, np.int64), np.empty(room, np.bool_)
    stack_node, stack_sum = np.empty(widest, np.int32), np.empty(widest, np.int64)
    surplus, fill = np.zeros(n_views, np.int64), np.empty(n_views, np.int64)
    shrink = np.exp(-LEARNING)
    first = 0
    while first < n_views:
        last = first + 1
        while last < n_views and offer_row[last + 1] - offer_row[first] <= room:
            last += 1
        low = offer_row[first]
        fill[first:last] = offer_row[first:last] - low
        for s in range(len(order)):
            second = order[s] >= n_first
            i = order[s] - n_first if second else order[s]
            row, view, saved = (row_b, view_b, saved_b) if second else (row_a, view_a, saved_a)
            for e in range(at[s], row[i + 1]):
                v = view[e]
                if v >= last:
                    break
                node[fill[v]] = cluster[order[s]]
                earning = price[v] * min(saved[e], need[v])
                part = _part(e + (n_entries if second else 0), order[s], weight, scale)
                value[fill[v]] = earning - np.int64(float(earning) * part)
                fill[v] += 1
        for v in range(first, last):
            a, b = offer_row[v] - low, offer_row[v + 1] - low
            surplus[v] = best_antichain(node[a:b], value[a:b], end, take[a:b], stack_node, stack_sum)
            fill[v] = a
            covered[v] = 0.0
        for s in range(len(order)):
            second = order[s] >= n_first
            i = order[s] - n_first if second else order[s]
            row, view, saved = (row_b, view_b, saved_b) if second else (row_a, view_a, saved_a)
            while at[s] < row[i + 1] and view[at[s]] < last:
                v = view[at[s]]
                if take[fill[v]]:
                    covered[v] += min(saved[at[s]], need[v])  # whole numbers below 2**53
                else:
                    weight[at[s] + (n_entries if second else 0)] *= shrink
                fill[v] += 1
                at[s] += 1
        first = last
    for v in range(n_views):
        covered[v] = covered[v] / need[v] if need[v] > 0 else 1.0
    return surplus
