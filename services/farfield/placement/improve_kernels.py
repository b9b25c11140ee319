"""The moves of `improve`: take some impostors out, mend what then lacks, keep the lighter set.

Layout  The chosen offers of a view are a sorted list of places in the view's run of all offers; places ascend with the
        cluster, so a list is in preorder, as `antichain` needs it. What a further impostor would add to a view's best
        antichain is read off the tree of its list: what the impostor saves beyond the best below it, less what each
        enclosing impostor saves beyond the best below that.
Work    is counted in entries looked at, so that a limit on it ends a search where it would end on any machine.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from farfield.viewspace.kernels import first_at_least

N_CHOSEN, MOVES, WORK, BYTES = 0, 1, 2, 3  # places in `Held.counter`
MOST_OUT, MOST_IN, MOST_LACKING = 64, 512, 2048  # of a move; a larger one is given up
MOST_TAKEN = 8  # impostors that a move takes out to begin with
SPREAD = 0.6  # scores of a move are off by a factor in 1 +- SPREAD / 2, so that moves at one place differ
SCORED_BY = 48  # lacking views that candidates are scored by
TOO_HEAVY = 4  # a move is given up that adds more than what it took out and a quarter


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


class Move(NamedTuple):
    """What a move takes out and puts in; scratch."""

    out: np.ndarray  # (MOST_OUT,) i32
    into: np.ndarray  # (MOST_IN,) i32
    lacking: np.ndarray  # (MOST_LACKING,) i32  views
    deficit: np.ndarray  # (MOST_LACKING,) i64
    where: np.ndarray  # (V,) i32  place in `lacking`, or -1
    seen: np.ndarray  # (V,) i64  number of the move that looked at the view last
    pool: np.ndarray  # (N,) i32  candidates that help a lacking view
    scored: np.ndarray  # (N,) i64  the choice that scored it last
    banned: np.ndarray  # (N,) i64  number of the move that must not choose it
    score: np.ndarray  # (N,) f64


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
def _random(held):
    """Return the next of [0, 1): xorshift64 [Marsaglia 2003]."""
    x = held.random[0]
    x ^= x << np.uint64(13)
    x ^= x >> np.uint64(7)
    x ^= x << np.uint64(17)
    held.random[0] = x
    return float(x >> np.uint64(11)) / 9007199254740992.0


@njit(cache=True)
def _below(held, n):
    return int(_random(held) * n)


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
def _take_out(i, core, held):
    for e in range(core.row[i], core.row[i + 1]):
        v = core.views[e]
        places, n = held.places[v], held.length[v]
        for k in range(first_at_least(places, 0, n, core.place[e]), n - 1):
            places[k] = places[k + 1]
        held.length[v] = n - 1
    held.counter[WORK] += core.row[i + 1] - core.row[i]


@njit(cache=True)
def _lower(i, core, held):
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
def _forget(i, core, held):
    """Note that i's views are as they were before the move."""
    for e in range(core.row[i], core.row[i + 1]):
        held.low[core.views[e]] = held.best[core.views[e]]


@njit(cache=True)
def _room_for(i, core, held):
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


@njit(cache=True)
def _ruin(core, held, move):
    """Take out neighbours in the list of a random view of a random impostor, or others of that view; return how many."""
    seed = held.chosen[_below(held, held.counter[N_CHOSEN])]
    first, last = core.row[seed], core.row[seed + 1]
    v = core.views[first + _below(held, last - first)]
    n, wanted = held.length[v], 1 + _below(held, MOST_TAKEN)
    taken = 0
    if _random(held) < 0.5:
        at = 0
        while core.offer_id[held.places[v, at]] != seed:
            at += 1
        low = max(0, at - _below(held, wanted))
        for k in range(low, min(n, low + wanted)):
            move.out[taken] = core.offer_id[held.places[v, k]]
            taken += 1
    else:
        move.out[0], taken = seed, 1
        for _ in range(wanted - 1):
            other, again = core.offer_id[held.places[v, _below(held, n)]], False
            for k in range(taken):
                again |= move.out[k] == other
            if not again:
                move.out[taken] = other
                taken += 1
    for k in range(taken):
        _take_out(move.out[k], core, held)
        _lower(move.out[k], core, held)
    if _random(held) < 0.5:
        move.banned[move.out[_below(held, taken)]] = held.counter[MOVES]
    return taken


