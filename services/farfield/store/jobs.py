"""Jobs of a tenant: created, listed, read, cancelled, retried, deleted."""

import hashlib
import json
from collections.abc import Callable, Sequence
from typing import Any

import sqlalchemy as sa

from farfield.errors import (
    IdempotencyConflict,
    JobNotFound,
    JobNotStopped,
    JobStillRunning,
    SceneNotFound,
    WebhookNotFound,
)
from farfield.stages import Queue
from farfield.store import counters, events, quotas
from farfield.store.engine import new_id, now, read, write
from farfield.store.pages import ALL, Cursor, holding, newest_first, owned
from farfield.store.progress import Message, drop_shards
from farfield.store.quotas import Quota
from farfield.store.shards import anew, lock_job
from farfield.store.tables import PRIORITIES, SHARD_STATES, event, job, scene, shard, stage, tenant, webhook

ENDED = ("done", "failed", "cancelled")
NO_QUOTA = Quota()


def create(
    engine: sa.Engine, tenant_id: str, *, name: str, scene_digest: str, settings: dict[str, Any],
    stages: Sequence[str], idempotency_key: str | None, device_profile_id: str | None = None,
    asked: dict[str, Any] | None = None, priority: str = "normal", webhook_id: str | None = None,
    quota: Quota = NO_QUOTA,
) -> tuple[str, Message | None]:  # fmt: skip
    """Return (job id, message for its first shard); no message where the idempotency key is known.

    asked       the settings as the request had them, where those of the job hold more: what its device has by now
    webhook_id  a webhook of the tenant that is told of this job, whether it is of all others or not
    quota       of tenants that have none of their own
    Raises SceneNotFound, WebhookNotFound, QuotaExceeded, and IdempotencyConflict where the key came with another request
    before.
    """
    request = [name, scene_digest, settings if asked is None else asked, *([webhook_id] if webhook_id else [])]
    text = json.dumps(request, sort_keys=True, separators=(",", ":"))
    request_digest = hashlib.sha256(text.encode()).hexdigest()
    with write(engine) as tx:
        if tx.dialect.name == "postgresql" and idempotency_key is not None:
            # Two equal requests at once: the second waits here for the first, SQLite's writers queue by themselves.
            tx.execute(sa.select(sa.func.pg_advisory_xact_lock(sa.func.hashtext(tenant_id + idempotency_key))))
        if idempotency_key is not None:
            known = tx.execute(
                sa.select(job.c.id, job.c.request_digest)
                .where(job.c.tenant_id == tenant_id, job.c.idempotency_key == idempotency_key)
            ).one_or_none()  # fmt: skip
            if known is not None:
                if known.request_digest != request_digest:
                    raise IdempotencyConflict(idempotency_key)
                return known.id, None
        sent = sa.select(scene.c.digest).where(scene.c.tenant_id == tenant_id, scene.c.digest == scene_digest)
        if tx.scalar(sent) is None:
            raise SceneNotFound(scene_digest)
        hook = sa.select(webhook.c.id).where(webhook.c.tenant_id == tenant_id, webhook.c.id == webhook_id)
        if webhook_id is not None and tx.scalar(hook) is None:
            raise WebhookNotFound(webhook_id)
        quotas.check_job(tx, tenant_id, quota)
        job_id = new_id()
        tx.execute(
            sa.insert(job).values(
                id=job_id, tenant_id=tenant_id, name=name, scene_digest=scene_digest, settings=settings,
                device_profile_id=device_profile_id, webhook_id=webhook_id, idempotency_key=idempotency_key,
                request_digest=request_digest, state="queued", event_seq=0, optimizer_token=0, created_at=now(),
                priority=PRIORITIES.index(priority), turn=sa.select(sa.func.max(tenant.c.turn)).scalar_subquery(),
            )
        )  # fmt: skip
        rows = [
            {"id": new_id(), "tenant_id": tenant_id, "job_id": job_id, "ordinal": i, "name": str(stage_name),
             "state": "waiting"}
            for i, stage_name in enumerate(stages)
        ]  # fmt: skip
        tx.execute(sa.insert(stage), rows)
        tx.execute(sa.update(stage).where(stage.c.id == rows[0]["id"]).values(state="planning", started_at=now()))
        first = {"id": new_id(), "tenant_id": tenant_id, "job_id": job_id, "stage_id": rows[0]["id"], "kind": "plan",
                 "ordinal": 0, "queue": str(Queue.CPU), "params": None, "state": "ready", "attempt": 0,
                 "cached": False}  # fmt: skip
        tx.execute(sa.insert(shard).values(first))
        events.append(tx, job_id, "job", {"state": "queued"})
    return job_id, Message(str(first["id"]), Queue.CPU)


def get(engine: sa.Engine, tenant_id: str, job_id: str) -> sa.Row[Any]:
    """Return the job's row. Raises JobNotFound, also where it is another tenant's."""
    with read(engine) as tx:
        return _row(tx, tenant_id, job_id)


def stages_of(engine: sa.Engine, job_id: str) -> list[dict[str, Any]]:
    """Return the job's stages in order, each with its shards counted by state, its seconds and its peak of memory."""
    return stages_of_all(engine, [job_id])[job_id]


