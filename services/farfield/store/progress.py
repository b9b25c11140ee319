"""Moves a job on: which stage is next, whether it is complete, what to send.

Every step is a compare-and-set on the stage's state in a transaction of its own, after the commit of the shard that may
have been the last. Asked inside that commit, two last shards would each see the other as unfinished, and the job would
stand still. Any number of callers may ask at any time: one of them moves it, the others find nothing to do.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from farfield.stages import Queue
from farfield.store import events
from farfield.store.artifacts import Artifacts
from farfield.store.engine import new_id, now, write
from farfield.store.shards import MAX_ATTEMPTS, lock_job
from farfield.store.tables import job, shard, stage

RESEND_S = 60.0  # sooner, a backlog would triple its messages


@dataclass(frozen=True, slots=True, kw_only=True)
class StageKind:
    """What moving on needs to know of a stage."""

    queue: str
    merges: bool  # False: its one run shard's artifact is the stage's
    optional: bool = False  # True: the job goes on without it where it fails


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
        drop_shards(tx, job_id)
        events.append(tx, job_id, "stage", {"stage": error.get("stage"), "state": "failed"})
        events.append(tx, job_id, "job", {"state": "failed", "error": dict(error)})


def drop_shards(tx: sa.Connection, job_id: str) -> None:
    """Cancel what is ready or running; a worker notices at its next renewal or commit."""
    open_ = shard.c.state.in_(("ready", "running"))
    tx.execute(sa.update(shard).where(shard.c.job_id == job_id, open_).values(state="cancelled", lease_until=None))


def mark_sent(engine: sa.Engine, shard_ids: list[str]) -> None:
    """Remember that these shards' messages are with the broker."""
    with write(engine) as tx:
        tx.execute(sa.update(shard).where(shard.c.id.in_(shard_ids)).values(sent_at=now()))


def undelivered(engine: sa.Engine, *, resend_s: float = RESEND_S, limit: int = 1000) -> list[Message]:
    """Return the shards to (re-)send, marked as sent: ready or with a lapsed lease, and not sent for a while.

    A shard whose lease lapsed on its last attempt fails here, and is left to `advance`.
    """
    lapsed = (shard.c.state == "running") & (shard.c.lease_until < now())
    with write(engine) as tx:
        error = {"code": "WorkerDied", "message": f"{MAX_ATTEMPTS} workers died while they worked on it",
                 "advice": "Most likely there was too little memory: use fewer workers, or a larger machine."
                 }  # fmt: skip
        tx.execute(
            sa.update(shard).where(lapsed, shard.c.attempt >= MAX_ATTEMPTS)
            .values(state="failed", lease_until=None, error=error)
        )  # fmt: skip
        unsent = shard.c.sent_at.is_(None) | (shard.c.sent_at < now() - resend_s)
        alive = sa.select(job.c.id).where(job.c.id == shard.c.job_id, job.c.state.in_(("queued", "running")))
        rows = tx.execute(
            sa.select(shard.c.id, shard.c.queue)
            .where((shard.c.state == "ready") | lapsed, unsent, alive.exists())
            .order_by(shard.c.sent_at.is_not(None), shard.c.sent_at).limit(limit)
        ).all()  # fmt: skip
        tx.execute(sa.update(shard).where(shard.c.id.in_([r.id for r in rows])).values(sent_at=now()))
    return [Message(r.id, r.queue) for r in rows]


def standing_still(engine: sa.Engine) -> list[str]:
    """Return jobs that run and have no shard ready or running: a worker died between commit and advance."""
    busy = sa.select(shard.c.id).where(shard.c.job_id == job.c.id, shard.c.state.in_(("ready", "running")))
    with write(engine) as tx:
        return list(tx.scalars(sa.select(job.c.id).where(job.c.state.in_(("queued", "running")), ~busy.exists())))


def release_worker(engine: sa.Engine, worker: str | None) -> int:
    """End the leases of a worker that is known to be dead (None: of all), so that nobody waits for them to lapse."""
    mine = shard.c.worker == worker if worker is not None else sa.true()
    with write(engine) as tx:
        return tx.execute(
            sa.update(shard).where(shard.c.state == "running", mine).values(lease_until=now() - 1.0, sent_at=None)
        ).rowcount


