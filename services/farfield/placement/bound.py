"""A lower bound on the bytes of any placement: how far from the lightest can the chosen one be?

Problem  No choice of these candidates meets every target with fewer bytes than ... how many?
Method   Lagrangian duality. Price each view's need: price[v] >= 0 a unit of cost saved. Split each candidate's bytes over
         the views it serves: share[i, v] >= 0 with sum at most bytes[i]. In a view that meets its target the antichain
         shown saves need[v] or more, with g = min(saved, need[v]); hence for any prices and shares

             bytes of any placement >= sum_v (price[v] need[v] - max over antichains of sum (price[v] g[i, v] - share[i, v]))

         For given shares each view's best price is found exactly (`bound_kernels.pay`), and with it how much of each offer
         the view would take. Shares follow by multiplicative weights in ever smaller steps: an offer gets dearer in views
         that take it and cheaper in the candidate's other views. Small problems take prices and shares from the
         linear programme instead, whose dual this is (`bound_lp`); for a whole city there is `bound_many`.
         In the end prices are made integers of 2**-shift byte and shares are rounded down, and the bound is computed
         over all candidates: proven, not approximate, wherever the prices came from.
Tried    Towns of 400 houses at 100 calls, generated candidates; MB. 1000 passes take 3 s and 15 s, the programme 22 s:

             view space, entries   before   60 passes   200   1000   linear programme
             32 m,  62 k              164         163   174    177   178
             40 m, 291 k              235         254   271    276   not tried

         Before: 60 passes in which prices moved by a factor and shares shrank where they were not taken. Block-wise ascent,
         view after view, releasing what a view does not use (as in message passing): stuck at 127 of 178. Additive steps
         (Polyak): 156 after 60 passes. First steps of 3 and 30 instead of 10, momentum of 0, 0.8 and 0.9: 1 % less;
         20 is taken, since large problems are granted few passes and gain by larger steps.
         Without antichains (nested ones of a view counted together) a fifth less. Views as whole numbers, their knapsack by
         dynamic programming over 64 quanta of the need: 0.3 to 0.7 % more on small towns, at five times the time.
After    Arora, Hazan, Kale. The Multiplicative Weights Update Method. Theory of Computing 8, 2012.
"""

from typing import NamedTuple

import numpy as np

from farfield.candidates.model import Candidates
from farfield.hierarchy.model import Hierarchy
from farfield.placement import bound_kernels as kernels
from farfield.placement.antichain import Offers, subtree_end
from farfield.placement.bound_kernels import Offered, Tree
from farfield.placement.bound_lp import FEW_ENTRIES, MOST_ENTRIES, dual_prices
from farfield.placement.bound_many import lower_bound
from farfield.placement.model import Bound, Placement
from farfield.placement.repair import offers_in_cell
from farfield.placement.tighten import Impostors
from farfield.viewspace.model import ProblemViews

FIRST_STEP, LAST_STEP, MOMENTUM = 20.0, 0.1, 0.5
WORK, LEAST_PASSES, MOST_PASSES = 300_000_000, 100, 600  # entries looked at in all: some 50 ns each
MANY_ENTRIES = 6_000_000  # beyond that, `bound_many`
BITS = 60  # prices are scaled so that all needs together cost less than 2**BITS


class _Choices(NamedTuple):
    """N candidates and placed impostors, in two lists of entries: copying them into one would take gigabytes on a city."""

    lists: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]  # (row, view, saved), as in Candidates
    ids: tuple[slice, slice]  # of each list
    entries: tuple[slice, slice]
    cluster: np.ndarray  # (N,) i32
    bytes: np.ndarray  # (N,) i64
    need: np.ndarray  # (V,) i64 >= 0
    end: np.ndarray  # (C,) i32