@njit(cache=True)
def _find_lacking(n_out, core, held, trees, move):
    """List the views that miss their need now; return how many, or -1 for too many."""
    n = 0
    for k in range(n_out):
        for e in range(core.row[move.out[k]], core.row[move.out[k] + 1]):
            v = core.views[e]
            if move.seen[v] == held.counter[MOVES] or held.low[v] >= core.need[v]:
                continue
            move.seen[v] = held.counter[MOVES]
            held.low[v] = saved_by_best(v, -1, core, held, trees)
            if held.low[v] < core.need[v]:
                if n == MOST_LACKING:
                    return -1
                move.lacking[n] = v
                n += 1
    for a in range(n):
        move.where[move.lacking[a]] = a
    return n


@njit(cache=True)
def _best_for(n_lacking, still, n_in, core, held, trees, move):
    """Return the candidate that helps best, or -1; by SCORED_BY views of the `still` that lack something, spread evenly."""
    number, round, pooled, owed = held.counter[MOVES], held.counter[MOVES] * (MOST_IN + 1) + n_in, 0, 0
    for a in range(n_lacking):
        if move.deficit[a] <= 0:
            continue
        owed += SCORED_BY
        if owed < still and still > SCORED_BY:
            continue
        owed -= still
        v = move.lacking[a]
        held.counter[WORK] += core.offer_row[v + 1] - core.offer_row[v]
        for p in range(core.offer_row[v], core.offer_row[v + 1]):
            i = core.offer_id[p]
            if move.banned[i] == number:
                continue
            more = added_by(core.cluster[i], core.offer_saved[p], a, held.length[v], core.end, trees)
            if more == 0:
                continue
            if move.scored[i] != round:
                move.scored[i], move.score[i] = round, 0.0
                move.pool[pooled] = i
                pooled += 1
            move.score[i] += core.weight[v] * min(move.deficit[a], more)
    best, most = -1, 0.0
    for k in range(pooled):
        i = move.pool[k]
        score = move.score[i] * (1 + SPREAD * (_random(held) - 0.5)) / core.bytes[i]
        if score > most:
            best, most = i, score
    return best


@njit(cache=True)
def _mend(n_lacking, bytes_out, core, held, trees, move):
    """Put in what lacking views need, best gain per byte first; return (how many, whether every need is met)."""
    n_in, bytes_in, still = 0, np.int64(0), n_lacking
    for a in range(n_lacking):
        move.deficit[a] = core.need[move.lacking[a]] - build_tree(move.lacking[a], a, core, held, trees)
    while still > 0:
        i = _best_for(n_lacking, still, n_in, core, held, trees, move)
        if i < 0 or n_in == MOST_IN or not _room_for(i, core, held):
            return n_in, False
        bytes_in += core.bytes[i]
        if bytes_in > bytes_out + bytes_out // TOO_HEAVY:
            return n_in, False
        insert(i, core, held)
        move.into[n_in] = i
        n_in += 1
        for e in range(core.row[i], core.row[i + 1]):
            v = core.views[e]
            a = move.where[v]
            if a >= 0 and move.deficit[a] > 0:
                held.low[v] = build_tree(v, a, core, held, trees)
                move.deficit[a] = core.need[v] - held.low[v]
                still -= move.deficit[a] <= 0
    return n_in, True


