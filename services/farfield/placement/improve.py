"""Ruin and recreate: a lighter set of impostors, near the one that greedy, rescue and reverse delete found.

Problem  The greedy never takes back a choice, and the reverse delete only takes away. Find a lighter set under which
         every view still reaches its target.
Method   Over and over: take out a few impostors that some view shows side by side. The views that lack something then get
         the best gain per byte, where a gain is what an impostor adds to the *best* antichain of the set (not to what was
         drawn when it was chosen), weighed by the price of the view: what the present impostors' bytes come to for a unit
         of cost saved there. Drop what became superfluous, and keep the new set unless it is heavier. Every step ends
         with all targets met. Only candidates count that earn CORE of their bytes at those prices.
Ends     after so many moves an impostor, or so much work, counted in entries looked at and not in seconds. Where more
         than MOST_ENTRIES pairs of candidate and view count, only the reverse delete is done.
Tried    Placed bytes without and with it: towns of 400 houses 789 and 776, 5,519 and 5,418 MB, one of 1,600 houses 111.3
         and 111.1, the cut-out of the demo city 1,128 and 1,108. With ten times the work 753 MB instead of 776. The whole
         demo city (57.6 M entries): 0.1 % for 69 s. Greedy among candidates at the bound's prices: 1 % less to 5 % more.
After    Schrimpf, Schneider, Stamm-Wilbrandt, Dueck. Record Breaking Optimization Results Using the Ruin and Recreate
         Principle. J. Comp. Phys. 159, 2000.
"""

from collections.abc import Callable

import numpy as np
from numba import njit

from farfield.candidates.model import Candidates
from farfield.placement import held_kernels
from farfield.placement import improve_kernels as kernels
from farfield.placement.antichain import Offers, offers_of
from farfield.placement.bound import by_impostor, first_prices
from farfield.placement.held_kernels import Core, Held, Trees
from farfield.placement.improve_kernels import Move
from farfield.placement.prune import prune

CORE = 0.7
MOVES_AN_IMPOSTOR, LEAST_MOVES = 8, 2000
WORK_AN_ENTRY, MOST_ENTRIES = 250, 4_000_000  # 250 an entry: some 5 s a million
SLICE = 20_000_000  # work between two looks at the clock


def improve(
    candidates: Candidates, chosen: np.ndarray, *, need: np.ndarray, end: np.ndarray, seed: int = 0,
    moves: int = MOVES_AN_IMPOSTOR, stop: Callable[[], bool] = lambda: False,
) -> np.ndarray:  # fmt: skip
    """Return candidates (J,) i32, ascending, each of them indispensable, that weigh no more than `chosen`.

    chosen  (I,) i32 candidates, ascending, with which every view can save what it needs
    need    (V,) i64 cost of each view minus its target
    end     (C,) i32, see `antichain.subtree_end`
    moves   how many to try, times the number of impostors (LEAST_MOVES at least); 0: none
    stop    asked now and then: True ends the search, and the reverse delete after it
    """
    chosen = _pruned(candidates, chosen, need, end, stop)
    if not len(chosen) or not moves:
        return chosen
    offers = _offers(candidates, chosen, len(need))
    needed = np.maximum(need, 0)
    price = first_prices(*by_impostor(offers, len(chosen)), candidates.bytes[chosen], needed) / np.maximum(needed, 1)
    part = _earned(candidates.row, candidates.view, candidates.saved, price, needed) >= CORE * candidates.bytes
    part[chosen] = True
    if (np.diff(candidates.row)[part]).sum() > MOST_ENTRIES:
        return chosen
    core = _core(candidates, np.flatnonzero(part), price, needed, end)
    position = (np.cumsum(part) - 1)[chosen]
    held = _held(core, position.astype(np.int32), seed)
    trees, move = _scratch(core, held)
    for i in position:
        held_kernels.look_again(i, core, held, trees)
    held.counter[held_kernels.WORK] = 0
    wanted, work = max(moves * len(chosen), LEAST_MOVES), 0
    most = WORK_AN_ENTRY * len(core.views) + SLICE
    while held.counter[held_kernels.MOVES] < wanted and work < most and len(position) and not stop():
        work = min(most, work + SLICE)
        kernels.search(core, held, trees, move, wanted, work)
    found = np.flatnonzero(part)[np.sort(held.chosen[: held.counter[held_kernels.N_CHOSEN]])].astype(np.int32)
    found = _pruned(candidates, found, need, end, stop)
    return found if candidates.bytes[found].sum() < candidates.bytes[chosen].sum() else chosen  # ties: as it was


