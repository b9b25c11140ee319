"""What a worker does with a shard id: claim, compute, commit, then move the job on.

Safe to run twice, at once, and to be killed at any point: the result is a blob under its digest, the commit needs the
claim to be still ours, and moving on is a compare-and-set that anyone may repeat.
"""

import functools
import logging
import os
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from errno import EDQUOT, ENOSPC
from pathlib import Path
from tempfile import TemporaryDirectory

import sqlalchemy as sa
from farfield import memory
from farfield.errors import ArtifactLost, FarfieldError, OverMemory, StageFailed, StoreUnavailable
from farfield.stages import Stage
from farfield.steps.model import Inputs, shard_key
from farfield.store import failures, groups, progress, shards
from farfield.store.artifacts import Artifacts
from farfield.store.fair import Host, next_shard
from farfield.store.groups import Done
from farfield.store.progress import Message
from farfield.store.shards import Claim

from farfield_workers import telemetry
from farfield_workers.compute import Call, Result, Tell, compute, compute_isolated, settings_of
from farfield_workers.lease import HandedOver, ShardStopped, leased, patiently
from farfield_workers.news import news
from farfield_workers.restore import Restorer
from farfield_workers.settings import WorkerSettings
from farfield_workers.table import Pipeline

log = logging.getLogger(__name__)

GROUP_S = 0.25  # what a group should take: short against a lease, long against what claiming it costs
LONGEST_GROUP_S = 1.0  # then what is left of it goes back
MOST_IN_GROUP = 32


def work_next(
    engine: sa.Engine, artifacts: Artifacts, pipeline: Pipeline, settings: WorkerSettings, queue: str, *,
    claimed: Callable[[], object] = bool,
) -> list[Message] | None:  # fmt: skip
    """Run the shard of the queue whose turn it is and return the messages to send; None where there is none.

    claimed  called once we have one, before it is computed
    """
    found = patiently(lambda: next_shard(engine, queue, here(settings)))
    if found is None:
        return None
    if not found.too_large:
        return work(engine, artifacts, pipeline, settings, found.shard_id, claimed=claimed)
    refusal = OverMemory(found.need_bytes, settings.memory_bytes or 0)
    error = {"code": refusal.code, "message": str(refusal), "advice": refusal.advice}
    job_id = patiently(lambda: failures.refuse(engine, found.shard_id, error))
    return advance(engine, artifacts, pipeline, settings, job_id) if job_id is not None else []


def here(settings: WorkerSettings) -> Host:
    """Return the host of this worker, and what it has free."""
    if settings.memory_bytes is None:
        return Host(name=settings.host)
    return Host(name=settings.host, memory_bytes=settings.memory_bytes, free_bytes=_free(int(time.monotonic())))


@functools.lru_cache(maxsize=1)
def _free(second: int) -> int:
    """Return what the system has free, asked once a second."""
    return memory.free_bytes() + memory.resident_bytes()


def work(
    engine: sa.Engine, artifacts: Artifacts, pipeline: Pipeline, settings: WorkerSettings, shard_id: str, *,
    claimed: Callable[[], object] = bool,
) -> list[Message]:  # fmt: skip
    """Run the shard if it is to be run, and return the messages to send."""
    host = Host(name=settings.host, memory_bytes=settings.memory_bytes)
    group = patiently(
        lambda: shards.claim_group(
            engine, shard_id, worker=settings.worker, lease_s=settings.lease_s, host=host, most=pace.most
        )
    )  # fmt: skip
    if not group:
        return []
    claimed()
    if len(group) > 1:
        return _work_group(engine, artifacts, pipeline, settings, group)
    held = group[0]
    with telemetry.here.shard(held):
        try:
            if _run(engine, artifacts, pipeline, settings, held) == "more":
                return []
        except ShardStopped:
            telemetry.here.stopped(held)
            return []
        except Exception as error:
            log.exception("failed")
            state = _given_back(engine, held, error)
            telemetry.here.failed(held, code=_told(error, held.stage)["code"], again=state == "ready")
            if state == "ready":
                return [Message(shard_id, held.queue)]
        return advance(engine, artifacts, pipeline, settings, held.job_id)