def lower_bound_bytes(
    candidates: Candidates, impostors: Impostors, offers: Offers, *, need: np.ndarray, end: np.ndarray,
    method: str = "auto", passes: int | None = None,
) -> int:  # fmt: skip
    """Return bytes that no choice from candidates and impostors together can stay below and meet every target.

    impostors, offers  of the placement: tightened ones weigh less than any candidate, and their bytes give first prices
    need               (V,) i64 cost of each view minus its target
    end                (C,) i32, see `antichain.subtree_end`
    method             "lp", "lagrangian", or "auto": see `uses_lp`
    passes             of the Lagrangian; default: by the number of entries
    """
    return _prove(candidates, impostors, offers, need=need, end=end, method=method, passes=passes)[0]


def _prove(
    candidates: Candidates, impostors: Impostors, offers: Offers, *, need: np.ndarray, end: np.ndarray, method: str,
    passes: int | None,
) -> tuple[int, bool]:  # fmt: skip
    """Return the bound, and whether its prices are those of the linear programme."""
    if not len(impostors.cluster):
        return 0, False
    lists = ((candidates.row, candidates.view, candidates.saved), by_impostor(offers, len(impostors.cluster)))
    n, m = len(candidates.cluster), int(candidates.row[-1])
    c = _Choices(
        lists=lists, ids=(slice(0, n), slice(n, None)), entries=(slice(0, m), slice(m, None)),
        cluster=np.concatenate([candidates.cluster, impostors.cluster]),
        bytes=np.concatenate([candidates.bytes, impostors.bytes]), need=np.maximum(need, 0), end=end,
    )  # fmt: skip
    n_entries = m + len(lists[1][1])
    if uses_lp(method, n_entries):
        row = np.concatenate([lists[0][0], m + lists[1][0][1:]])
        view, saved = (np.concatenate([lists[0][k], lists[1][k]]) for k in (1, 2))
        duals = dual_prices(row, view, saved, cluster=c.cluster, bytes=c.bytes, need=c.need, end=end)
        if duals is not None:
            return _proven(c, *duals), True
    price = first_prices(*lists[1], impostors.bytes, c.need) / np.maximum(c.need, 1)
    if n_entries > MANY_ENTRIES:
        return lower_bound(lists, c.cluster, c.bytes, c.need, end, price), False
    part = np.zeros(n_entries, np.float32)
    _climb(c, price, part, passes)
    return _proven(c, price, part), False


def _climb(c: _Choices, price: np.ndarray, part: np.ndarray, passes: int | None) -> None:
    """Raise what views pay: write to price (V,) f64, bytes for a unit of need, and part (E,) f32 of a candidate's bytes."""
    for one, entries in zip(c.lists, c.entries, strict=True):
        kernels.parts_as_earned(*one, price, c.need, part[entries])
    _learn(c, price, part, passes)


