"""Moves a job on: which stage is next, whether it is complete, what to send.

Every step is a compare-and-set on the stage's state in a transaction of its own, after the commit of the shard that may
have been the last. Asked inside that commit, two last shards would each see the other as unfinished, and the job would
stand still. Any number of callers may ask at any time: one of them moves it, the others find nothing to do.

Messages only wake: who gets one takes the shard whose turn it is (`fair`). So a queue needs no more than WINDOW of them,
however many shards are ready, and one that is lost, late or doubled changes nothing.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import sqlalchemy as sa

from farfield.memory import Need
from farfield.stages import Queue
from farfield.store import counters, events, fair
from farfield.store.artifacts import Artifacts
from farfield.store.engine import new_id, now, read, write
from farfield.store.shards import LEASE_S, MAX_ATTEMPTS, lapsed, lock_job
from farfield.store.tables import artifact, job, shard, stage

WINDOW = 64  # messages of a queue that wait: enough for as many workers to be woken at once
DIED = {"code": "WorkerDied", "message": f"{MAX_ATTEMPTS} workers died while they worked on it",
        "advice": "Most likely there was too little memory: use fewer workers, or a larger machine."}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class StageKind:
    """What moving on needs to know of a stage."""

    queue: str
    merges: bool  # False: its one run shard's artifact is the stage's
    optional: bool = False  # True: the job goes on without it where it fails
    inputs: tuple[str, ...] = ()  # the stages that its shards read
    need: Need = field(default_factory=Need)  # memory of its shards


@dataclass(frozen=True, slots=True)
class Message:
    """Tell a worker of this queue that this shard is ready."""

    shard_id: str
    queue: str


def advance(engine: sa.Engine, artifacts: Artifacts, job_id: str, kinds: Mapping[str, StageKind]) -> list[Message]:
    """Move the job as far as it goes, and return the messages for the shards that this made ready."""
    while True:
        with write(engine) as tx:
            moved, messages = _step(tx, artifacts, job_id, kinds)
        if messages or not moved:
            return messages


def fail_job(tx: sa.Connection, job_id: str, stage_id: str, error: Mapping[str, Any]) -> None:
    """End the job with the shard's error: what is done stays, what is not is cancelled."""
    updated = tx.execute(
        sa.update(job).where(job.c.id == job_id, job.c.state.in_(("queued", "running")))
        .values(state="failed", error=dict(error), finished_at=now())
    ).rowcount  # fmt: skip
    if updated:
        tx.execute(sa.update(stage).where(stage.c.id == stage_id).values(state="failed", finished_at=now()))
        counters.count_job(tx, "failed", str(error.get("code")))
        drop_shards(tx, job_id)
        events.append(tx, job_id, "stage", {"stage": error.get("stage"), "state": "failed"})
        events.append(tx, job_id, "job", {"state": "failed", "error": dict(error)})


def spoil(engine: sa.Engine, job_id: str, error: Mapping[str, Any]) -> None:
    """Fail the shard whose result, a plan or the report, the job's next step reads, and cannot: `advance` then ends the job,
    and a retry computes it anew.
    """
    with write(engine) as tx:
        lock_job(tx, job_id)
        of = (stage.c.job_id == job_id) & stage.c.state.in_(("planning", "reporting"))
        at = tx.execute(sa.select(stage.c.id, stage.c.name, stage.c.state).where(of)).one_or_none()
        if at is None:
            return
        kind = {"planning": "plan", "reporting": "report"}[at.state]
        read_next = (shard.c.stage_id == at.id) & (shard.c.kind == kind) & (shard.c.state == "done")
        if tx.execute(sa.update(shard).where(read_next).values(state="failed", error=dict(error))).rowcount:
            fact = {"stage": at.name, "kind": kind, "ordinal": 0, "state": "failed", "error": dict(error)}
            events.append(tx, job_id, "shard", fact)


def drop_shards(tx: sa.Connection, job_id: str) -> None:
    """Cancel what is ready or running; a worker notices at its next renewal or commit."""
    open_ = shard.c.state.in_(("ready", "running"))
    tx.execute(sa.update(shard).where(shard.c.job_id == job_id, open_).values(state="cancelled", lease_until=None))