def _work_group(
    engine: sa.Engine, artifacts: Artifacts, pipeline: Pipeline, settings: WorkerSettings, group: list[Claim]
) -> list[Message]:
    """Run short shards of one stage, and commit them together (store.groups); return the messages to send.

    The first that fails ends the group as it would have ended alone; what is not begun in time is for who is free.
    """
    began, done, outcome, messages = time.perf_counter(), list[Done](), "more", list[Message]()
    failed: Exception | None = None
    try:
        with ExitStack() as until_done:
            folder = Path(until_done.enter_context(TemporaryDirectory(dir=artifacts.temporary, prefix="shard-")))
            until_done.enter_context(leased(engine, group, settings))
            try:
                for one in _computed(engine, artifacts, pipeline, settings, group, folder, until_done):
                    done.append(one)
                    if time.perf_counter() - began > LONGEST_GROUP_S:
                        break
            except Exception as error:
                failed = error
    except ShardStopped:
        done.clear()
        failed = None  # whose it was is not known without `done`, and it may be another's by now
    if done:
        try:
            outcome, written = patiently(lambda: groups.commit(engine, artifacts, done))
        except Exception as error:  # the store went away: the first has failed, as it would have alone
            failed, written = error, []
            done.clear()
        else:
            pace.note(group[0].stage_id, (time.perf_counter() - began) / len(done))
        for one in written:
            with telemetry.here.shard(one.held):
                telemetry.here.done(one.held, seconds=one.seconds, n_bytes=one.n_bytes, cached=one.cached)
    if failed is not None:
        held = group[len(done)]
        with telemetry.here.shard(held):
            log.error("failed", exc_info=failed)
            state = _given_back(engine, held, failed)
            telemetry.here.failed(held, code=_told(failed, held.stage)["code"], again=state == "ready")
        messages = [Message(held.shard_id, held.queue)] if state == "ready" else messages
        outcome = "last" if state == "failed" else outcome
    # What is committed is ours no more: only what was not run, or could not be written, goes back.
    if patiently(lambda: groups.give_back(engine, group)):
        messages.append(Message(group[-1].shard_id, group[0].queue))
    if outcome == "last":
        return messages + advance(engine, artifacts, pipeline, settings, group[0].job_id)
    return messages


def _computed(
    engine: sa.Engine, artifacts: Artifacts, pipeline: Pipeline, settings: WorkerSettings, group: list[Claim],
    folder: Path, until_done: ExitStack,
) -> Iterator[Done]:  # fmt: skip
    """Yield the shards of a group, each once its result is stored. Raises what the stage raises."""
    keys = [_key(pipeline, held) for held in group]
    known = groups.known_results(engine, group[0].tenant_id, keys)
    call: Call | None = None
    for held, key in zip(group, keys, strict=True):
        with telemetry.here.shard(held):
            found = known.get(key or "")
            if found is not None and artifacts.has(found.artifact_digest):
                n_bytes = artifacts.n_bytes(found.artifact_digest)
                yield Done(held=held, digest=found.artifact_digest, n_bytes=n_bytes, key=key, cached=True,
                           seconds=found.seconds or 0.0, peak_bytes=found.peak_bytes or 0)  # fmt: skip
                continue
            started = time.perf_counter()
            if call is None:  # all read the same files
                mender = restorer(engine, artifacts, pipeline, settings)
                call = mender.mending(lambda: _call(artifacts, group[0], pipeline, folder, until_done), held.job_id)
            made = _compute(pipeline, settings, replace(call, params=held.params), folder / "artifact")
            artifacts.put_file(folder / "artifact", made.digest)
            yield Done(held=held, digest=made.digest, n_bytes=made.n_bytes, cached=False, peak_bytes=made.peak_bytes,
                       key=None if _timed(pipeline, held) else key, seconds=time.perf_counter() - started)  # fmt: skip