@njit(cache=True)
def _earned(row: np.ndarray, view: np.ndarray, saved: np.ndarray, price: np.ndarray, need: np.ndarray) -> np.ndarray:
    """Return (N,) f64: sum over views of price * min(saved, need)."""
    earned = np.zeros(len(row) - 1)
    for i in range(len(earned)):
        for e in range(row[i], row[i + 1]):
            earned[i] += price[view[e]] * min(saved[e], need[view[e]])
    return earned


def _offers(candidates: Candidates, chosen: np.ndarray, n_views: int) -> Offers:
    everywhere = np.ones(n_views, dtype=bool)
    row, id, saved = offers_of(chosen, candidates.row, candidates.view, candidates.saved, everywhere)
    return Offers(row=row, id=id, saved=saved)


def _pruned(
    candidates: Candidates, chosen: np.ndarray, need: np.ndarray, end: np.ndarray, stop: Callable[[], bool]
) -> np.ndarray:
    offers, cluster = _offers(candidates, chosen, len(need)), candidates.cluster[chosen]
    return chosen[prune(offers, cluster=cluster, bytes=candidates.bytes[chosen], need=need, end=end, stop=stop)]


def _core(candidates: Candidates, part: np.ndarray, price: np.ndarray, need: np.ndarray, end: np.ndarray) -> Core:
    first, count = candidates.row[part], candidates.row[part + 1] - candidates.row[part]
    row = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    entry = np.repeat(first - row[:-1], count) + np.arange(row[-1])
    core_row, views, place, offer_row, offer_id, offer_saved = held_kernels.transpose(
        row, candidates.view[entry], candidates.saved[entry], need
    )
    least = 0.05 * price[need > 0].mean() if (need > 0).any() else 0.0  # no need is worth nothing
    return Core(
        candidates.cluster[part], candidates.bytes[part], core_row, views, place, offer_row, offer_id, offer_saved, need,
        price + least, end,
    )  # fmt: skip


def _held(core: Core, chosen: np.ndarray, seed: int) -> Held:
    """Return the start: `chosen` (I,) i32 of the core."""
    n, n_views = len(core.bytes), len(core.need)
    slot = np.full(n, -1, np.int32)
    slot[chosen] = np.arange(len(chosen))
    listed = np.zeros(n_views, np.int64)
    for i in chosen:
        listed[core.views[core.row[i] : core.row[i + 1]]] += 1
    all = np.empty(n, np.int32)
    all[: len(chosen)] = chosen
    held = Held(
        places=np.empty((n_views, 2 * int(listed.max(initial=0)) + 32), np.int64), length=np.zeros(n_views, np.int64),
        chosen=all, slot=slot, witness=np.full(n, -1, np.int32),
        best=np.zeros(n_views, np.int64), low=np.zeros(n_views, np.int64),
        counter=np.array([len(chosen), 0, 0, core.bytes[chosen].sum()], np.int64),
        random=np.array([88172645463325252 ^ (seed * 0x9E3779B97F4A7C15) % 2**64 or 1], np.uint64),
    )  # fmt: skip
    for i in chosen:
        held_kernels.insert(i, core, held)
    return held


def _scratch(core: Core, held: Held) -> tuple[Trees, Move]:
    n, n_views, widest = len(core.bytes), len(core.need), held.places.shape[1]
    shape = (kernels.MOST_LACKING, widest)
    trees = Trees(
        node=np.empty(shape, np.int32), best=np.empty(shape, np.int64), slack=np.empty(shape, np.int64),
        up=np.empty(shape, np.int32), stack=np.empty(widest, np.int64), total=np.empty(widest, np.int64),
    )  # fmt: skip
    move = Move(
        out=np.empty(kernels.MOST_OUT, np.int32), into=np.empty(kernels.MOST_IN, np.int32),
        lacking=np.empty(kernels.MOST_LACKING, np.int32), deficit=np.empty(kernels.MOST_LACKING, np.int64),
        where=np.full(n_views, -1, np.int32), seen=np.full(n_views, -1, np.int64), pool=np.empty(n, np.int32),
        scored=np.full(n, -1, np.int64), banned=np.full(n, -1, np.int64), score=np.zeros(n),
    )  # fmt: skip
    return trees, move
