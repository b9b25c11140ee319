"""The lazy greedy's inner loop: a heap of candidates by gain per byte, and what each view shows so far.

Problem  Pop the candidate of highest score among a hundred thousand, while each choice lowers the scores of others.
Method   A binary heap keyed by (gain / bytes, lower id first). The top is scored again if anything was chosen since its
         last scoring and sinks to its new place; a top that is up to date is chosen. Scores are compared exactly, as
         ratios of integers. With drawn(cluster, v) = geometry - savings of the impostors shown inside the cluster,

             drawn(cluster_i, v) - t_i = saved(i, v) - sum of saved(j, v) over shown j inside cluster_i

         so neither geometry nor trees are touched: `saved` of the candidates is all that is read.
Layout   What a view shows is a run in one arena, by node (preorder): the shown clusters are disjoint, so the run's
         predecessor of a node is its only possible ancestor, and its descendants are consecutive.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from farfield.viewspace.kernels import first_at_least

DONE, MORE, FULL = 0, 1, 2
# places in `counter`
HEAP, STEPS, ARENA, OVER, BYTES = 0, 1, 2, 3, 4
FIRST_CAPACITY = 4


class Served(NamedTuple):
    """The candidates as the kernels read them; `end` (C,) i32 is the first node after each node's subtree."""

    cluster: np.ndarray
    bytes: np.ndarray
    row: np.ndarray
    views: np.ndarray
    saved: np.ndarray
    end: np.ndarray


class Shown(NamedTuple):
    """What each of V views shows: run [at, at + length) of the arena, ascending nodes, capacity reserved."""

    at: np.ndarray  # (V,) i64
    length: np.ndarray  # (V,) i32
    capacity: np.ndarray  # (V,) i32
    node: np.ndarray  # (A,) i32
    candidate: np.ndarray  # (A,) i32
    saved: np.ndarray  # (A,) i64


class Queue(NamedTuple):
    """The heap and the progress of the loop."""

    heap: np.ndarray  # (N,) i32  candidates, best first
    gain: np.ndarray  # (N,) i64  by candidate, as last scored
    scored_at: np.ndarray  # (N,) i32  by candidate: number of choices made before its last scoring
    uses: np.ndarray  # (N,) i32  views that show it
    excess: np.ndarray  # (V,) i64  what the view costs above its target, >= 0
    step: np.ndarray  # (G,) i32  candidates in the order chosen, displaced ones included
    step_over: np.ndarray  # (G,) i64  sum of excess after each
    step_bytes: np.ndarray  # (G,) i64  bytes of the impostors shown anywhere after each
    counter: np.ndarray  # (5,) i64  heap size, choices, arena used, sum of excess, bytes


@njit(cache=True)
def compare_ratios(a, b, c, d):
    """Return the sign of a / b - c / d for integers a, c >= 0 and b, d > 0; exact, by continued fractions."""
    sign = 1
    while True:
        p, q = a // b, c // d
        if p != q:
            return sign if p > q else -sign
        a, c = a - p * b, c - q * d
        if a == 0 or c == 0:
            if a == c:
                return 0
            return sign if c == 0 else -sign
        # x < y for 0 < x, y < 1 is 1 / x > 1 / y
        a, b, c, d = b, a, d, c
        sign = -sign


@njit(cache=True)
def _before(i, j, gain, size):
    order = compare_ratios(gain[i], size[i], gain[j], size[j])
    return order > 0 or (order == 0 and i < j)


@njit(cache=True)
def _sink(heap, n, k, gain, size):
    i = heap[k]
    while True:
        child = 2 * k + 1
        if child >= n:
            break
        if child + 1 < n and _before(heap[child + 1], heap[child], gain, size):
            child += 1
        if not _before(heap[child], i, gain, size):
            break
        heap[k] = heap[child]
        k = child
    heap[k] = i


@njit(cache=True)
def _pop(heap, counter, gain, size):
    counter[HEAP] -= 1
    n = counter[HEAP]
    heap[0] = heap[n]
    if n > 0:
        _sink(heap, n, 0, gain, size)


@njit(cache=True)
def _change(v, node, saved, end, shown):
    """Return what an impostor of `node` that saves `saved` would take off view v now, and the run it would displace."""
    at, length = shown.at[v], shown.length[v]
    first = first_at_least(shown.node, at, at + length, node)
    if first > at and end[shown.node[first - 1]] > node:
        return np.int64(0), first, first
    last, stop = first, at + length
    while last < stop and shown.node[last] < end[node]:
        saved -= shown.saved[last]
        last += 1
    return max(np.int64(0), saved), first, last


@njit(cache=True)
def total_gain(i, served, shown, excess):
    """Return sum over views of gain(i, v) = max(0, min(drawn - t_i, t_v - target_v)) [I3D 2005, (4) and (6)]."""
    node = served.cluster[i]
    total = np.int64(0)
    for e in range(served.row[i], served.row[i + 1]):
        v = served.views[e]
        over = excess[v]
        if over > 0:
            change, _, _ = _change(v, node, served.saved[e], served.end, shown)
            total += min(change, over)
    return total


