"""What views hold of a set that changes, and their best antichains: the data of `improve`, and how to read it.

Layout  The chosen offers of a view are a sorted list of places in the view's run of all offers; places ascend with the
        cluster, so a list is in preorder, as `antichain` needs it. What a further impostor would add to a view's best
        antichain is read off the tree of its list: what the impostor saves beyond the best below it, less what each
        enclosing impostor saves beyond the best below that.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from farfield.viewspace.kernels import first_at_least

N_CHOSEN, MOVES, WORK, BYTES = 0, 1, 2, 3  # places in `Held.counter`


class Core(NamedTuple):
    """N candidates and what they save in V views; only views that need something have entries."""

    cluster: np.ndarray  # (N,) i32  ascending
    bytes: np.ndarray  # (N,) i64
    row: np.ndarray  # (N+1,) i64
    views: np.ndarray  # (E,) i32
    place: np.ndarray  # (E,) i64  of the entry among the offers
    offer_row: np.ndarray  # (V+1,) i64
    offer_id: np.ndarray  # (E,) i32  ascending in a view
    offer_saved: np.ndarray  # (E,) i64  at most the view's need
    need: np.ndarray  # (V,) i64
    weight: np.ndarray  # (V,) f64  what a unit of need is worth
    end: np.ndarray  # (C,) i32


class Held(NamedTuple):
    """What is chosen."""

    places: np.ndarray  # (V,W) i64  each view's chosen offers, ascending, and ...
    length: np.ndarray  # (V,) i64  ... how many
    chosen: np.ndarray  # (N,) i32  the first counter[N_CHOSEN], in no order
    slot: np.ndarray  # (N,) i32  place in `chosen`, or -1
    witness: np.ndarray  # (N,) i32  a view that could not do without it when last asked, or -1
    best: np.ndarray  # (V,) i64  what each view's best antichain saves, between moves
    low: np.ndarray  # (V,) i64  at most that, within a move: most views are not looked at again
    counter: np.ndarray  # (4,) i64
    random: np.ndarray  # (1,) u64


class Trees(NamedTuple):
    """By lacking view and place in its list: node, best of the subtree, that less the best below, enclosing place or -1."""

    node: np.ndarray
    best: np.ndarray
    slack: np.ndarray
    up: np.ndarray
    stack: np.ndarray  # (W,) i64
    total: np.ndarray  # (W,) i64


@njit(cache=True)
def transpose(row, view, saved, need):
    """Return (row, views, place, offer_row, offer_id, offer_saved) of a Core."""
    count, core_row = np.zeros(len(need) + 1, np.int64), np.zeros(len(row), np.int64)
    for i in range(len(row) - 1):
        core_row[i + 1] = core_row[i]
        for e in range(row[i], row[i + 1]):
            if need[view[e]] > 0:
                count[view[e] + 1] += 1
                core_row[i + 1] += 1
    offer_row, n = np.cumsum(count), core_row[-1]
    fill, k = offer_row[:-1].copy(), 0
    offer_id, offer_saved = np.empty(n, np.int32), np.empty(n, np.int64)
    views, place = np.empty(n, np.int32), np.empty(n, np.int64)
    for i in range(len(row) - 1):
        for e in range(row[i], row[i + 1]):
            v = view[e]
            if need[v] > 0:
                offer_id[fill[v]], offer_saved[fill[v]] = i, min(saved[e], need[v])
                views[k], place[k] = v, fill[v]
                fill[v] += 1
                k += 1
    return core_row, views, place, offer_row, offer_id, offer_saved


@njit(cache=True)
def insert(i, core, held):
    """Put i into the lists of its views."""
    for e in range(core.row[i], core.row[i + 1]):
        v, p = core.views[e], core.place[e]
        places, n = held.places[v], held.length[v]
        at = first_at_least(places, 0, n, p)
        for k in range(n, at, -1):
            places[k] = places[k - 1]
        places[at] = p
        held.length[v] = n + 1
    held.counter[WORK] += core.row[i + 1] - core.row[i]


@njit(cache=True)
def take_out(i, core, held):
    for e in range(core.row[i], core.row[i + 1]):
        v = core.views[e]
        places, n = held.places[v], held.length[v]
        for k in range(first_at_least(places, 0, n, core.place[e]), n - 1):
            places[k] = places[k + 1]
        held.length[v] = n - 1
    held.counter[WORK] += core.row[i + 1] - core.row[i]


@njit(cache=True)
def lower(i, core, held):
    """Note that views lose i, and with it at most what it saves."""
    for e in range(core.row[i], core.row[i + 1]):
        held.low[core.views[e]] -= core.offer_saved[core.place[e]]


@njit(cache=True)
def look_again(i, core, held, trees):
    """Find the best antichains of i's views."""
    for e in range(core.row[i], core.row[i + 1]):
        v = core.views[e]
        held.best[v] = held.low[v] = saved_by_best(v, -1, core, held, trees)


