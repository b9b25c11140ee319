"""Run the lazy greedy of `kernels` to its end, in slices between which progress is told.

Problem  Choose candidates, best gain per byte first, until no view is above its target or no candidate helps.
Method   Lazy recalculation is exact because no score ever rises: a view's excess only falls; a choice is shown only
         where t_i <= drawn, so what covers it gains less, what it covers nothing; bytes and costs are fixed estimates.
         `tests/naive/greedy.py` chooses the same sequence by scoring everything before each choice.
Tried    Copying the served entries that can still gain, whenever they had halved: the demo city (39,612 views, 367 k
         candidates, 63 M entries, 21,805 choices) looks at 159 M entries in 34 s of one busy core, with or without.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from farfield.candidates.model import Candidates
from farfield.placement import kernels
from farfield.placement.kernels import Queue, Served, Shown

Progress = Callable[[float, dict], None]
TOPS_A_SLICE = 512
SECONDS_BETWEEN_REPORTS = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """The greedy's outcome. A candidate that is displaced everywhere later is a step, but not chosen."""

    step: np.ndarray  # (G,) i32  candidates in the order chosen
    step_over: np.ndarray  # (G,) i64  sum over views of what is above target, after each
    step_bytes: np.ndarray  # (G,) i64  bytes of the impostors then shown anywhere
    chosen: np.ndarray  # (I,) i32  candidates shown somewhere at the end, ascending
    excess: np.ndarray  # (V,) i64  what each view still costs above its target


def choose(candidates: Candidates, *, excess: np.ndarray, end: np.ndarray, progress: Progress | None = None) -> Choice:
    """Return the greedy choice.

    excess    (V,) i64 >= 0, cost of each view above its target; not written to
    end       (C,) i32, see `antichain.subtree_end`
    progress  called with the share of the excess that is gone and counters, at most twice a second
    """
    n, n_views = len(candidates.cluster), len(excess)
    served = Served(
        candidates.cluster, candidates.bytes, candidates.row, candidates.view, candidates.saved, end
    )  # fmt: skip
    shown = Shown(
        np.zeros(n_views, np.int64), np.zeros(n_views, np.int32), np.zeros(n_views, np.int32), *_arena(1024)
    )  # fmt: skip
    queue = Queue(
        heap=np.empty(n, np.int32), gain=np.zeros(n, np.int64), scored_at=np.zeros(n, np.int32),
        uses=np.zeros(n, np.int32), excess=excess.astype(np.int64), step=np.empty(n, np.int32),
        step_over=np.empty(n, np.int64), step_bytes=np.empty(n, np.int64), counter=np.zeros(5, np.int64),
    )  # fmt: skip
    queue.counter[kernels.OVER] = excess.sum()
    kernels.fill_queue(served, queue)
    total, told = max(1, int(excess.sum())), time.monotonic()
    while (state := kernels.advance(served, shown, queue, TOPS_A_SLICE)) != kernels.DONE:
        if state == kernels.FULL:
            shown = _with_more_room(shown, queue.counter)
        if progress is not None and time.monotonic() - told > SECONDS_BETWEEN_REPORTS:
            told = time.monotonic()
            chosen, over = int(queue.counter[kernels.STEPS]), int(queue.counter[kernels.OVER])
            progress(1 - over / total, {"choices": chosen, "excess": over, "bytes": int(queue.counter[kernels.BYTES])})
    steps = int(queue.counter[kernels.STEPS])
    return Choice(
        step=queue.step[:steps].copy(), step_over=queue.step_over[:steps].copy(),
        step_bytes=queue.step_bytes[:steps].copy(), chosen=np.flatnonzero(queue.uses > 0).astype(np.int32),
        excess=queue.excess,
    )  # fmt: skip


def _arena(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.empty(size, np.int32), np.empty(size, np.int32), np.empty(size, np.int64)


def _with_more_room(shown: Shown, counter: np.ndarray) -> Shown:
    """Return the same runs, packed without gaps into an arena with room for every run to double at once."""
    length = shown.length.astype(np.int64)
    at = np.cumsum(length) - length
    old = np.repeat(shown.at - at, length) + np.arange(length.sum())
    used = int(length.sum())
    room = used + 2 * int(np.maximum(kernels.FIRST_CAPACITY, 2 * length).sum())
    larger = []
    for column in (shown.node, shown.candidate, shown.saved):
        grown = np.empty(room, column.dtype)
        grown[:used] = column[old]
        larger.append(grown)
    counter[kernels.ARENA] = used
    return Shown(at, shown.length, shown.length.copy(), *larger)
