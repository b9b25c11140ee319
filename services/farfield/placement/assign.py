"""Decide which of the chosen impostors each view shows: `fastest`, or `least` of them that meet the target.

Problem  The chosen set fixes the memory, not what a view shows of it. `fastest` is the best antichain. `least` is the
         smallest antichain that saves what the view needs, and of those the one that saves most.
Method   `least` is a knapsack on the tree: save(node, k) = most that k impostors below the node can save; own impostor
         for k >= 1, else children merged one after another. A table is no longer than the antichains below it, nor
         than the number of impostors that the largest savings of the best antichain take, so that one view costs
         O(offers * impostors), the usual bound of tree knapsacks. Ties: the coarser cluster, then the lower id.
"""

import numpy as np
from numba import njit

from farfield.placement.antichain import Offers, best_antichain, best_in_views


@njit(cache=True)
def _most_needed(saved: np.ndarray, take: np.ndarray, need: int) -> int:
    """Return how many of the taken, largest first, save `need` together."""
    largest = np.sort(saved[take])[::-1]
    total, n = np.int64(0), 0
    while n < len(largest) and total < need:
        total += largest[n]
        n += 1
    return n


@njit(cache=True)
def _with_room(pool: np.ndarray, size: int) -> np.ndarray:
    if size <= len(pool):
        return pool
    larger = np.empty(2 * size, np.int64)
    larger[: len(pool)] = pool
    return larger


@njit(cache=True)
def least_antichain(node: np.ndarray, saved: np.ndarray, need: int, end: np.ndarray, take: np.ndarray) -> bool:
    """Mark in `take` (k,) b1 an antichain of fewest offers that save at least `need` together. False: none does.

    node  (k,) i32, ascending, repetitions allowed; saved  (k,) i64 > 0; end  (C,) i32, see `antichain.subtree_end`
    """
    n = len(node)
    take[:] = False
    if need <= 0:
        return True
    stack, stack_sum = np.empty(n, np.int32), np.empty(n, np.int64)
    if best_antichain(node, saved, end, take, stack, stack_sum) < need:
        return False
    limit = _most_needed(saved, take, need)
    take[:] = False
    # The most that k impostors save: in e's subtree pool[one[e] + k], with its earlier siblings' pool[all[e] + k].
    pool, used = np.empty(4 * n + 64, np.int64), 0
    one, one_length = np.empty(n, np.int64), np.empty(n, np.int64)
    all, all_length = np.empty(n, np.int64), np.empty(n, np.int64)
    child, sibling = np.empty(n, np.int32), np.empty(n, np.int32)
    top, last = 0, -1
    for e in range(n - 1, -2, -1):
        stop = end[node[e]] if e >= 0 else 2**31 - 1
        last = -1
        while top > 0 and node[stack[top - 1]] < stop:
            top -= 1
            c = stack[top]
            sibling[c] = last
            if last < 0:
                all[c], all_length[c] = one[c], one_length[c]
            else:
                all[c], all_length[c] = used, min(limit, one_length[c] + all_length[last])
                used += all_length[c] + 1
                pool = _with_room(pool, used)
                pool[all[c] : used] = 0
                for a in range(one_length[c] + 1):
                    for b in range(min(all_length[last], limit - a) + 1):
                        both = pool[one[c] + a] + pool[all[last] + b]
                        pool[all[c] + a + b] = max(pool[all[c] + a + b], both)
            last = c
        if e < 0:
            break
        child[e] = last
        below = all_length[last] if last >= 0 else 0
        one[e], one_length[e] = used, max(below, 1)
        used += one_length[e] + 1
        pool = _with_room(pool, used)
        pool[one[e]] = 0
        for k in range(1, one_length[e] + 1):
            pool[one[e] + k] = max(saved[e], pool[all[last] + k]) if k <= below else saved[e]
        stack[top] = e
        top += 1
    k = 0
    while pool[all[last] + k] < need:
        k += 1
    # Walk down: `stack` holds last siblings, `budget` the impostors left to them and their earlier siblings.
    budget = np.empty(n, np.int64)
    stack[0], budget[0], top = last, k, 1
    while top > 0:
        top -= 1
        c, k = stack[top], min(budget[top], all_length[stack[top]])
        a, earlier = k, sibling[c]
        if earlier >= 0:
            a = 0
            while pool[one[c] + a] + pool[all[earlier] + min(k - a, all_length[earlier])] != pool[all[c] + k]:
                a += 1
            stack[top], budget[top] = earlier, k - a
            top += 1
        if a > 0 and pool[one[c] + a] == saved[c]:
            take[c] = True
        elif a > 0:
            stack[top], budget[top] = child[c], a
            top += 1
    return True


@njit(cache=True)
def _least_in_views(
    row: np.ndarray, id: np.ndarray, saved: np.ndarray, cluster: np.ndarray, end: np.ndarray, need: np.ndarray,
    take: np.ndarray,
) -> int:  # fmt: skip
    """Mark the least antichain of each view; return the first view that cannot save its need, or -1."""
    for v in range(len(row) - 1):
        low, high = row[v], row[v + 1]
        if not least_antichain(cluster[id[low:high]], saved[low:high], need[v], end, take[low:high]):
            return v
    return -1


def fastest(offers: Offers, *, cluster: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return (S,) b1: the offers that each view shows so that it costs least.

    cluster  (I,) i32 of the ids offered, ascending; end  (C,) i32, see `antichain.subtree_end`
    """
    shown = np.empty(len(offers.id), dtype=bool)
    best_in_views(offers.row, offers.id, offers.saved, cluster, end, shown)
    return shown


def least(offers: Offers, *, cluster: np.ndarray, end: np.ndarray, need: np.ndarray) -> np.ndarray:
    """Return (S,) b1: the fewest offers of each view that save what it needs; of those, the ones that save most.

    need  (V,) i64, cost of each view minus its target; within reach of the offers
    """
    shown = np.empty(len(offers.id), dtype=bool)
    missed = _least_in_views(offers.row, offers.id, offers.saved, cluster, end, need, shown)
    assert missed < 0, f"problem view {missed} cannot save what it needs with the chosen impostors"
    return shown