def waiting(engine: sa.Engine, queue: str, *, limit: int = WINDOW) -> int:
    """Return how many shards of the queue are ready, counted up to `limit`: those that a worker would take (`fair`)."""
    alive = sa.select(job.c.id).where(job.c.id == shard.c.job_id, job.c.finished_at.is_(None)).exists()
    with read(engine) as tx:
        some = sa.select(shard.c.id).where(fair.READY, alive).limit(limit).subquery()
        return int(tx.scalar(sa.select(sa.func.count()).select_from(some), {"of_queue": queue}) or 0)


def ready(engine: sa.Engine, *, limit: int = 1000) -> list[Message]:
    """Return shards that are ready, in order of their stages and places: for who runs them without a broker."""
    with read(engine) as tx:
        rows = tx.execute(
            sa.select(shard.c.id, shard.c.queue).join(stage, stage.c.id == shard.c.stage_id)
            .join(job, job.c.id == shard.c.job_id).where(shard.c.state == "ready", job.c.finished_at.is_(None))
            .order_by(job.c.created_at, stage.c.ordinal, shard.c.ordinal).limit(limit)
        ).all()  # fmt: skip
    return [Message(r.id, r.queue) for r in rows]


def window(messages: Iterable[Message]) -> list[Message]:
    """Return as many of the messages as are of use: WINDOW a queue."""
    taken: dict[str, list[Message]] = {}
    for message in messages:
        mine = taken.setdefault(message.queue, [])
        if len(mine) < WINDOW:
            mine.append(message)
    return [message for mine in taken.values() for message in mine]


def reclaim(engine: sa.Engine, *, lease_s: float = LEASE_S) -> int:
    """Make ready what leases that ran out still hold, or fail it after its last attempt; return how many shards."""
    with read(engine) as tx:
        if tx.scalar(sa.select(shard.c.id).where(lapsed(lease_s)).limit(1)) is None:
            return 0
    return _take_back(engine, lapsed(lease_s))


def release_worker(engine: sa.Engine, worker: str | None) -> int:
    """Take back what a worker holds that is known to be dead (None: what all hold): nobody waits for its lease to lapse."""
    mine = shard.c.worker == worker if worker is not None else sa.true()
    return _take_back(engine, (shard.c.state == "running") & mine)


def _take_back(engine: sa.Engine, which: sa.ColumnElement[bool]) -> int:
    with write(engine) as tx:
        rows = tx.execute(
            sa.select(shard.c.id, shard.c.job_id, shard.c.kind, shard.c.ordinal, shard.c.attempt, shard.c.claims,
                      stage.c.name)
            .join(stage, stage.c.id == shard.c.stage_id).where(which).order_by(shard.c.job_id, shard.c.id)
        ).all()  # fmt: skip
        number = 0
        for row in rows:
            lock_job(tx, row.job_id)
            over = row.attempt >= MAX_ATTEMPTS
            values = {"state": "failed", "error": DIED} if over else {"state": "ready", "ready_at": now()}
            # Another may have been here first, or the worker may have been faster after all.
            same = (shard.c.id == row.id) & (shard.c.claims == row.claims) & which
            if tx.execute(sa.update(shard).where(same).values(lease_until=None, **values)).rowcount:
                number += 1
                counters.count_lost(tx, row.name)
                fact = {"stage": row.name, "kind": row.kind, "ordinal": row.ordinal, "state": values["state"]}
                events.append(
                    tx, row.job_id, "shard", {**fact, "attempt": row.attempt, "error": DIED if over else LOST}
                )
                released = sa.update(job).where(job.c.id == row.job_id, job.c.optimizer_shard_id == row.id)
                tx.execute(released.values(optimizer_until=None, optimizer_shard_id=None))
        return number


LOST = {"code": "WorkerLost", "message": "its worker is gone or does not answer; another takes it over", "advice": ""}


def standing_still(engine: sa.Engine) -> list[str]:
    """Return jobs that run and have no shard ready or running: a worker died between commit and advance."""
    busy = sa.select(shard.c.id).where(shard.c.job_id == job.c.id, shard.c.state.in_(("ready", "running")))
    with read(engine) as tx:
        return list(tx.scalars(sa.select(job.c.id).where(job.c.finished_at.is_(None), ~busy.exists())))


