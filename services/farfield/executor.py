"""Runs the pipeline without broker or database: the shards of each stage in N spawned processes.

The service runs the same shards through Celery; both write the same artifacts. Processes are spawned, never forked: an
OpenGL context must not exist in a parent. Each maps its inputs from files, so what travels between them is paths.
"""

import hashlib
import json
import mmap
import os
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from farfield.errors import FarfieldError, StageFailed
from farfield.pipeline import STEPS
from farfield.settings import Settings
from farfield.stages import Stage
from farfield.steps.model import Inputs, Shard, Step, shard_key

# One thread a process: numba and the software rasteriser collapse when more threads than cores run.
THREADS = {"NUMBA_NUM_THREADS": "1", "LP_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

Progress = Callable[[Stage, int, int, str | None], None]  # stage, shards done, shards in all, reason if skipped


@dataclass(frozen=True, slots=True, kw_only=True)
class StageRun:
    """What one stage took. `seconds` is wall clock; `peak_bytes` the largest resident set of any of its processes."""

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


def _plan(stage: Stage, paths: _Paths) -> tuple[str | None, list[Shard], int]:
    reset_peak()
    step = STEPS[stage]
    inputs = paths.inputs(step)
    reason = step.skip(inputs)
    shards = [] if reason else step.plan(inputs)
    return reason, json.loads(json.dumps(shards)), peak_bytes()


def _run(stage: Stage, paths: _Paths, shard: Shard, out: Path) -> int:
    reset_peak()
    step = STEPS[stage]
    checkpoint = _checkpoint(out)
    write_parts(step.run(paths.inputs(step, checkpoint), shard), out)
    checkpoint.unlink(missing_ok=True)
    return peak_bytes()


def _merge(stage: Stage, paths: _Paths, pieces: list[Path], out: Path) -> int:
    reset_peak()
    step = STEPS[stage]
    assert step.merge is not None
    checkpoint = _checkpoint(out)
    write_parts(step.merge(paths.inputs(step, checkpoint), [map_file(piece) for piece in pieces]), out)
    checkpoint.unlink(missing_ok=True)
    return peak_bytes()


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

    def artifact(self, stage: Stage) -> Any:
        """Return the artifact of a stage that ran, as a memory map."""
        return map_file(self.paths.artifacts[stage])

    def inputs(self, *stages: Stage) -> Inputs:
        """Return the artifacts of `stages` as a stage would see them."""
        return Inputs(self.paths.settings, {stage: self.artifact(stage) for stage in stages}, self.paths.digests)

    def run(self, stage: Stage) -> StageRun:
        """Run one stage: ask, cut, run, join. Raises what the stage raised, or StageFailed when a process died."""
        step, started = STEPS[stage], time.perf_counter()
        try:
            reason, shards, peak = self._submit(_plan, stage).result()
            self.progress(stage, 0, len(shards), reason)
            pieces = [self._path(step, shard) for shard in shards]
            out = self._path(step, "merge", *pieces) if step.merge is not None else pieces[0]
            # The scene is read anew: a level may be several files, and its key knows only the one that was named.
            missing = [i for i, piece in enumerate(pieces) if stage == Stage.SCENE or not piece.exists()]
            if step.merge is not None and out.exists():
                missing = []
            peak = max(peak, *self._run_shards(stage, shards, pieces, missing), 0)
            if step.merge is not None and not out.exists():
                peak = max(peak, self._submit(_merge, stage, pieces, out).result())
                for piece in pieces if self.cache is None else []:
                    piece.unlink()
        except (BrokenProcessPool, MemoryError) as error:
            raise StageFailed(stage, "a process died, most likely for lack of memory; try fewer --workers") from error
        self.paths.artifacts[stage] = out
        self.paths.digests[stage] = file_digest(out)
        done = StageRun(
            name=stage, seconds=time.perf_counter() - started, peak_bytes=peak, skipped=reason, shards=len(shards),
            reused=len(shards) - len(missing),
        )  # fmt: skip
        self.stages.append(done)
        return done

    def _submit(self, function: Callable[..., Any], stage: Stage, *arguments: Any) -> "Future[Any]":
        assert self._pool is not None
        return self._pool.submit(function, stage, self.paths, *arguments)

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
                    peaks.append(future.result())
                except (FarfieldError, BrokenProcessPool):
                    for other in pending:
                        other.cancel()
                    raise
            self.progress(stage, len(shards) - len(pending), len(shards), None)
        return peaks
