"""The kernels of `bound`: what views pay and take at given shares, how shares learn from it, and what that proves.

Tree    A view's offers are in preorder of their clusters, so the nearest enclosing offer of each is found with a stack, and
        a best antichain from last to first: best(offer) = max(own value, sum of best below). Of two offers of one
        cluster the later counts as inside the earlier.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from farfield.placement.antichain import best_antichain

ROUNDING = 2.0**-24  # more than float64 sums of a hundred million terms can be wrong by, relatively
LEAST_PART = 1e-7  # of an even share: what comes back from less takes too long
MOST_PRICES = 60  # tried in a view; a handful is usual


class Offered(NamedTuple):
    """What V views are offered by those candidates that are looked at, ids ascending with the cluster."""

    row: np.ndarray  # (V+1,) i64
    id: np.ndarray  # (S,) i32
    entry: np.ndarray  # (S,) i64  of all entries
    gain: np.ndarray  # (S,) i64  what it saves, at most the view's need


class Tree(NamedTuple):
    """Scratch, each as long as the longest list of a view."""

    node: np.ndarray  # i32
    up: np.ndarray  # i64  nearest enclosing offer, or -1
    stack: np.ndarray  # i64
    share: np.ndarray  # f64  bytes that it has to earn in this view
    best: np.ndarray  # f64  of its subtree
    below: np.ndarray  # f64
    taken: np.ndarray  # b1
    inside: np.ndarray  # b1  taken, or inside one that is
    few: np.ndarray  # b1  taken at a price at which too little is saved
    enough: np.ndarray  # b1  ... and where enough is


@njit(cache=True)
def offers_of_two(order, row_a, view_a, saved_a, row_b, view_b, saved_b, need):
    """Return (row, id, entry, gain) of what `order` offers to views; b's ids and entries come after a's."""
    n_first = len(row_a) - 1
    count = np.zeros(len(need) + 1, np.int64)
    for s in range(len(order)):
        i, row, view = (order[s], row_a, view_a) if order[s] < n_first else (order[s] - n_first, row_b, view_b)
        for e in range(row[i], row[i + 1]):
            count[view[e] + 1] += 1
    offer_row = np.cumsum(count)
    id, entry, gain = (
        np.empty(offer_row[-1], np.int32), np.empty(offer_row[-1], np.int64), np.empty(offer_row[-1], np.int64)
    )  # fmt: skip
    fill = offer_row[:-1].copy()
    for s in range(len(order)):
        second = order[s] >= n_first
        i = order[s] - n_first if second else order[s]
        row, view, saved = (row_b, view_b, saved_b) if second else (row_a, view_a, saved_a)
        for e in range(row[i], row[i + 1]):
            k = fill[view[e]]
            id[k], entry[k], gain[k] = order[s], e + (row_a[-1] if second else 0), min(saved[e], need[view[e]])
            fill[view[e]] += 1
    return offer_row, id, entry, gain


@njit(cache=True)
def parts_as_earned(row, view, saved, price, need, part):
    """Set part (E,) f32 to what each entry earns at prices (V,) f64 of a unit of need, of all that its candidate earns."""
    for i in range(len(row) - 1):
        earned = 0.0
        for e in range(row[i], row[i + 1]):
            earned += price[view[e]] * min(saved[e], need[view[e]])
        for e in range(row[i], row[i + 1]):
            part[e] = price[view[e]] * min(saved[e], need[view[e]]) / max(earned, 1e-300)


@njit(cache=True)
def _save_most(price, low, n, offered, tree):
    """Mark in `inside` the best antichain at a price; return (what it saves, the bytes it has to earn)."""
    for k in range(n):
        tree.below[k] = 0.0
    for k in range(n - 1, -1, -1):
        value, below = price * offered.gain[low + k] - tree.share[k], tree.below[k]
        tree.taken[k] = value > below
        tree.best[k] = max(value, below)
        if tree.up[k] >= 0:
            tree.below[tree.up[k]] += tree.best[k]
    gain, share = np.int64(0), 0.0
    for k in range(n):
        hidden = tree.up[k] >= 0 and tree.inside[tree.up[k]]
        tree.inside[k] = hidden or tree.taken[k]
        tree.taken[k] = tree.taken[k] and not hidden
        if tree.taken[k]:
            gain += offered.gain[low + k]
            share += tree.share[k]
    return gain, share


@njit(cache=True)
def _settle_price(price, need, low, n, offered, tree):
    """Return (price at which saving `need` earns most, part of `enough` to show, the bytes that the view pays then).

    What the view pays is concave in the price, the least of one line an antichain; the two lines at the top belong to
    `few` and `enough`, and mixed they save just what is needed. Found by intersecting lines [Dinkelbach].
    """
    few_gain, few_share, enough_gain, enough_share, found = np.int64(0), 0.0, np.int64(0), 0.0, False
    tree.few[:n] = False
    tree.enough[:n] = False
    for _ in range(MOST_PRICES):
        gain, share = _save_most(price, low, n, offered, tree)
        if gain >= need:
            if found and gain == enough_gain and share == enough_share:
                break
            found, enough_gain, enough_share = True, gain, share
            tree.enough[:n] = tree.taken[:n]
        else:
            if found and gain == few_gain and share == few_share:
                break
            few_gain, few_share = gain, share
            tree.few[:n] = tree.taken[:n]
        if not found:
            price = 2 * price + 1e-9
            continue
        meeting = max((enough_share - few_share) / (enough_gain - few_gain), 0.0)
        if abs(meeting - price) <= 1e-12 * price:
            break
        price = meeting
    if not found:
        return price, 0.0, few_share
    part = (need - few_gain) / (enough_gain - few_gain)
    return price, part, part * enough_share + (1 - part) * few_share


@njit(cache=True)
def pay(offered, cluster, end, bytes, need, price, part, pull, momentum, tree):
    """Settle each view's price (V,) f64 at the parts (S,) f64 of bytes that offers have to earn; return all that is paid.

    pull  (S,) f64 becomes momentum * pull + (1 - momentum) * (how much of the offer the view takes)
    """
    paid = 0.0
    for v in range(len(need)):
        low, n, top = offered.row[v], offered.row[v + 1] - offered.row[v], 0
        if n == 0 or need[v] <= 0:
            continue
        for k in range(n):
            i = offered.id[low + k]
            tree.node[k], tree.share[k] = cluster[i], part[low + k] * bytes[i]
            while top > 0 and end[tree.node[tree.stack[top - 1]]] <= tree.node[k]:
                top -= 1
            tree.up[k] = tree.stack[top - 1] if top > 0 else -1
            tree.stack[top] = k
            top += 1
        price[v], enough, pays = _settle_price(price[v], need[v], low, n, offered, tree)
        paid += pays
        for k in range(n):
            taken = (enough if tree.enough[k] else 0.0) + (1 - enough if tree.few[k] else 0.0)
            pull[low + k] = momentum * pull[low + k] + (1 - momentum) * taken
    return paid


@njit(cache=True)
def learn(id, part, pull, step, least, total):
    """Let offers that views take earn more of their bytes: parts grow by exp(step * pull), nearly, and sum to 1 again.

    least  (N,) f64 least part; total  (N,) f64 scratch
    """
    total[:] = 0.0
    for s in range(len(id)):
        grown = 1 + step * pull[s] / 64  # to the 64th power: the same digits on any processor, unlike exp
        for _ in range(6):
            grown *= grown
        part[s] = max(part[s], least[id[s]]) * grown
        total[id[s]] += part[s]
    for s in range(len(id)):
        part[s] /= total[id[s]]


@njit(cache=True)
def _paid(earning, part, bytes, scale):
    """Return what an entry pays of its candidate's bytes: its part of them, and of what it earns beyond that the spread."""
    own = scale[0] * min(earning, part * bytes)
    return own + scale[1] * (earning - own)