@njit(cache=True)
def forget(i, core, held):
    """Note that i's views are as they were before the move."""
    for e in range(core.row[i], core.row[i + 1]):
        held.low[core.views[e]] = held.best[core.views[e]]


@njit(cache=True)
def room_for(i, core, held):
    longest = 0
    for e in range(core.row[i], core.row[i + 1]):
        longest = max(longest, held.length[core.views[e]])
    return longest < held.places.shape[1]


@njit(cache=True)
def saved_by_best(v, without, core, held, trees):
    """Return what the best antichain of view v's list saves, one candidate (or -1: none) left out."""
    places, top = held.places[v], 0
    stack, total = trees.stack, trees.total
    for k in range(held.length[v] - 1, -1, -1):
        if core.offer_id[places[k]] == without:
            continue
        node, below = core.cluster[core.offer_id[places[k]]], np.int64(0)
        while top > 0 and stack[top - 1] < core.end[node]:
            top -= 1
            below += total[top]
        stack[top], total[top] = node, max(core.offer_saved[places[k]], below)
        top += 1
    held.counter[WORK] += held.length[v]
    best = np.int64(0)
    for k in range(top):
        best += total[k]
    return best


@njit(cache=True)
def build_tree(v, a, core, held, trees):
    """Make view v's list the a-th tree and return what its best antichain saves."""
    places, top = held.places[v], 0
    node, best, slack, up, stack = trees.node[a], trees.best[a], trees.slack[a], trees.up[a], trees.stack
    for k in range(held.length[v] - 1, -1, -1):
        node[k], below = core.cluster[core.offer_id[places[k]]], np.int64(0)
        while top > 0 and node[stack[top - 1]] < core.end[node[k]]:
            top -= 1
            below += best[stack[top]]
            up[stack[top]] = k
        best[k] = max(core.offer_saved[places[k]], below)
        slack[k] = best[k] - below
        stack[top] = k
        top += 1
    held.counter[WORK] += held.length[v]
    total = np.int64(0)
    for k in range(top):
        total += best[stack[k]]
        up[stack[k]] = -1
    return total


@njit(cache=True)
def added_by(node, saved, a, n, end, trees):
    """Return what an impostor of `node` would add to the best antichain of the a-th tree, a list of n."""
    nodes, up = trees.node[a], trees.up[a]
    first = first_at_least(nodes, 0, n, node)
    k = first
    while k < n and nodes[k] < end[node]:
        saved -= trees.best[a, k]
        if saved <= 0:
            return np.int64(0)
        stop = end[nodes[k]]
        k += 1
        while k < n and nodes[k] < stop:
            k += 1
    k = first - 1
    while k >= 0 and end[nodes[k]] <= node:
        k = up[k]
    while k >= 0 and saved > 0:
        saved -= trees.slack[a, k]
        k = up[k]
    return max(np.int64(0), saved)