def _learn(c: _Choices, price: np.ndarray, part: np.ndarray, passes: int | None) -> None:
    order = np.argsort(c.cluster, kind="stable")
    offered = Offered(*kernels.offers_of_two(order, *c.lists[0], *c.lists[1], c.need))
    parts = part[offered.entry].astype(np.float64)
    served = np.bincount(offered.id, minlength=len(c.cluster))
    least, total = kernels.LEAST_PART / np.maximum(served, 1), np.empty(len(c.cluster))
    widest = int(np.diff(offered.row).max(initial=0))
    tree = Tree(
        np.empty(widest, np.int32), *(np.empty(widest, np.int64) for _ in range(2)),
        *(np.empty(widest) for _ in range(3)), *(np.empty(widest, np.bool_) for _ in range(4)),
    )  # fmt: skip
    n = passes or int(np.clip(WORK // max(1, len(parts)), LEAST_PASSES, MOST_PASSES))
    pull, momentum = np.zeros(len(parts)), 0.0
    for step in np.geomspace(FIRST_STEP, LAST_STEP, n):
        kernels.pay(offered, c.cluster, c.end, c.bytes, c.need, price, parts, pull, momentum, tree)
        kernels.learn(offered.id, parts, pull, step, least, total)
        momentum = MOMENTUM
    kernels.pay(offered, c.cluster, c.end, c.bytes, c.need, price, parts, pull, momentum, tree)
    part[offered.entry] = parts


def _proven(c: _Choices, price: np.ndarray, part: np.ndarray) -> int:
    """Return the bound that these prices and parts give, whatever they are."""
    budget = np.where(c.need > 0, price, 0.0) * c.need
    shift = BITS - 2 - int(max(1.0, budget.sum())).bit_length()
    whole = np.where(c.need > 0, np.floor(price * 2.0**shift), 0.0).astype(np.int64)
    scaled, scale = c.bytes.astype(np.float64) * 2.0**shift, np.empty((len(c.bytes), 2))
    for one, ids, entries in zip(c.lists, c.ids, c.entries, strict=True):
        kernels.split(*one, scaled[ids], whole, c.need, part[entries], scale[ids])
    rich = np.flatnonzero(scale.any(axis=1))
    order = rich[np.argsort(c.cluster[rich], kind="stable")]
    offered = Offered(*kernels.offers_of_two(order, *c.lists[0], *c.lists[1], c.need))
    surplus = kernels.surplus(offered, c.cluster, c.end, scaled, c.need, whole, part, scale)
    total = sum((whole * c.need - surplus).tolist())
    return max(0, -(-total >> shift) if shift >= 0 else total << -shift)


def bound_of(
    placement: Placement, hierarchy: Hierarchy, views: ProblemViews, candidates: Candidates, *, method: str
) -> Bound:
    """Return the bound for a placement before its bake: over the candidates, and the placed impostors wherever in their
    cells they help.

    method  "auto", "lp" or "lagrangian"
    """
    p = placement
    impostors = Impostors(
        cluster=p.cluster, kind=p.kind, view_cell=p.view_cell, bytes=p.bytes, layers=p.layers, cost=p.cost
    )  # fmt: skip
    offers = offers_in_cell(p, hierarchy, views, p.cost, np.ones(len(views.cell), dtype=bool))
    low, lp = _prove(
        candidates, impostors, offers, need=views.cost - p.view_target,
        end=subtree_end(hierarchy.start, hierarchy.stop), method=method, passes=None,
    )  # fmt: skip
    return Bound(
        method="lp" if lp else "lagrangian", lower_bytes=low, placed_bytes=int(p.bytes.sum()),
        choices=len(candidates.cluster) + len(p.cluster),
    )  # fmt: skip


def uses_lp(method: str, entries: int) -> bool:
    """Return whether to try the linear programme: "auto" with at most FEW_ENTRIES entries, "lp" with MOST_ENTRIES."""
    return entries <= {"auto": FEW_ENTRIES, "lp": MOST_ENTRIES}.get(method, -1)


def by_impostor(offers: Offers, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (row, view, saved) as in Candidates of n impostors."""
    order = np.argsort(offers.id, kind="stable")
    view = np.repeat(np.arange(len(offers.row) - 1, dtype=np.int32), np.diff(offers.row))
    row = np.concatenate([[0], np.cumsum(np.bincount(offers.id, minlength=n))]).astype(np.int64)
    return row, view[order], offers.saved[order]


def first_prices(
    row: np.ndarray, view: np.ndarray, saved: np.ndarray, bytes: np.ndarray, need: np.ndarray
) -> np.ndarray:
    """Return (V,) f64 bytes a view: each impostor's bytes split over its views as it saves there."""
    gain = np.minimum(saved, need[view]).astype(np.float64)
    owner = np.repeat(np.arange(len(bytes)), np.diff(row))
    total = np.bincount(owner, weights=gain, minlength=len(bytes))
    return np.bincount(view, weights=gain * (bytes / np.maximum(total, 1))[owner], minlength=len(need))