@njit(cache=True)
def split(row, view, saved, bytes, price, need, part, scale):
    """Set scale (N,2) f64 so that entries together pay at most bytes (N,) f64: for (part, spread of the rest), see `_paid`.

    price  (V,) i64; part  (E,) f32, any at all. scale is 0 for what earns less than its bytes: it pays with all it earns.
    """
    for i in range(len(bytes)):
        whole, own = 0.0, 0.0
        for e in range(row[i], row[i + 1]):
            earning = float(price[view[e]] * min(saved[e], need[view[e]]))
            whole += earning
            own += min(earning, part[e] * bytes[i])
        scale[i] = 0.0
        if whole <= bytes[i] * (1 - ROUNDING):
            continue
        scale[i, 0] = min(1.0, bytes[i] / max(own, 1.0)) * (1 - ROUNDING)
        own *= scale[i, 0]
        scale[i, 1] = max(0.0, (bytes[i] - own) / (whole - own)) * (1 - ROUNDING) if whole > own else 0.0


@njit(cache=True)
def surplus(offered, cluster, end, bytes, need, price, part, scale):
    """Return (V,) i64: the most that an antichain earns beyond what it pays."""
    widest = 0
    for v in range(len(need)):
        widest = max(widest, offered.row[v + 1] - offered.row[v])
    node, stack_node = np.empty(widest, np.int32), np.empty(widest, np.int32)
    value, stack_sum, take = np.empty(widest, np.int64), np.empty(widest, np.int64), np.empty(widest, np.bool_)
    most = np.zeros(len(need), np.int64)
    for v in range(len(need)):
        low, n = offered.row[v], offered.row[v + 1] - offered.row[v]
        for k in range(n):
            i = offered.id[low + k]
            node[k], earning = cluster[i], price[v] * offered.gain[low + k]
            value[k] = earning - np.int64(_paid(float(earning), part[offered.entry[low + k]], bytes[i], scale[i]))
        most[v] = best_antichain(node[:n], value[:n], end, take[:n], stack_node, stack_sum)
    return most