def stages_of_all(engine: sa.Engine, job_ids: Sequence[str]) -> dict[str, list[dict[str, Any]]]:
    """Return `stages_of` for each of the jobs, in two queries whose cost does not grow with the shards that are done."""
    with read(engine) as tx:
        return _stages(tx, job_ids)


def shown(engine: sa.Engine, tenant_id: str, job_id: str) -> tuple[sa.Row[Any], list[dict[str, Any]]]:
    """Return `get` and `stages_of`, as they are at one moment. Raises JobNotFound."""
    with read(engine) as tx:
        return _row(tx, tenant_id, job_id), _stages(tx, [job_id])[job_id]


def _stages(tx: sa.Connection, job_ids: Sequence[str]) -> dict[str, list[dict[str, Any]]]:
    rows = tx.execute(_STAGES, {"jobs": list(job_ids)}).all()
    counts = {(r.stage_id, r.state): r.n for r in tx.execute(_FEW, {"jobs": list(job_ids)})}
    found: dict[str, list[dict[str, Any]]] = {job_id: [] for job_id in job_ids}
    for r in rows:
        by_state = dict.fromkeys(SHARD_STATES, 0)
        by_state.update({s: counts.get((r.id, s), 0) for s in ("running", "failed")}, done=r.n_done)
        # What neither runs nor has ended waits, or has been dropped with its stage or its job.
        rest = r.n_shards - sum(by_state.values())
        by_state["ready" if r.state == "running" and r.job_ended is None else "cancelled"] = max(rest, 0)
        ended = r.finished_at if r.finished_at is not None else r.clock
        found[r.job_id].append({
            "name": r.name, "state": r.state, "skipped": r.skipped, "shards": {"total": r.n_shards, **by_state},
            "seconds": round(ended - r.started_at, 3) if r.started_at is not None else None,
            "peak_bytes": r.peak_bytes, "artifact": r.artifact_digest,
        })  # fmt: skip
    return found


def artifact_of(engine: sa.Engine, job_id: str, stage_name: str) -> str | None:
    """Return the digest of the stage's result, None where there is none (yet)."""
    with read(engine) as tx:
        return tx.scalar(
            sa.select(stage.c.artifact_digest).where(stage.c.job_id == job_id, stage.c.name == stage_name)
        )  # fmt: skip


def shards_of(
    engine: sa.Engine, job_id: str, stage_name: str, *, start: int = 0, limit: int | None = None
) -> list[sa.Row[Any]]:
    """Return the stage's shards, in order of kind and place: those of place `start` on, at most `limit` of them."""
    with read(engine) as tx:
        return list(
            tx.execute(
                sa.select(shard).join(stage, stage.c.id == shard.c.stage_id)
                .where(shard.c.job_id == job_id, stage.c.name == stage_name, shard.c.ordinal >= start)
                .order_by(shard.c.kind, shard.c.ordinal).limit(limit)
            )
        )  # fmt: skip


def page(
    engine: sa.Engine, tenant_id: str, *, before: Cursor | None, limit: int, state: str | None = None,
    scene_digest: str | None = None, verdict: str | None = None, name: str | None = None, since: float | None = None,
    until: float | None = None,
) -> list[sa.Row[Any]]:  # fmt: skip
    """Return up to `limit` jobs, newest first, after the cursor.

    name          some of the job's name, whatever the case
    since, until  seconds since 1970 UTC: created then or later, and before
    """
    wanted = [
        owned(job.c.tenant_id, tenant_id),
        *(column == value for column, value in ((job.c.state, state), (job.c.scene_digest, scene_digest),
                                                (job.c.verdict, verdict)) if value is not None),
        *((holding(job.c.name, name),) if name is not None else ()),
        *((job.c.created_at >= since,) if since is not None else ()),
        *((job.c.created_at < until,) if until is not None else ()),
    ]  # fmt: skip
    query = newest_first(sa.select(job).where(*wanted), job.c.created_at, job.c.id, before=before, limit=limit)
    with read(engine) as tx:
        return list(tx.execute(query))


def cancel(engine: sa.Engine, tenant_id: str, job_id: str) -> str:
    """Cancel the job if it has not ended, and return its state. Raises JobNotFound."""
    with write(engine) as tx:
        lock_job(tx, job_id)
        row = _row(tx, tenant_id, job_id)
        updated = tx.execute(
            sa.update(job).where(job.c.id == job_id, job.c.state.in_(("queued", "running")))
            .values(state="cancelled", finished_at=now())
        ).rowcount  # fmt: skip
        if not updated:
            return str(row.state)
        begun = stage.c.started_at.is_not(None) & stage.c.finished_at.is_(None)
        tx.execute(sa.update(stage).where(stage.c.job_id == job_id, begun).values(finished_at=now()))
        drop_shards(tx, job_id)
        events.append(tx, job_id, "job", {"state": "cancelled"})
        counters.count_job(tx, "cancelled")
        return "cancelled"


