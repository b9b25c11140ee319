"""Runs the pipeline without broker or database: the shards of each stage in N spawned processes.

The service runs the same shards through Celery; both write the same artifacts. Processes are spawned, never forked: an
OpenGL context must not exist in a parent. Each maps its inputs from files, so what travels between them is paths.
A stage that no other reads may run beside those that follow (`begin_leaves`): the lower bound takes one process for long.
"""

import ctypes
import hashlib
import json
import mmap
import os
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from farfield.errors import FarfieldError, StageFailed
from farfield.memory import HEADROOM, free_bytes
from farfield.pipeline import STEPS
from farfield.settings import Settings
from farfield.stages import Stage
from farfield.steps.model import Inputs, Shard, Step, shard_key

# One thread a process: numba and the software rasteriser collapse when more threads than cores run.
THREADS = {"NUMBA_NUM_THREADS": "1", "LP_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

_LIBC = ctypes.CDLL(None)

Progress = Callable[[Stage, int, int, str | None], None]  # stage, shards done, shards in all, reason if skipped


@dataclass(frozen=True, slots=True, kw_only=True)
class StageRun:
    """What one stage took. `seconds` is wall clock, with what ran beside it; `peak_bytes` the largest resident set of any
    of its processes."""

    name: str
    seconds: float
    peak_bytes: int
    skipped: str | None
    shards: int
    reused: int  # of the shards: found in the cache


@dataclass(frozen=True, slots=True)
class _Paths:
    """The inputs of a shard as a spawned process needs them."""

    settings: Settings
    scene_file: Path
    artifacts: dict[Stage, Path]
    digests: dict[Stage, str]
    base: Path | None = None

    def inputs(self, step: Step, checkpoint: Path | None = None) -> Inputs:
        mapped = {stage: map_file(self.artifacts[stage]) for stage in step.inputs}
        return Inputs(self.settings, mapped, self.digests, self.scene_file, checkpoint, base=self.base)


def map_file(path: Path) -> Any:
    """Return the file's content as a read-only memory map (b"" for an empty file)."""
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if size else b""


def write_parts(parts: Sequence[bytes | memoryview], path: Path) -> None:
    """Write the parts to `path` through a temporary name, so that a reader never sees half a file."""
    temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
    with temporary.open("wb") as file:
        for part in parts:
            file.write(part)
    temporary.replace(path)


def file_digest(path: Path) -> str:
    """Return the SHA-256 (hex) of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def reset_peak() -> None:
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:  # not Linux, or not allowed: the peak is then that of the process so far
        return


def peak_bytes() -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    return 0


def _measured(function: Callable[..., Any], *arguments: Any) -> tuple[Any, int]:
    """Return what the function returns and the peak memory; gives back to the system what was freed."""
    reset_peak()
    returned = function(*arguments)
    peak = peak_bytes()
    if hasattr(_LIBC, "malloc_trim"):  # glibc keeps hundreds of megabytes a process, beside what the next stage takes
        _LIBC.malloc_trim(0)
    return returned, peak


def _plan(stage: Stage, paths: _Paths) -> tuple[str | None, list[Shard]]:
    step = STEPS[stage]
    inputs = paths.inputs(step)
    reason = step.skip(inputs)
    shards = [] if reason else step.plan(inputs)
    return reason, json.loads(json.dumps(shards))


def _run(stage: Stage, paths: _Paths, shard: Shard, out: Path) -> None:
    step = STEPS[stage]
    checkpoint = _checkpoint(out)
    write_parts(step.run(paths.inputs(step, checkpoint), shard), out)
    checkpoint.unlink(missing_ok=True)


def _merge(stage: Stage, paths: _Paths, pieces: list[Path], out: Path) -> None:
    step = STEPS[stage]
    assert step.merge is not None
    checkpoint = _checkpoint(out)
    write_parts(step.merge(paths.inputs(step, checkpoint), [map_file(piece) for piece in pieces]), out)
    checkpoint.unlink(missing_ok=True)


def _checkpoint(out: Path) -> Path:
    """Return where a killed run's successor looks: beside the artifact, whose name tells all that shapes it."""
    return out.with_suffix(".checkpoint")


def _end_with_parent() -> None:
    """End this process when its parent is gone: a killed `farfield place` leaves no work running."""
    parent = parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class Executor:
    """Walks the pipeline over one scene; artifacts live as files in `work`.

    `base` is the folder of the job whose placement `placement.base` names. With `cache`, a folder that may serve any
    number of jobs at once, artifacts live there under their keys and stay: what another job did already is not done again.
    """

    def __init__(
        self, scene_file: Path, settings: Settings, work: Path, *, workers: int, progress: Progress,
        cache: Path | None = None, base: Path | None = None,
    ) -> None:  # fmt: skip
        self.work, self.workers, self.progress, self.cache = work, workers, progress, cache
        self.paths = _Paths(settings, scene_file, {}, {}, base)
        self.stages: list[StageRun] = []
        self._pool: ProcessPoolExecutor | None = None
        self._others: set[BaseProcess] = set()
        self._threads = ThreadPoolExecutor(len(STEPS))
        self._begun: dict[Stage, Future[StageRun]] = {}

    def __enter__(self) -> "Executor":
        for name, value in THREADS.items():
            os.environ.setdefault(name, value)
        self._others = set(active_children())
        self._pool = ProcessPoolExecutor(self.workers, mp_context=get_context("spawn"), initializer=_end_with_parent)
        self.paths.digests[Stage.SCENE] = file_digest(self.paths.scene_file)
        return self

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        assert self._pool is not None
        if kind is not None:  # nobody waits for a shard whose job is over
            for process in set(active_children()) - self._others:
                process.terminate()
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._threads.shutdown(wait=True)

    def artifact(self, stage: Stage) -> Any:
        """Return the artifact of a stage that ran, as a memory map."""
        return map_file(self.paths.artifacts[stage])

    def inputs(self, *stages: Stage) -> Inputs:
        """Return the artifacts of `stages` as a stage would see them."""
        return Inputs(self.paths.settings, {stage: self.artifact(stage) for stage in stages}, self.paths.digests)

    def run(self, stage: Stage) -> StageRun:
        """Run one stage, or wait for it where it has begun. Raises what the stage raised, or StageFailed if a process died."""
        begun = self._begun.pop(stage, None)
        done = begun.result() if begun is not None else self._run_stage(stage)
        self.stages.append(done)
        return done

    def begin_leaves(self) -> None:
        """Begin stages that no other reads and whose inputs are there, if a process and memory are left for the others."""
        there = dict(self.paths.artifacts)  # a stage that has begun may end meanwhile
        waiting = [step for stage, step in STEPS.items() if stage not in there and stage not in self._begun]
        if self.workers < 2 or not waiting:
            return
        read = {stage for step in STEPS.values() for stage in step.inputs}
        others = (self.workers - 1) * max(map(self._need_bytes, waiting))
        for step in waiting:
            ready = step.stage not in read and all(stage in there for stage in step.inputs)
            if ready and self._need_bytes(step) + others <= HEADROOM * free_bytes():
                self._begun[step.stage] = self._threads.submit(self._run_stage, step.stage)

    def _need_bytes(self, step: Step) -> int:
        """Return what a shard of the step may take, as far as its inputs are known."""
        there = dict(self.paths.artifacts)
        sizes = {str(stage): there[stage].stat().st_size for stage in step.inputs if stage in there}
        return step.need.bytes("run", sizes)

    def _run_stage(self, stage: Stage) -> StageRun:
        """Ask, cut, run, join."""
        step, started = STEPS[stage], time.perf_counter()
        try:
            (reason, shards), peak = self._submit(_plan, stage).result()
            self.progress(stage, 0, len(shards), reason)
            pieces = [self._path(step, shard) for shard in shards]
            out = self._path(step, "merge", *pieces) if step.merge is not None else pieces[0]
            # The scene is read anew: a level may be several files, and its key knows only the one that was named.
            missing = [i for i, piece in enumerate(pieces) if stage == Stage.SCENE or not piece.exists()]
            if step.merge is not None and out.exists():
                missing = []
            peak = max(peak, *self._run_shards(stage, shards, pieces, missing), 0)
            if step.merge is not None and not out.exists():
                peak = max(peak, self._submit(_merge, stage, pieces, out).result()[1])
                for piece in pieces if self.cache is None else []:
                    piece.unlink()
        except (BrokenProcessPool, MemoryError) as error:
            raise StageFailed(stage, "a process died, most likely for lack of memory; try fewer --workers") from error
        self.paths.artifacts[stage] = out
        self.paths.digests[stage] = file_digest(out)
        return StageRun(
            name=stage, seconds=time.perf_counter() - started, peak_bytes=peak, skipped=reason, shards=len(shards),
            reused=len(shards) - len(missing),
        )  # fmt: skip

    def _submit(self, function: Callable[..., Any], stage: Stage, *arguments: Any) -> "Future[tuple[Any, int]]":
        assert self._pool is not None
        # A copy: the pool pickles it in a thread of its own, while stages that run beside this one add theirs.
        paths = replace(self.paths, artifacts=dict(self.paths.artifacts), digests=dict(self.paths.digests))
        return self._pool.submit(_measured, function, stage, paths, *arguments)

    def _path(self, step: Step, shard: Shard, *pieces: Path) -> Path:
        """Return where an artifact lies: under a digest of everything that shapes it, `pieces` included."""
        key = shard_key(step, Inputs(self.paths.settings, {}, self.paths.digests), shard)
        key = hashlib.sha256(" ".join([key, *(piece.name for piece in pieces)]).encode()).hexdigest()
        if self.cache is None or step.stage == Stage.SCENE:  # a scene's key does not tell all of its files: see `run`
            return self.work / f"{step.stage}-{key[:24]}.ffc"
        folder = self.cache / step.stage
        folder.mkdir(parents=True, exist_ok=True)
        kept = folder / f"{key}.ffc"
        if step.timed(self.paths.settings) and not kept.exists():  # what a clock stopped is no other job's
            return self.work / f"{step.stage}-{key[:24]}.ffc"
        return kept

    def _run_shards(self, stage: Stage, shards: list[Shard], pieces: list[Path], missing: list[int]) -> list[int]:
        """Run the missing shards and return the peak memory of each."""
        futures = {self._submit(_run, stage, shards[i], pieces[i]): i for i in missing}
        peaks, pending = [0], set(futures)
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                try:
                    peaks.append(future.result()[1])
                except (FarfieldError, BrokenProcessPool):
                    for other in pending:
                        other.cancel()
                    raise
            self.progress(stage, len(shards) - len(pending), len(shards), None)
        return peaks
