"""Best antichains: which nested impostors a view shows to cost least.

Problem  A view is offered impostors of clusters; two may be shown together only if neither cluster holds the other.
         Each takes a weight (what it saves) off the view's cost. Find the antichain with the largest sum.
Method   A cluster is its node in preorder, its subtree the nodes [node, end). Visit the offers from last to first with
         a stack of finished subtrees: best(node) = max(own weight, sum of best below). Only offered clusters are
         touched. Ties go to the coarser cluster (fewer impostors), among offers of one cluster to the lower id.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit


@dataclass(frozen=True, slots=True, kw_only=True)
class Offers:
    """What V views are offered: entries [row[v], row[v+1]), ascending by id; ids ascend with the cluster."""

    row: np.ndarray  # (V+1,) i64
    id: np.ndarray  # (S,) i32  candidate, or position among the chosen ones
    saved: np.ndarray  # (S,) i64  what it takes off the view's cost when it replaces geometry, > 0


@njit(cache=True)
def best_antichain(
    node: np.ndarray,
    weight: np.ndarray,
    end: np.ndarray,
    take: np.ndarray,
    stack_node: np.ndarray,
    stack_sum: np.ndarray,
) -> np.int64:
    """Mark in `take` (k,) b1 the best antichain of the offers and return the sum of its weights.

    node       (k,) i32, ascending, repetitions allowed
    weight     (k,) i64; offers of weight <= 0 are never taken
    end        (C,) i32, by node: the first node after its subtree
    stack_*    scratch, i32 and i64, at least k long
    """
    top = 0
    for k in range(len(node) - 1, -1, -1):
        stop = end[node[k]]
        below = np.int64(0)
        while top > 0 and stack_node[top - 1] < stop:
            top -= 1
            below += stack_sum[top]
        own = weight[k]
        take[k] = own > 0 and own >= below
        stack_node[top] = node[k]
        stack_sum[top] = own if take[k] else below
        top += 1
    total = np.int64(0)
    for k in range(top):
        total += stack_sum[k]
    covered = 0
    for k in range(len(node)):
        if take[k]:
            if node[k] < covered:
                take[k] = False
            else:
                covered = end[node[k]]
    return total


@njit(cache=True)
def best_in_views(
    row: np.ndarray, id: np.ndarray, saved: np.ndarray, cluster: np.ndarray, end: np.ndarray, take: np.ndarray
) -> np.ndarray:
    """Mark each view's best antichain in `take` (S,) b1 and return what it saves (V,) i64."""
    n_views = len(row) - 1
    widest = 0
    for v in range(n_views):
        widest = max(widest, row[v + 1] - row[v])
    node, stack_node = np.empty(widest, np.int32), np.empty(widest, np.int32)
    stack_sum = np.empty(widest, np.int64)
    best = np.zeros(n_views, np.int64)
    for v in range(n_views):
        low, high = row[v], row[v + 1]
        for e in range(low, high):
            node[e - low] = cluster[id[e]]
        best[v] = best_antichain(node[: high - low], saved[low:high], end, take[low:high], stack_node, stack_sum)
    return best


@njit(cache=True)
def cheapest_offers(
    cluster: np.ndarray, row: np.ndarray, view: np.ndarray, saved: np.ndarray, n_views: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (row, id, saved) of what all candidates offer to views, of each cluster only the one that saves most.

    Candidates must be sorted by cluster. One column per (view, cluster) instead of one per (view, candidate): a best
    antichain needs no more, and the transposition is several times smaller.
    """
    stamp = np.full(n_views, -1, np.int32)
    count = np.zeros(n_views + 1, np.int64)
    for i in range(len(cluster)):
        for e in range(row[i], row[i + 1]):
            v = view[e]
            if stamp[v] != cluster[i]:
                stamp[v] = cluster[i]
                count[v + 1] += 1
    offer_row = np.cumsum(count)
    offer_id = np.empty(offer_row[-1], np.int32)
    offer_saved = np.empty(offer_row[-1], np.int64)
    fill = offer_row[:-1].copy()
    stamp[:] = -1
    for i in range(len(cluster)):
        for e in range(row[i], row[i + 1]):
            v = view[e]
            if stamp[v] != cluster[i]:
                stamp[v] = cluster[i]
                offer_id[fill[v]] = i
                offer_saved[fill[v]] = saved[e]
                fill[v] += 1
            elif saved[e] > offer_saved[fill[v] - 1]:
                offer_id[fill[v] - 1] = i
                offer_saved[fill[v] - 1] = saved[e]
    return offer_row, offer_id, offer_saved


@njit(cache=True)
def offers_of(
    chosen: np.ndarray, row: np.ndarray, view: np.ndarray, saved: np.ndarray, wanted: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (row, id, saved) of what candidates `chosen` (I,), ascending, offer to `wanted` (V,) b1 views.

    id is the position in `chosen`.
    """
    n_views = len(wanted)
    count = np.zeros(n_views + 1, np.int64)
    for s in range(len(chosen)):
        for e in range(row[chosen[s]], row[chosen[s] + 1]):
            if wanted[view[e]]:
                count[view[e] + 1] += 1
    offer_row = np.cumsum(count)
    offer_id = np.empty(offer_row[-1], np.int32)
    offer_saved = np.empty(offer_row[-1], np.int64)
    fill = offer_row[:-1].copy()
    for s in range(len(chosen)):
        for e in range(row[chosen[s]], row[chosen[s] + 1]):
            v = view[e]
            if wanted[v]:
                offer_id[fill[v]] = s
                offer_saved[fill[v]] = saved[e]
                fill[v] += 1
    return offer_row, offer_id, offer_saved


def subtree_end(start: np.ndarray, stop: np.ndarray) -> np.ndarray:
    """Return (C,) i32: the first node after each node's subtree. A cluster of n objects has 2 n - 1 nodes."""
    node = np.arange(len(start), dtype=np.int64)
    return (node + 2 * (stop.astype(np.int64) - start) - 1).astype(np.int32)
