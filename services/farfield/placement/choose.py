"""Run the lazy greedy of `kernels` to its end, in slices between which progress is told and a checkpoint written.

Problem  Choose candidates, best gain per byte first, until no view is above its target or no candidate helps.
Method   Lazy recalculation is exact because no score ever rises: a view's excess only falls; a choice is shown only
         where t_i <= drawn, so what covers it gains less, what it covers nothing; bytes and costs are fixed estimates.
         `tests/naive/greedy.py` chooses the same sequence by scoring everything before each choice.
         Since the sequence depends on scores alone, its first choices are all that a checkpoint needs: they are made
         again without scoring, everything is scored once, and the loop goes on to the same end.
Tried    Copying the served entries that can still gain, whenever they had halved: the demo city (39,612 views, 367 k
         candidates, 63 M entries, 21,805 choices) looks at 159 M entries in 34 s of one busy core, with or without.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from farfield.candidates.model import Candidates
from farfield.placement import kernels
from farfield.placement.checkpoint import Checkpoint
from farfield.placement.kernels import Queue, Served, Shown

Progress = Callable[[float, dict], None]  # a share in [0, 1], counters
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


def choose(
    candidates: Candidates, *, excess: np.ndarray, end: np.ndarray, everywhere: bool = False,
    progress: Progress | None = None, stop: Callable[[], bool] | None = None, checkpoint: Checkpoint | None = None,
) -> Choice:  # fmt: skip
    """Return the greedy choice.

    excess      (V,) i64 >= 0, cost of each view above its target; not written to
    end         (C,) i32, see `antichain.subtree_end`
    everywhere  a choice is also shown in views that meet their target, wherever it accelerates
    progress    called with the share of the excess that is gone and counters, at most twice a second and once at the end;
                "over" among them is what each view costs above its target now (V,) i64: read it, do not keep it
    stop        asked several times a second; True ends the loop early
    checkpoint  read at the start, written every few seconds
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
    queue.counter[kernels.OVER] = total = int(excess.sum())
    steps = checkpoint.read(n) if checkpoint is not None else np.zeros(0, np.int32)
    while kernels.replay(steps, served, shown, queue, everywhere) == kernels.FULL:
        shown = _with_more_room(shown, queue.counter)
    kernels.fill_queue(served, shown, queue)

    def tell() -> None:
        over = int(queue.counter[kernels.OVER])
        counters = {
            "choices": int(queue.counter[kernels.STEPS]),
            "excess": over,
            "bytes": int(queue.counter[kernels.BYTES]),
        }
        if progress is not None:
            progress(1 - over / max(1, total), {**counters, "over": queue.excess})

    told = time.monotonic()
    while (state := kernels.advance(served, shown, queue, TOPS_A_SLICE, everywhere)) != kernels.DONE:
        if state == kernels.FULL:
            shown = _with_more_room(shown, queue.counter)
        if checkpoint is not None:
            checkpoint.write(queue.step[: int(queue.counter[kernels.STEPS])])
        if stop is not None and stop():
            break
        if time.monotonic() - told > SECONDS_BETWEEN_REPORTS:
            told = time.monotonic()
            tell()
    tell()
    n_steps = int(queue.counter[kernels.STEPS])
    if checkpoint is not None:
        checkpoint.write(queue.step[:n_steps], at_once=True)
    return Choice(
        step=queue.step[:n_steps].copy(), step_over=queue.step_over[:n_steps].copy(),
        step_bytes=queue.step_bytes[:n_steps].copy(), chosen=np.flatnonzero(queue.uses > 0).astype(np.int32),
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