@njit(cache=True)
def fill_queue(served, shown, queue):
    """Score every candidate beside what is shown and make the heap of those that help."""
    heap, gain, counter = queue.heap, queue.gain, queue.counter
    counter[HEAP] = 0
    for i in range(len(served.cluster)):
        total = total_gain(i, served, shown, queue.excess)
        gain[i] = total
        queue.scored_at[i] = counter[STEPS]
        if total > 0:
            heap[counter[HEAP]] = i
            counter[HEAP] += 1
    n = counter[HEAP]
    for k in range(n // 2 - 1, -1, -1):
        _sink(heap, n, k, gain, served.bytes)


@njit(cache=True)
def _room_needed(i, served, shown, excess, everywhere):
    room = np.int64(0)
    for e in range(served.row[i], served.row[i + 1]):
        v = served.views[e]
        if (excess[v] > 0 or everywhere) and shown.length[v] == shown.capacity[v]:
            room += max(FIRST_CAPACITY, 2 * shown.capacity[v])
    return room


@njit(cache=True)
def _replace(v, first, last, i, node, saved, shown, counter):
    """Put impostor i where view v's run had [first, last); moves the run to the arena's end when it is full."""
    at, length = shown.at[v], np.int64(shown.length[v])
    if first == last:
        if length == shown.capacity[v]:
            capacity = max(FIRST_CAPACITY, 2 * length)
            to = counter[ARENA]
            for k in range(length):
                shown.node[to + k] = shown.node[at + k]
                shown.candidate[to + k] = shown.candidate[at + k]
                shown.saved[to + k] = shown.saved[at + k]
            counter[ARENA] += capacity
            shown.capacity[v] = capacity
            shown.at[v] = to
            first += to - at
            at = to
        for k in range(at + length, first, -1):
            shown.node[k] = shown.node[k - 1]
            shown.candidate[k] = shown.candidate[k - 1]
            shown.saved[k] = shown.saved[k - 1]
        shown.length[v] += 1
    else:
        gone = last - first - 1
        if gone > 0:
            for k in range(last, at + length):
                shown.node[k - gone] = shown.node[k]
                shown.candidate[k - gone] = shown.candidate[k]
                shown.saved[k - gone] = shown.saved[k]
            shown.length[v] -= gone
    shown.node[first] = node
    shown.candidate[first] = i
    shown.saved[first] = saved


@njit(cache=True)
def _choose(i, served, shown, queue, everywhere):
    """Show impostor i in every view where it gains; what it covers gives way, and weighs nothing once shown nowhere.

    everywhere  also where the target is met already, if it accelerates: that changes no score, but what is displaced
    """
    node, counter, excess, uses = served.cluster[i], queue.counter, queue.excess, queue.uses
    counter[BYTES] += served.bytes[i]
    for e in range(served.row[i], served.row[i + 1]):
        v = served.views[e]
        over = excess[v]
        if over <= 0 and not everywhere:
            continue
        change, first, last = _change(v, node, served.saved[e], served.end, shown)
        if change <= 0:
            continue
        for k in range(first, last):
            j = shown.candidate[k]
            uses[j] -= 1
            if uses[j] == 0:
                counter[BYTES] -= served.bytes[j]
        _replace(v, first, last, i, node, served.saved[e], shown, counter)
        uses[i] += 1
        taken = min(change, over)
        excess[v] = over - taken
        counter[OVER] -= taken
    n = counter[STEPS]
    queue.step[n] = i
    queue.step_over[n] = counter[OVER]
    queue.step_bytes[n] = counter[BYTES]
    counter[STEPS] = n + 1


@njit(cache=True)
def advance(served, shown, queue, n_tops, everywhere):
    """Look at the heap's top n_tops times: score it again, or choose it. Returns DONE, MORE, or FULL (make room first).

    A choice needs an up-to-date score, and no score ever rises, so the choice is the naive greedy's.
    """
    heap, gain, counter = queue.heap, queue.gain, queue.counter
    for _ in range(n_tops):
        if counter[HEAP] == 0 or counter[OVER] == 0:
            return DONE
        i = heap[0]
        if queue.scored_at[i] != counter[STEPS]:
            gain[i] = total_gain(i, served, shown, queue.excess)
            queue.scored_at[i] = counter[STEPS]
            if gain[i] == 0:
                _pop(heap, counter, gain, served.bytes)
            else:
                _sink(heap, counter[HEAP], 0, gain, served.bytes)
            continue
        if counter[ARENA] + _room_needed(i, served, shown, queue.excess, everywhere) > len(shown.node):
            return FULL
        _choose(i, served, shown, queue, everywhere)
        gain[i] = 0
        _pop(heap, counter, gain, served.bytes)
    return MORE


@njit(cache=True)
def replay(steps, served, shown, queue, everywhere):
    """Choose what is left of `steps`, without asking for scores. Returns DONE, or FULL (make room first)."""
    while queue.counter[STEPS] < len(steps):
        i = steps[queue.counter[STEPS]]
        if queue.counter[ARENA] + _room_needed(i, served, shown, queue.excess, everywhere) > len(shown.node):
            return FULL
        _choose(i, served, shown, queue, everywhere)
    return DONE