def hand_back(engine: sa.Engine, worker: str | None = None) -> int:
    """Make ready again what a worker runs that has been stopped (None: all): a stop is no fault of a shard, no attempt.

    Else three stops of the service during a long shard would fail its job.
    """
    mine = shard.c.worker == worker if worker is not None else sa.true()
    with write(engine) as tx:
        return tx.execute(
            sa.update(shard).where(shard.c.state == "running", mine)
            .values(state="ready", attempt=shard.c.attempt - 1, lease_until=None, ready_at=now())
        ).rowcount  # fmt: skip


def _step(
    tx: sa.Connection, artifacts: Artifacts, job_id: str, kinds: Mapping[str, StageKind]
) -> tuple[bool, list[Message]]:
    """Make one transition. Returns (whether the job moved, messages)."""
    lock_job(tx, job_id)
    state = tx.scalar(sa.select(job.c.state).where(job.c.id == job_id))
    if state not in ("queued", "running"):
        return False, []
    ended = ("done", "skipped", "failed")
    stages = tx.execute(sa.select(stage).where(stage.c.job_id == job_id).order_by(stage.c.ordinal)).all()
    at = next((s for s in stages if s.state not in ended), None)
    if at is None:
        return False, []
    kind = kinds[at.name]
    # Once it is reporting, a shard that failed before is the reason why the stage is reported as failed.
    failed = sa.select(shard.c.error).where(
        shard.c.job_id == job_id, shard.c.state == "failed", shard.c.stage_id == at.id,
        (shard.c.kind == "report") == (at.state == "reporting"),
    )  # fmt: skip
    broken = tx.execute(failed.limit(1)).one_or_none()
    if broken is not None:
        error = {**(broken.error or {}), "stage": at.name}
        if not (kind.optional and at.state != "reporting"):
            fail_job(tx, job_id, at.id, error)
            return True, []
        drop_shards(tx, job_id)
        reason = f"failed: {error.get('message')}"
        if at is not stages[-1]:
            return _set(tx, at, "failed", skipped=reason, finished_at=now()), []
        moved = _set(tx, at, "reporting", skipped=reason)
        return moved, _add(tx, at, kind, "report", [None], Queue.CPU) if moved else []

    def result(of: str) -> str | None:
        first = (shard.c.stage_id == at.id) & (shard.c.kind == of) & (shard.c.ordinal == 0) & (shard.c.state == "done")
        return tx.scalar(sa.select(shard.c.artifact_digest).where(first))

    if at.state == "waiting":
        if _set(tx, at, "planning", started_at=now(), queue=kind.queue):
            return True, _add(tx, at, kind, "plan", [None], Queue.CPU)
    elif at.state == "planning" and (digest := result("plan")) is not None:
        plan = json.loads(bytes(artifacts.buffer(digest)))
        skipped, params = plan["skip"], plan["shards"]
        after = "running" if params else "merging"
        if _set(tx, at, after, skipped=skipped, queue=kind.queue, total=len(params), n_shards=len(params)):
            if params:
                # Regions are pure functions that run at once; the optimizer's one lease is for who joins them.
                apart = len(params) > 1 and kind.queue == Queue.OPTIMIZER
                return True, _add(tx, at, kind, "run", params, Queue.CPU if apart else kind.queue)
            return True, _add(tx, at, kind, "merge", [None], kind.queue)
    elif at.state == "running" and at.n_done == at.n_shards:
        if kind.merges:
            if _set(tx, at, "merging"):
                return True, _add(tx, at, kind, "merge", [None], kind.queue)
        else:
            digest = result("run")
            assert digest is not None
            return _finish(tx, at, kind, digest, last=at is stages[-1])
    elif at.state == "merging" and (digest := result("merge")) is not None:
        return _finish(tx, at, kind, digest, last=at is stages[-1])
    elif at.state == "reporting" and (digest := result("report")) is not None:
        report = json.loads(bytes(artifacts.buffer(digest)))
        verdict = report.get("verdict")
        final = "done" if at.artifact_digest else "failed"
        if at.skipped and at.artifact_digest:
            final = "skipped"
        if _set(tx, at, final, finished_at=now()):
            tx.execute(
                sa.update(job).where(job.c.id == job_id)
                .values(state="done", verdict=verdict, report_digest=digest, figures=_figures(report), finished_at=now())
            )  # fmt: skip
            events.append(tx, job_id, "job", {"state": "done", "verdict": verdict})
            counters.count_job(tx, "done")
            return True, []
    return False, []