def hand_back(engine: sa.Engine) -> int:
    """Make what runs ready again. Only for who has stopped all workers: a stop is no fault of a shard, and no attempt.

    Else three stops of the service during a long shard would fail its job.
    """
    with write(engine) as tx:
        return tx.execute(
            sa.update(shard).where(shard.c.state == "running")
            .values(state="ready", attempt=shard.c.attempt - 1, lease_until=None, sent_at=None)
        ).rowcount  # fmt: skip


def forget_sent(engine: sa.Engine) -> None:
    """Take all messages for lost: the broker is a new one, so whatever is ready is to be sent again now."""
    with write(engine) as tx:
        tx.execute(sa.update(shard).where(shard.c.state == "ready").values(sent_at=None))


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
    shards = tx.execute(
        sa.select(shard.c.kind, shard.c.state, shard.c.artifact_digest, shard.c.error).where(shard.c.stage_id == at.id)
    ).all()
    # Once it is reporting, a shard that failed before is the reason why the stage is reported as failed.
    broken = next(
        (s for s in shards if s.state == "failed" and (s.kind == "report") == (at.state == "reporting")), None
    )
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
        return moved, _add(tx, at, "report", [None], Queue.CPU) if moved else []
    done = {k: [s for s in shards if s.kind == k and s.state == "done"] for k in ("plan", "run", "merge", "report")}
    if at.state == "waiting":
        if _set(tx, at, "planning", started_at=now(), queue=kind.queue):
            return True, _add(tx, at, "plan", [None], Queue.CPU)
    elif at.state == "planning" and done["plan"]:
        plan = json.loads(bytes(artifacts.buffer(done["plan"][0].artifact_digest)))
        skipped, params = plan["skip"], plan["shards"]
        after = "running" if params else "merging"
        if _set(tx, at, after, skipped=skipped, queue=kind.queue, total=len(params)):
            if params:
                # Regions are pure functions that run at once; the optimizer's one lease is for who joins them.
                apart = len(params) > 1 and kind.queue == Queue.OPTIMIZER
                return True, _add(tx, at, "run", params, Queue.CPU if apart else kind.queue)
            return True, _add(tx, at, "merge", [None], kind.queue)
    elif at.state == "running" and len(done["run"]) == sum(s.kind == "run" for s in shards):
        if kind.merges:
            if _set(tx, at, "merging"):
                return True, _add(tx, at, "merge", [None], kind.queue)
        else:
            return _finish(tx, at, done["run"][0].artifact_digest, last=at is stages[-1])
    elif at.state == "merging" and done["merge"]:
        return _finish(tx, at, done["merge"][0].artifact_digest, last=at is stages[-1])
    elif at.state == "reporting" and done["report"]:
        digest = done["report"][0].artifact_digest
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
            return True, []
    return False, []


def _figures(report: Mapping[str, Any]) -> dict[str, Any]:
    """What a list of jobs shows of each, so that it need not read their reports."""
    smallest = (report.get("smallest_budget") or {}).get("text")
    return {"bytes": report.get("bytes"), "hopeless_views": report.get("hopeless_views"), "smallest_budget": smallest}


def _finish(tx: sa.Connection, at: sa.Row[Any], digest: str, *, last: bool) -> tuple[bool, list[Message]]:
    if last:
        moved = _set(tx, at, "reporting", artifact_digest=digest)
        return moved, _add(tx, at, "report", [None], Queue.CPU) if moved else []
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
    return True


def _add(tx: sa.Connection, at: sa.Row[Any], kind: str, params: list[Any], queue: str) -> list[Message]:
    rows = [
        {"id": new_id(), "tenant_id": at.tenant_id, "job_id": at.job_id, "stage_id": at.id, "kind": kind, "ordinal": i,
         "queue": str(queue), "params": p, "state": "ready", "attempt": 0, "cached": False}
        for i, p in enumerate(params)
    ]  # fmt: skip
    tx.execute(sa.insert(shard), rows)
    return [Message(r["id"], r["queue"]) for r in rows]
