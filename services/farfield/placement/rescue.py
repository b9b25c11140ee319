"""Add what stranded views need: views still above target once the greedy has ended.

Problem  The greedy can block a finer solution by a coarse ancestor, in views that candidates could bring to their
         target. Add the fewest bytes that do.
Method   Views in the order of what they lack, most first. In each, the best antichain of (multiplier * saved - bytes),
         bytes 0 for what is chosen already; bisect for the smallest multiplier whose antichain saves enough, and add
         it. That is the Lagrangian of the lightest antichain: exact on the hull of (bytes, saved), and each view's
         answer serves the views after it. Multiplier infinity is the best antichain of all candidates, which always
         suffices, because no target is below a view's best. `prune` removes what became superfluous.
         Once time is up, the views left take their best antichain as it is, unless what was added serves them.
"""

from collections.abc import Callable

import numpy as np
from numba import njit

from farfield.candidates.model import Candidates
from farfield.placement.antichain import best_antichain, best_in_views, offers_of

SCALE = 16  # bits of a multiplier after the point
LIMIT = 2**61


@njit(cache=True)
def lightest_antichain(
    node: np.ndarray, saved: np.ndarray, price: np.ndarray, need: int, end: np.ndarray, take: np.ndarray
) -> bool:
    """Mark in `take` (k,) b1 an antichain that saves at least `need`, of small total price. False: none does.

    node  (k,) i32 ascending; saved, price  (k,) i64 >= 0
    """
    stack_node, stack_sum = np.empty(len(node), np.int32), np.empty(len(node), np.int64)
    if best_antichain(node, saved, end, take, stack_node, stack_sum) < need:
        return False
    total_saved, total_price = np.int64(1), np.int64(1)
    for k in range(len(node)):
        total_saved += saved[k]
        total_price += price[k]
    scale = np.int64(SCALE)
    while scale > 0 and total_price > LIMIT >> scale:
        scale -= 1
    low, high = np.int64(0), np.int64(LIMIT // total_saved)
    weight, found = np.empty(len(node), np.int64), np.empty(len(node), np.bool_)
    while low < high:
        middle = (low + high) // 2
        for k in range(len(node)):
            weight[k] = middle * saved[k] - (price[k] << scale)
        best_antichain(node, weight, end, found, stack_node, stack_sum)
        enough = np.int64(0)
        for k in range(len(node)):
            if found[k]:
                enough += saved[k]
        if enough >= need:
            take[:] = found
            high = middle
        else:
            low = middle + 1
    return True


def _any_antichain(
    node: np.ndarray, saved: np.ndarray, price: np.ndarray, need: int, end: np.ndarray, take: np.ndarray
) -> bool:
    """As `lightest_antichain`, without the search: what costs nothing if that is enough, else what saves most."""
    stack = np.empty(len(node), np.int32), np.empty(len(node), np.int64)
    if best_antichain(node, np.where(price == 0, saved, 0), end, take, *stack) >= need:
        return True
    return bool(best_antichain(node, saved, end, take, *stack) >= need)


def rescue(
    candidates: Candidates, chosen: np.ndarray, *, need: np.ndarray, end: np.ndarray,
    stop: Callable[[], bool] = lambda: False,
) -> np.ndarray:  # fmt: skip
    """Return `chosen` with what it takes that every view can save what it needs, ascending.

    chosen  (I,) i32 candidates, ascending
    need    (V,) i64 cost of each view minus its target
    stop    asked before each view: True ends the search for few bytes, not the rescue
    """
    everywhere = np.ones(len(need), dtype=bool)
    row, id, saved = offers_of(chosen, candidates.row, candidates.view, candidates.saved, everywhere)
    reached = best_in_views(row, id, saved, candidates.cluster[chosen], end, np.empty(len(id), dtype=bool))
    stranded = need > reached
    if not stranded.any():
        return chosen
    every = np.arange(len(candidates.cluster), dtype=np.int32)
    row, id, saved = offers_of(every, candidates.row, candidates.view, candidates.saved, stranded)
    price = candidates.bytes.copy()
    price[chosen] = 0
    views = np.flatnonzero(stranded)
    for v in views[np.argsort(-(need - reached)[views], kind="stable")]:
        offered, saves = id[row[v] : row[v + 1]], saved[row[v] : row[v + 1]]
        node, take = candidates.cluster[offered], np.empty(len(offered), dtype=bool)
        if stop():
            met = _any_antichain(node, saves, price[offered], need[v], end, take)
        else:
            met = lightest_antichain(node, saves, price[offered], need[v], end, take)
        assert met, f"problem view {v}: its target is below the best that its candidates reach"
        price[offered[take]] = 0
    return np.flatnonzero(price == 0).astype(np.int32)