def retry(engine: sa.Engine, tenant_id: str, job_id: str, *, quota: Quota = NO_QUOTA) -> list[Message]:
    """Let a failed or cancelled job go on from what is done; return the messages for its shards.

    Shards that failed or were cancelled begin anew. Raises JobNotFound, JobNotStopped, QuotaExceeded.
    """
    with write(engine) as tx:
        lock_job(tx, job_id)
        row = _row(tx, tenant_id, job_id)
        if row.state not in ("failed", "cancelled"):
            raise JobNotStopped(job_id, row.state)
        quotas.check_job(tx, row.tenant_id, quota, stored=0)
        undone = (shard.c.job_id == job_id) & shard.c.state.in_(("failed", "cancelled"))
        query = sa.select(shard).where(undone).order_by(shard.c.kind, shard.c.ordinal)
        rows = [anew(r) for r in tx.execute(query).all()]
        tx.execute(sa.delete(shard).where(undone))
        if rows:
            tx.execute(sa.insert(shard), rows)
        for at in tx.execute(sa.select(stage).where(stage.c.job_id == job_id).order_by(stage.c.ordinal)).all():
            kinds = set(tx.scalars(sa.select(shard.c.kind).where(shard.c.stage_id == at.id)))
            open_ = at.state not in ("done", "skipped", "waiting")
            # A stage that failed is where its latest shards are; an optional one that failed has been gone on from.
            if open_ and (at.state != "failed" or any(r["stage_id"] == at.id for r in rows)):
                state = next(name for kind, name in _AT if kind in kinds)
                tx.execute(sa.update(stage).where(stage.c.id == at.id).values(state=state, finished_at=None))
                events.append(tx, job_id, "stage", {"stage": at.name, "state": state})
        tx.execute(
            sa.update(job).where(job.c.id == job_id)
            .values(state="queued", error=None, finished_at=None, optimizer_until=None, optimizer_shard_id=None)
        )  # fmt: skip
        events.append(tx, job_id, "job", {"state": "queued"})
    return [Message(r["id"], r["queue"]) for r in rows]


_AT = (("report", "reporting"), ("merge", "merging"), ("run", "running"), ("plan", "planning"))


def delete(
    engine: sa.Engine, tenant_id: str, job_id: str, *, dry_run: bool, expect: Callable[[sa.Row[Any]], object] = bool
) -> dict[str, int]:
    """Delete an ended job and return what goes with it; its blobs are left to the collection of garbage.

    What goes with it is counted within the tenant: artifacts and bytes that no other job or scene of it needs. Whether
    another tenant has the same bytes cannot be told from it.

    expect  is called with the job's row, and may refuse
    Raises JobNotFound, JobStillRunning.
    """
    with write(engine) as tx:
        lock_job(tx, job_id)
        row = _row(tx, tenant_id, job_id)
        expect(row)
        if row.state not in ENDED:
            raise JobStillRunning(job_id, row.state)
        mine = quotas.digests(row.tenant_id, only_job=job_id)
        number, n_bytes = quotas.needed_bytes(tx, of=mine, but=quotas.digests(row.tenant_id, but_job=job_id))
        counts = {
            "shards": tx.scalar(sa.select(sa.func.count()).select_from(shard).where(shard.c.job_id == job_id)) or 0,
            "events": tx.scalar(sa.select(sa.func.count()).select_from(event).where(event.c.job_id == job_id)) or 0,
            "artifacts": number, "bytes": n_bytes,
        }  # fmt: skip
        if dry_run:
            return counts
        for table in (event, shard, stage):
            tx.execute(sa.delete(table).where(table.c.job_id == job_id))
        tx.execute(sa.delete(job).where(job.c.id == job_id))
        return counts


def _row(tx: sa.Connection, tenant_id: str, job_id: str) -> sa.Row[Any]:
    row = tx.execute(_OF_ALL if tenant_id == ALL else _OF_TENANT, {"job": job_id, "tenant": tenant_id}).one_or_none()
    if row is None:
        raise JobNotFound(job_id)
    return row


# What every look at a job asks, made once: to make a statement takes longer than to run it.
_OF_ALL = sa.select(job).where(job.c.id == sa.bindparam("job"))
_OF_TENANT = _OF_ALL.where(job.c.tenant_id == sa.bindparam("tenant"))
_STAGES = (
    sa.select(*(stage.c[n] for n in ("id", "job_id", "name", "state", "skipped", "n_shards", "n_done", "started_at",
                                     "finished_at", "peak_bytes", "artifact_digest")),
              job.c.finished_at.label("job_ended"), now().label("clock"))
    .join(job, job.c.id == stage.c.job_id)
    .where(stage.c.job_id.in_(sa.bindparam("jobs", expanding=True))).order_by(stage.c.ordinal)
)  # fmt: skip
_FEW = (
    sa.select(shard.c.stage_id, shard.c.state, sa.func.count().label("n"))
    .where(shard.c.job_id.in_(sa.bindparam("jobs", expanding=True)), shard.c.state.in_(("running", "failed")),
           shard.c.kind == "run")
    .group_by(shard.c.stage_id, shard.c.state)
)  # fmt: skip
