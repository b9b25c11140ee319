"""What a worker does with a shard id: claim, compute, commit, then move the job on.

Safe to run twice, at once, and to be killed at any point: the result is a blob under its digest, the commit needs the
attempt to be still ours, and moving on is a compare-and-set that anyone may repeat.
"""

import ctypes
import logging
import os
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import sqlalchemy as sa
from farfield.errors import FarfieldError, StageFailed
from farfield.pipeline import Inputs, shard_key
from farfield.settings import from_mapping
from farfield.stages import Stage
from farfield.store import progress, shards
from farfield.store.artifacts import Artifacts
from farfield.store.progress import Message
from farfield.store.shards import Claim

from farfield_workers.compute import Call, Result, compute, compute_isolated
from farfield_workers.settings import WorkerSettings
from farfield_workers.table import Pipeline

log = logging.getLogger(__name__)


class ShardStopped(BaseException):
    """The shard is no longer ours: its job was cancelled, or another worker took it over."""


def work(
    engine: sa.Engine, artifacts: Artifacts, pipeline: Pipeline, settings: WorkerSettings, shard_id: str
) -> list[Message]:
    """Run the shard if it is to be run, and return the messages to send."""
    held = shards.claim(engine, shard_id, worker=settings.worker, lease_s=settings.lease_s)
    if held is None:
        return []
    where = {"job": held.job_id, "stage": held.stage, "kind": held.kind, "ordinal": held.ordinal}
    try:
        _run(engine, artifacts, pipeline, settings, held)
    except ShardStopped:
        log.info("stopped %s", where)
        return []
    except Exception as error:
        log.exception("failed %s attempt %d", where, held.attempt)
        # A named error is a fact about the input: another attempt would find the same.
        named = isinstance(error, FarfieldError) and not isinstance(error, StageFailed)
        told = _told(error, held.stage)
        state = shards.fail(engine, held, error=told, log=traceback.format_exc(), again=not named)
        if state == "ready":
            queue = str(pipeline.steps[Stage(held.stage)].queue) if held.kind in ("run", "merge") else "cpu"
            return [Message(shard_id, queue)]
    return progress.advance(engine, artifacts, held.job_id, pipeline.kinds())


def _run(engine: sa.Engine, artifacts: Artifacts, pipeline: Pipeline, settings: WorkerSettings, held: Claim) -> None:
    started = time.perf_counter()
    key = _key(pipeline, held)
    # Written by whoever runs the shard, under the name of all that shapes its result: it needs no fence.
    checkpoint = key.replace(":", "-") if key is not None else None
    with _leased(engine, held, settings), ExitStack() as until_done:
        folder = Path(until_done.enter_context(TemporaryDirectory(dir=artifacts.temporary, prefix="shard-")))
        known = shards.known_result(engine, key) if key is not None else None
        if known is not None and artifacts.has(known.artifact_digest):
            found = Result(known.artifact_digest, artifacts.n_bytes(known.artifact_digest), known.peak_bytes or 0)
            seconds, cached = known.seconds or 0.0, True
        else:
            call = _call(artifacts, held, pipeline, folder, until_done)
            if checkpoint is not None:
                call = replace(call, checkpoint=str(until_done.enter_context(artifacts.checkpoint(checkpoint))))
            found = _compute(pipeline, settings, call, folder / "artifact")
            artifacts.put_file(folder / "artifact", found.digest)
            seconds, cached = time.perf_counter() - started, False

    def there() -> None:
        if not artifacts.has(found.digest):  # the same bytes were another job's, which was deleted meanwhile
            raise StageFailed(held.stage, "its result was deleted with another job")

    # What a clock may have stopped is no other job's: it has no key, and its checkpoint stays for who has more time.
    timed = not cached and _timed(pipeline, held)
    ours = shards.commit(
        engine, held, digest=found.digest, n_bytes=found.n_bytes, key=None if timed else key, seconds=seconds,
        peak_bytes=found.peak_bytes, cached=cached, check=there,
    )  # fmt: skip
    if not ours:
        raise ShardStopped
    if checkpoint is not None and not timed:
        artifacts.drop_checkpoint(checkpoint)


