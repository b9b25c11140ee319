"""Jobs of a tenant: created, listed, read, cancelled, retried, deleted."""

import hashlib
import json
from collections.abc import Callable, Sequence
from typing import Any

import sqlalchemy as sa

from farfield.errors import IdempotencyConflict, JobNotFound, JobNotStopped, JobStillRunning, SceneNotFound
from farfield.stages import Queue
from farfield.store import events
from farfield.store.engine import new_id, now, read, write
from farfield.store.progress import Message, drop_shards
from farfield.store.shards import lock_job
from farfield.store.tables import SHARD_STATES, artifact, event, job, scene, shard, stage

ENDED = ("done", "failed", "cancelled")


def create(
    engine: sa.Engine, tenant_id: str, *, name: str, scene_digest: str, settings: dict[str, Any],
    stages: Sequence[str], idempotency_key: str | None, device_profile_id: str | None = None,
    asked: dict[str, Any] | None = None,
) -> tuple[str, Message | None]:  # fmt: skip
    """Return (job id, message for its first shard); no message where the idempotency key is known.

    asked  the settings as the request had them, where those of the job hold more: what its device has by now
    Raises SceneNotFound, and IdempotencyConflict where the key came with another request before.
    """
    text = json.dumps([name, scene_digest, settings if asked is None else asked], sort_keys=True, separators=(",", ":"))
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
        owned = sa.select(scene.c.digest).where(scene.c.tenant_id == tenant_id, scene.c.digest == scene_digest)
        if tx.scalar(owned) is None:
            raise SceneNotFound(scene_digest)
        job_id = new_id()
        tx.execute(
            sa.insert(job).values(
                id=job_id, tenant_id=tenant_id, name=name, scene_digest=scene_digest, settings=settings,
                device_profile_id=device_profile_id, idempotency_key=idempotency_key,
                request_digest=request_digest, state="queued", event_seq=0, optimizer_token=0, created_at=now(),
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
    with read(engine) as tx:
        clock = float(tx.scalar(sa.select(now())) or 0.0)
        rows = tx.execute(sa.select(stage).where(stage.c.job_id == job_id).order_by(stage.c.ordinal)).all()
        counts: dict[str, dict[str, int]] = {}
        counted = tx.execute(
            sa.select(shard.c.stage_id, shard.c.state, sa.func.count().label("n"))
            .where(shard.c.job_id == job_id, shard.c.kind == "run").group_by(shard.c.stage_id, shard.c.state)
        )  # fmt: skip
        for r in counted:
            counts.setdefault(r.stage_id, {})[r.state] = r.n
        peaks = dict(
            tx.execute(
                sa.select(shard.c.stage_id, sa.func.max(shard.c.peak_bytes))
                .where(shard.c.job_id == job_id).group_by(shard.c.stage_id)
            ).tuples().all()
        )  # fmt: skip
    found = []
    for r in rows:
        by_state = counts.get(r.id, {})
        ended = r.finished_at if r.finished_at is not None else clock
        found.append({
            "name": r.name, "state": r.state, "skipped": r.skipped,
            "shards": {"total": sum(by_state.values()), **{s: by_state.get(s, 0) for s in SHARD_STATES}},
            "seconds": round(ended - r.started_at, 3) if r.started_at is not None else None,
            "peak_bytes": peaks.get(r.id), "artifact": r.artifact_digest,
        })  # fmt: skip
    return found


def artifact_of(engine: sa.Engine, job_id: str, stage_name: str) -> str | None:
    """Return the digest of the stage's result, None where there is none (yet)."""
    with read(engine) as tx:
        return tx.scalar(
            sa.select(stage.c.artifact_digest).where(stage.c.job_id == job_id, stage.c.name == stage_name)
        )  # fmt: skip


def shards_of(engine: sa.Engine, job_id: str, stage_name: str) -> list[sa.Row[Any]]:
    """Return the stage's shards, in order of kind and place."""
    with read(engine) as tx:
        return list(
            tx.execute(
                sa.select(shard).join(stage, stage.c.id == shard.c.stage_id)
                .where(shard.c.job_id == job_id, stage.c.name == stage_name).order_by(shard.c.kind, shard.c.ordinal)
            )
        )  # fmt: skip


def page(
    engine: sa.Engine, tenant_id: str, *, state: str | None, before: tuple[float, str] | None, limit: int
) -> list[sa.Row[Any]]:
    """Return up to `limit` jobs, newest first, that come after the cursor `before` (created_at, id)."""
    query = sa.select(job).where(job.c.tenant_id == tenant_id)
    if state is not None:
        query = query.where(job.c.state == state)
    if before is not None:
        created_at, job_id = before
        query = query.where((job.c.created_at < created_at) | ((job.c.created_at == created_at) & (job.c.id < job_id)))
    with read(engine) as tx:
        return list(tx.execute(query.order_by(job.c.created_at.desc(), job.c.id.desc()).limit(limit)))


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
        return "cancelled"


def retry(engine: sa.Engine, tenant_id: str, job_id: str) -> list[Message]:
    """Let a failed or cancelled job go on from what is done; return the messages for its shards.

    Shards that failed or were cancelled begin anew, as new rows: a worker that still computes an old one commits to
    nothing. Raises JobNotFound, JobNotStopped.
    """
    with write(engine) as tx:
        lock_job(tx, job_id)
        row = _row(tx, tenant_id, job_id)
        if row.state not in ("failed", "cancelled"):
            raise JobNotStopped(job_id, row.state)
        undone = (shard.c.job_id == job_id) & shard.c.state.in_(("failed", "cancelled"))
        kept = ("tenant_id", "job_id", "stage_id", "kind", "ordinal", "queue", "params")
        rows = [
            {**{key: getattr(r, key) for key in kept}, "id": new_id(), "state": "ready", "attempt": 0, "cached": False}
            for r in tx.execute(sa.select(shard).where(undone).order_by(shard.c.kind, shard.c.ordinal)).all()
        ]
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
    engine: sa.Engine, tenant_id: str, job_id: str, *, dry_run: bool, remove: Callable[[str], object] = bool
) -> tuple[dict[str, int], list[str]]:
    """Delete an ended job and the artifacts that nothing else needs; return what, and the digests of those artifacts.

    The caller removes the blobs afterwards: a crash in between leaves blobs without a row, never a row without its
    blob. Raises JobNotFound, JobStillRunning.
    """
    with write(engine) as tx:
        lock_job(tx, job_id)
        row = _row(tx, tenant_id, job_id)
        if row.state not in ENDED:
            raise JobStillRunning(job_id, row.state)
        lone = _only_of(tx, job_id)
        n_bytes = sum(n for _, n in lone)
        counts = {
            "shards": tx.scalar(sa.select(sa.func.count()).select_from(shard).where(shard.c.job_id == job_id)) or 0,
            "events": tx.scalar(sa.select(sa.func.count()).select_from(event).where(event.c.job_id == job_id)) or 0,
            "artifacts": len(lone), "bytes": n_bytes,
        }  # fmt: skip
        if dry_run:
            return counts, []
        for table in (event, shard, stage):
            tx.execute(sa.delete(table).where(table.c.job_id == job_id))
        tx.execute(sa.delete(job).where(job.c.id == job_id))
        digests = [digest for digest, _ in lone]
        for start in range(0, len(digests), 500):
            tx.execute(sa.delete(artifact).where(artifact.c.digest.in_(digests[start : start + 500])))
        for digest in digests:
            remove(digest)
        return counts, digests


def _only_of(tx: sa.Connection, job_id: str) -> list[tuple[str, int]]:
    here = sa.union(
        sa.select(shard.c.artifact_digest.label("digest")).where(shard.c.job_id == job_id),
        sa.select(stage.c.artifact_digest).where(stage.c.job_id == job_id),
        sa.select(job.c.report_digest).where(job.c.id == job_id),
    ).subquery()
    elsewhere = [
        sa.select(shard.c.id).where(shard.c.job_id != job_id, shard.c.artifact_digest == artifact.c.digest),
        sa.select(stage.c.id).where(stage.c.job_id != job_id, stage.c.artifact_digest == artifact.c.digest),
        sa.select(job.c.id).where(job.c.id != job_id, job.c.report_digest == artifact.c.digest),
        sa.select(scene.c.digest).where(
            (scene.c.digest == artifact.c.digest) | (scene.c.inspect_digest == artifact.c.digest)
        ),
    ]
    query = sa.select(artifact.c.digest, artifact.c.n_bytes).where(
        artifact.c.digest.in_(sa.select(here.c.digest)), *(~q.exists() for q in elsewhere)
    )
    return [(r.digest, r.n_bytes) for r in tx.execute(query)]


def _row(tx: sa.Connection, tenant_id: str, job_id: str) -> sa.Row[Any]:
    row = tx.execute(sa.select(job).where(job.c.id == job_id, job.c.tenant_id == tenant_id)).one_or_none()
    if row is None:
        raise JobNotFound(job_id)
    return row