@njit(cache=True)
def _can_go(i, core, held, trees):
    """Take i out if every view still meets its need; return whether."""
    v = held.witness[i]
    if v >= 0 and saved_by_best(v, i, core, held, trees) < core.need[v]:
        return False
    for e in range(core.row[i], core.row[i + 1]):
        v = core.views[e]
        if held.low[v] - core.offer_saved[core.place[e]] >= core.need[v]:
            continue
        if saved_by_best(v, i, core, held, trees) < core.need[v]:
            held.witness[i] = v
            return False
    held.counter[WORK] += core.row[i + 1] - core.row[i]
    _take_out(i, core, held)
    _lower(i, core, held)
    return True


@njit(cache=True)
def _discard(n_out, n_in, n_lacking, core, held, trees, move):
    """Take out what is superfluous: of what was put in, the heaviest first, then of a lacking view's list.

    Return (how many are out, how many of `into` are still in: those come first).
    """
    into, out = move.into, move.out
    for k in range(1, n_in):
        i, at = into[k], k
        while at > 0 and core.bytes[into[at - 1]] < core.bytes[i]:
            into[at] = into[at - 1]
            at -= 1
        into[at] = i
    kept = 0
    for k in range(n_in):
        if not _can_go(into[k], core, held, trees):
            into[kept], into[k] = into[k], into[kept]
            kept += 1
    if n_lacking > 0:
        v = move.lacking[_below(held, n_lacking)]
        k = 0
        while k < held.length[v] and n_out < MOST_OUT:
            i = core.offer_id[held.places[v, k]]
            if held.slot[i] >= 0 and _can_go(i, core, held, trees):
                again = False  # taken out and put in again: then it is in `into` and in `out`
                for j in range(kept):
                    if into[j] == i:
                        kept, again = kept - 1, True
                        into[j], into[kept] = into[kept], into[j]
                        break
                if not again:
                    out[n_out] = i
                    n_out += 1
            else:
                k += 1
    return n_out, kept


@njit(cache=True)
def _settle(n_out, n_in, core, held, move):
    for k in range(n_out):
        i = move.out[k]
        held.counter[N_CHOSEN] -= 1
        at, last = held.slot[i], held.chosen[held.counter[N_CHOSEN]]
        held.chosen[at], held.slot[last] = last, at
        held.slot[i] = -1
        held.counter[BYTES] -= core.bytes[i]
    for k in range(n_in):
        i = move.into[k]
        held.slot[i], held.chosen[held.counter[N_CHOSEN]] = held.counter[N_CHOSEN], i
        held.counter[N_CHOSEN] += 1
        held.counter[BYTES] += core.bytes[i]


@njit(cache=True)
def search(core, held, trees, move, moves, work):
    """Try moves until so many were made, or so much work done, in all; a set that is not heavier replaces the old one."""
    while held.counter[MOVES] < moves and held.counter[WORK] < work and held.counter[N_CHOSEN] > 0:
        held.counter[MOVES] += 1
        held.counter[WORK] += 200
        n_out, n_in, n_put, met = _ruin(core, held, move), 0, 0, False
        bytes_out = np.int64(0)
        for k in range(n_out):
            bytes_out += core.bytes[move.out[k]]
        n_lacking = _find_lacking(n_out, core, held, trees, move)
        if n_lacking >= 0:
            n_in, met = _mend(n_lacking, bytes_out, core, held, trees, move)
        n_put = n_in
        if met:
            n_out, n_in = _discard(n_out, n_in, n_lacking, core, held, trees, move)
        for a in range(n_lacking):
            move.where[move.lacking[a]] = -1
        change = np.int64(0)
        for k in range(n_in):
            change += core.bytes[move.into[k]]
        for k in range(n_out):
            change -= core.bytes[move.out[k]]
        if met and change <= 0:
            _settle(n_out, n_in, core, held, move)
            for k in range(n_put):
                look_again(move.into[k], core, held, trees)
            for k in range(n_out):
                look_again(move.out[k], core, held, trees)
            continue
        for k in range(n_in):
            _take_out(move.into[k], core, held)
        for k in range(n_put):
            _forget(move.into[k], core, held)
        for k in range(n_out):
            insert(move.out[k], core, held)
            _forget(move.out[k], core, held)