def _figures(report: Mapping[str, Any]) -> dict[str, Any]:
    """What a list of jobs shows of each, so that it need not read their reports."""
    smallest = (report.get("smallest_budget") or {}).get("text")
    return {"bytes": report.get("bytes"), "hopeless_views": report.get("hopeless_views"), "smallest_budget": smallest}


def _finish(
    tx: sa.Connection, at: sa.Row[Any], kind: StageKind, digest: str, *, last: bool
) -> tuple[bool, list[Message]]:
    if last:
        moved = _set(tx, at, "reporting", artifact_digest=digest)
        return moved, _add(tx, at, kind, "report", [None], Queue.CPU) if moved else []
    return _set(tx, at, "skipped" if at.skipped else "done", artifact_digest=digest, finished_at=now()), []


def _set(tx: sa.Connection, at: sa.Row[Any], state: str, *, total: int | None = None, **values: Any) -> bool:
    """Compare-and-set the stage's state; the event goes with it."""
    where = (stage.c.id == at.id) & (stage.c.state == at.state)
    if not tx.execute(sa.update(stage).where(where).values(state=state, **values)).rowcount:
        return False
    data: dict[str, Any] = {"stage": at.name, "state": state}
    skipped = values.get("skipped", at.skipped)
    data.update({"skipped": skipped} if skipped else {}, **({"shards": total} if total is not None else {}))
    events.append(tx, at.job_id, "stage", data)
    if "finished_at" in values and at.started_at is not None:
        counters.count_stage(tx, at.name, state, float(tx.scalar(sa.select(now())) or 0.0) - at.started_at)
    return True


def _add(
    tx: sa.Connection, at: sa.Row[Any], stage_kind: StageKind, kind: str, params: list[Any], queue: str
) -> list[Message]:
    need_bytes = _need(tx, at, stage_kind, kind)
    rows = [
        {"id": new_id(), "tenant_id": at.tenant_id, "job_id": at.job_id, "stage_id": at.id, "kind": kind, "ordinal": i,
         "queue": str(queue), "params": p, "state": "ready", "attempt": 0, "cached": False, "need_bytes": need_bytes}
        for i, p in enumerate(params)
    ]  # fmt: skip
    tx.execute(sa.insert(shard), rows)
    return [Message(r["id"], r["queue"]) for r in rows]


def _need(tx: sa.Connection, at: sa.Row[Any], stage_kind: StageKind, kind: str) -> int:
    """Return the memory that each of these shards may take, from the sizes of what it reads."""
    before = (stage.c.job_id == at.job_id) & (stage.c.ordinal < at.ordinal)
    sizes = tx.execute(
        sa.select(stage.c.name, artifact.c.n_bytes).join(artifact, artifact.c.digest == stage.c.artifact_digest)
        .where(before)
    )  # fmt: skip
    inputs = {r.name: r.n_bytes for r in sizes if kind == "report" or r.name in stage_kind.inputs}
    if not stage_kind.inputs:  # the first stage reads the file
        scene_digest = sa.select(job.c.scene_digest).where(job.c.id == at.job_id).scalar_subquery()
        inputs["file"] = int(tx.scalar(sa.select(artifact.c.n_bytes).where(artifact.c.digest == scene_digest)) or 0)
    pieces = 0
    if kind == "merge":
        joined = sa.select(sa.func.sum(artifact.c.n_bytes)).join(shard, shard.c.artifact_digest == artifact.c.digest)
        pieces = int(tx.scalar(joined.where(shard.c.stage_id == at.id, shard.c.kind == "run")) or 0)
    return stage_kind.need.bytes(kind, inputs, pieces)
