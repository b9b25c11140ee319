"""The lower bound where there are too many entries to learn every share: a whole city has 60 million.

Problem  As in `bound`, whose prices and shares take a hundred passes over all entries, with five more columns of them.
Method   The same bound, in two dozen passes over those candidates only that earn their bytes at the pass's prices. A share is a
         weight, normalised anew in each pass: it shrinks where a view's best antichain leaves the candidate out. Prices
         rise by a factor where the maximum saves less than the view needs and fall where it saves more, in ever
         smaller steps. Each pass is proven in integers over all candidates; the best counts.
Tried    The whole demo city (57.6 M entries), 24 passes, 72 s: 170.5 MB; shares in proportion to what views pay, 60 passes, 90 s:
         152 MB. The method of `bound` on the 4 million entries that earn most, others joining in a second round: nothing,
         since prices rise until what was left out earns many times its bytes.
"""

import numpy as np
from numba import njit

from farfield.placement.antichain import best_antichain
from farfield.placement.bound_kernels import ROUNDING, Offered, offers_of_two

PASSES = 24
FIRST_STEP, LAST_STEP = 8.0, 0.4  # of prices
MOMENTUM = 0.5
LEARNING = 0.2  # of shares
LEAST_WEIGHT = 1e-4
BITS = 60  # prices are scaled so that all needs together cost less than 2**BITS

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
        offered = Offered(*offers_of_two(order, *lists[0], *lists[1], need))
        surplus = _surplus(offered, cluster, end, weight, scale, whole, need, covered)
        total = sum((whole * need - surplus).tolist())
        best = max(best, -(-total >> shift) if shift >= 0 else total << -shift)
        pull = MOMENTUM * pull + (1 - MOMENTUM) * np.maximum(1 - covered, -2.0)
        budget *= np.exp(step * pull)
        del offered  # gigabytes on a whole city: gone before the next pass makes its own
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
    offered: Offered, cluster: np.ndarray, end: np.ndarray, weight: np.ndarray, scale: np.ndarray, price: np.ndarray,
    need: np.ndarray, covered: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return (V,) i64 max over antichains of sum (price g - share); `covered` (V,) f64: what share of its need that saves.

    Weights (E,) f32 of the entries that are left out shrink.
    """
    row, id, entry, gain = offered.row, offered.id, offered.entry, offered.gain
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
            earning = price[v] * gain[low + k]
            value[k] = earning - np.int64(float(earning) * _part(entry[low + k], i, weight, scale))
        surplus[v] = best_antichain(node[:n], value[:n], end, take[:n], stack_node, stack_sum)
        reached = np.int64(0)
        for k in range(n):
            if take[k]:
                reached += gain[low + k]
            else:
                weight[entry[low + k]] *= shrink
        covered[v] = reached / need[v] if need[v] > 0 else 1.0
    return surplus