def _timed(pipeline: Pipeline, held: Claim) -> bool:
    return held.kind in ("run", "merge") and pipeline.steps[Stage(held.stage)].timed(from_mapping(held.settings))


def _compute(pipeline: Pipeline, settings: WorkerSettings, call: Call, out: Path) -> Result:
    if Stage(call.stage) in pipeline.isolated and call.kind == "run":
        return compute_isolated(
            settings.pipeline, call, out, memory_bytes=settings.scene_memory_bytes, seconds=settings.scene_seconds
        )
    return compute(pipeline, call, out)


def _call(artifacts: Artifacts, held: Claim, pipeline: Pipeline, folder: Path, until_done: ExitStack) -> Call:
    """Return the shard with the files that it reads; they stay there until the stack ends."""

    def local(digest: str) -> str:
        return str(until_done.enter_context(artifacts.local(digest)))

    scene_file = folder / f"scene{held.scene_suffix}"
    if held.stage == Stage.SCENE:  # nobody else reads it
        os.link(local(held.scene_digest), scene_file)
    reads = held.artifacts if held.kind == "report" else map(str, pipeline.steps[Stage(held.stage)].inputs)
    return Call(
        stage=held.stage, kind=held.kind, params=held.params, settings=held.settings, scene_file=str(scene_file),
        artifacts={s: local(held.artifacts[s]) for s in reads}, digests=_digests(held),
        pieces=[local(digest) for digest in held.pieces], outcomes=held.outcomes,
    )  # fmt: skip


def _digests(held: Claim) -> dict[str, str]:
    return {str(Stage.SCENE): held.scene_digest, **held.artifacts}


def _key(pipeline: Pipeline, held: Claim) -> str | None:
    if held.kind == "report":
        return None  # it holds timings: never taken over
    shard = held.params if held.kind == "run" else held.kind
    inputs = Inputs(from_mapping(held.settings), {}, {Stage(s): digest for s, digest in _digests(held).items()})
    return f"{held.kind}:{shard_key(pipeline.steps[Stage(held.stage)], inputs, shard)}"


def _told(error: Exception, stage: str) -> dict[str, str]:
    """Return what a client may read: never a stack or a path."""
    if isinstance(error, FarfieldError):
        return {"code": error.code, "message": str(error), "advice": error.advice}
    if isinstance(error, MemoryError):
        return {"code": "OutOfMemory", "message": f"stage {stage} ran out of memory",
                "advice": "Use fewer workers, or a larger machine."}  # fmt: skip
    return {"code": "StageFailed", "message": f"stage {stage} failed: {type(error).__name__}",
            "advice": "Ask the operator for the log of the shard."}  # fmt: skip


@contextmanager
def _leased(engine: sa.Engine, held: Claim, settings: WorkerSettings) -> Iterator[None]:
    """Renew the lease from a thread; raise ShardStopped in the caller's thread once it is lost."""
    caller, ended, guard = threading.get_ident(), threading.Event(), threading.Lock()

    def keep() -> None:
        while not ended.wait(settings.renew_s):
            try:
                kept = shards.renew(engine, held, lease_s=settings.lease_s)
            except sa.exc.OperationalError:
                log.warning("the lease of shard %s could not be renewed", held.shard_id, exc_info=True)
                continue
            if not kept:
                with guard:
                    if not ended.is_set():
                        ctypes.pythonapi.PyThreadState_SetAsyncExc(
                            ctypes.c_ulong(caller), ctypes.py_object(ShardStopped)
                        )
                return

    thread = threading.Thread(target=keep, name="lease", daemon=True)
    thread.start()
    try:
        yield
    finally:
        with guard:
            ended.set()
        thread.join()
