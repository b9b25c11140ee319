"""The moves of `improve`: take some impostors out, mend what then lacks, keep the lighter set.

Work    is counted in entries looked at, so that a limit on it ends a search where it would end on any machine.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from farfield.placement.held_kernels import (
    BYTES,
    MOVES,
    N_CHOSEN,
    WORK,
    added_by,
    build_tree,
    forget,
    insert,
    look_again,
    lower,
    room_for,
    saved_by_best,
    take_out,
)  # fmt: skip

MOST_OUT, MOST_IN, MOST_LACKING = 64, 512, 2048  # of a move; a larger one is given up
MOST_TAKEN = 8  # impostors that a move takes out to begin with
SPREAD = 0.6  # scores of a move are off by a factor in 1 +- SPREAD / 2, so that moves at one place differ
SCORED_BY = 48  # lacking views that candidates are scored by
TOO_HEAVY = 4  # a move is given up that adds more than what it took out and a quarter


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
        take_out(move.out[k], core, held)
        lower(move.out[k], core, held)
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
        if i < 0 or n_in == MOST_IN or not room_for(i, core, held):
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
    take_out(i, core, held)
    lower(i, core, held)
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
            take_out(move.into[k], core, held)
        for k in range(n_put):
            forget(move.into[k], core, held)
        for k in range(n_out):
            insert(move.out[k], core, held)
            forget(move.out[k], core, held)