class _Pace:
    """How long this worker took for a shard of a stage, the last time: how many it should take at once."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}

    def note(self, stage_id: str, seconds: float) -> None:
        self._seconds = {stage_id: seconds}  # of the stage that it works on: after another one it begins anew

    def most(self, stage_id: str) -> int:
        """Return the shards that take about GROUP_S; 1 where nothing is known."""
        seconds = self._seconds.get(stage_id)
        return 1 if seconds is None else max(1, min(MOST_IN_GROUP, int(GROUP_S / max(seconds, 1e-3))))


pace = _Pace()


def advance(
    engine: sa.Engine, artifacts: Artifacts, pipeline: Pipeline, settings: WorkerSettings, job_id: str
) -> list[Message]:
    """Move the job on; a plan or a report that the store has damaged meanwhile is mended first."""
    mender = restorer(engine, artifacts, pipeline, settings)

    def move() -> list[Message]:
        return patiently(lambda: progress.advance(engine, artifacts, job_id, pipeline.kinds()))

    try:
        return mender.mending(move, job_id)
    except ArtifactLost as error:  # nobody can move it on: it ends, by name
        told = _told(error, "")
        patiently(lambda: progress.spoil(engine, job_id, told))
        return move()


def restorer(engine: sa.Engine, artifacts: Artifacts, pipeline: Pipeline, settings: WorkerSettings) -> Restorer:
    """Return what mends artifacts with the stages of this pipeline."""
    return Restorer(
        engine, artifacts, lambda made, folder, until_done: _call(artifacts, made, pipeline, folder, until_done),
        lambda call, out: _compute(pipeline, settings, call, out),
    )  # fmt: skip


def _given_back(engine: sa.Engine, held: Claim, error: Exception) -> str:
    """Hand the shard back, and return its state (failures.fail)."""
    told, trace = _told(error, held.stage), "".join(traceback.format_exception(error))
    if isinstance(error, StoreUnavailable) or (isinstance(error, OSError) and error.errno in (ENOSPC, EDQUOT)):
        return patiently(lambda: failures.put_off(engine, held, error=told, log=trace))
    # A named error is a fact about the input: another attempt would find the same.
    named = isinstance(error, FarfieldError) and not isinstance(error, StageFailed)
    return patiently(lambda: failures.fail(engine, held, error=told, log=trace, again=not named))


def _run(engine: sa.Engine, artifacts: Artifacts, pipeline: Pipeline, settings: WorkerSettings, held: Claim) -> str:
    """Compute and commit; return what the commit says: whether the job may move on."""
    started = time.perf_counter()
    key = _key(pipeline, held)
    resumes = key is not None and held.kind != "plan" and Stage(held.stage) in pipeline.resumes
    checkpoint = f"{held.tenant_id}-{key.replace(':', '-')}" if key is not None and resumes else None
    with ExitStack() as until_done:
        folder = Path(until_done.enter_context(TemporaryDirectory(dir=artifacts.temporary, prefix="shard-")))
        handed = HandedOver(folder / "checkpoint")
        until_done.enter_context(leased(engine, [held], settings, renewed=handed.give))
        known = shards.known_result(engine, held.tenant_id, key) if key is not None else None
        if known is not None and artifacts.has(known.artifact_digest):
            found = Result(known.artifact_digest, artifacts.n_bytes(known.artifact_digest), known.peak_bytes or 0)
            seconds, cached = known.seconds or 0.0, True
        else:
            mender = restorer(engine, artifacts, pipeline, settings)
            call = mender.mending(lambda: _call(artifacts, held, pipeline, folder, until_done), held.job_id)
            if checkpoint is not None:
                handed.begin(until_done.enter_context(artifacts.checkpoint(checkpoint)))
                call = replace(call, checkpoint=str(handed.mine))
            with news(engine, held) as told:
                found = _compute(pipeline, settings, call, folder / "artifact", tell=told.tell)
            artifacts.put_file(folder / "artifact", found.digest)
            seconds, cached = time.perf_counter() - started, False

    def there() -> None:
        if not artifacts.has(found.digest):  # the same bytes were another job's, which was deleted meanwhile
            raise StageFailed(held.stage, "its result was deleted with another job")

    # What a clock may have stopped is no other job's: it has no key, and its checkpoint stays for who has more time.
    timed = not cached and _timed(pipeline, held)
    outcome = patiently(
        lambda: shards.commit(
            engine, held, digest=found.digest, n_bytes=found.n_bytes, key=None if timed else key, seconds=seconds,
            peak_bytes=found.peak_bytes, cached=cached, check=there,
        )
    )  # fmt: skip
    if outcome == "lost":
        raise ShardStopped
    pace.note(held.stage_id, time.perf_counter() - started)
    telemetry.here.done(held, seconds=seconds, n_bytes=found.n_bytes, cached=cached)
    if checkpoint is not None and not timed:
        artifacts.drop_checkpoint(checkpoint)
    return outcome


def _timed(pipeline: Pipeline, held: Claim) -> bool:
    return held.kind in ("run", "merge") and pipeline.steps[Stage(held.stage)].timed(settings_of(held.settings))


def _compute(
    pipeline: Pipeline, settings: WorkerSettings, call: Call, out: Path, *, tell: Tell | None = None
) -> Result:
    if Stage(call.stage) in pipeline.isolated and call.kind == "run":
        return compute_isolated(
            settings.pipeline, call, out, memory_bytes=settings.scene_memory_bytes, seconds=settings.scene_seconds
        )
    return compute(pipeline, call, out, tell=tell)


def _call(artifacts: Artifacts, held: Claim, pipeline: Pipeline, folder: Path, until_done: ExitStack) -> Call:
    """Return the shard with the files that it reads; they stay there until the stack ends."""

    def local(digest: str) -> str:
        return str(until_done.enter_context(artifacts.local(digest)))

    scene_file = folder / f"scene{held.scene_suffix}"
    if held.stage == Stage.SCENE and not scene_file.exists():  # nobody else reads it
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
    inputs = Inputs(settings_of(held.settings), {}, {Stage(s): digest for s, digest in _digests(held).items()})
    return f"{held.kind}:{shard_key(pipeline.steps[Stage(held.stage)], inputs, shard)}"


def _told(error: Exception, stage: str) -> dict[str, str]:
    """Return what a client may read: never a stack or a path."""
    if isinstance(error, FarfieldError):
        return {"code": error.code, "message": str(error), "advice": error.advice}
    if isinstance(error, OSError) and error.errno in (ENOSPC, EDQUOT):
        return {"code": "DiskFull", "message": f"stage {stage} found no space on the disk",
                "advice": "Ask the operator to make room; a retry then goes on from what is done."}  # fmt: skip
    if isinstance(error, MemoryError):
        return {"code": "OutOfMemory", "message": f"stage {stage} ran out of memory",
                "advice": "Use fewer workers, or a larger machine."}  # fmt: skip
    return {"code": "StageFailed", "message": f"stage {stage} failed: {type(error).__name__}",
            "advice": "Ask the operator for the log of the shard."}  # fmt: skip
