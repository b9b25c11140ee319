"""The life of a shard: claimed, renewed, committed or failed. Each is one transaction.

Claim    One UPDATE takes a shard that is ready, or whose lease ran out, and raises its attempt: of any number of
         messages for it, one wins. The attempt is the fence: who holds an older one can renew and commit nothing.
Locks    The job's row first, then the shard's: everybody takes them in this order, or PostgreSQL would see deadlocks.
Fence    A shard on the optimizer queue also takes the job's one optimizer lease, with a token that grows.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from farfield.stages import Queue
from farfield.store import events
from farfield.store.engine import now, read, write
from farfield.store.tables import artifact, job, scene, shard, stage

LEASE_S = 60.0  # native code may hold the interpreter, and with it the thread that renews
MAX_ATTEMPTS = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """A shard that is ours for now, and all that running it needs."""

    shard_id: str
    job_id: str
    stage: str
    kind: str
    ordinal: int
    params: Any
    attempt: int
    fence: int | None  # token of the optimizer lease
    settings: Mapping[str, Any]
    scene_digest: str
    scene_suffix: str
    artifacts: Mapping[str, str]  # stage -> digest, of the stages that are complete
    pieces: tuple[str, ...]  # digests of the stage's `run` shards in plan order, for `merge`
    outcomes: tuple[Mapping[str, Any], ...]  # of the stages that ran, for `report`


def claim(engine: sa.Engine, shard_id: str, *, worker: str, lease_s: float = LEASE_S) -> Claim | None:
    """Take the shard, or return None where there is nothing (more) to do."""
    with write(engine) as tx:
        lock_job(tx, tx.scalar(sa.select(shard.c.job_id).where(shard.c.id == shard_id)))
        row = tx.execute(
            sa.update(shard)
            .where(shard.c.id == shard_id, _claimable(), shard.c.attempt < MAX_ATTEMPTS)
            .values(state="running", attempt=shard.c.attempt + 1, lease_until=now() + lease_s, worker=worker)
            .returning(shard)
        ).one_or_none()
        if row is None:
            return None
        owner = tx.execute(
            sa.select(job, scene.c.suffix)
            .join(scene, (scene.c.tenant_id == job.c.tenant_id) & (scene.c.digest == job.c.scene_digest))
            .where(job.c.id == row.job_id)
        ).one()
        fence = None
        if owner.state not in ("queued", "running"):
            tx.rollback()
            return None
        if row.queue == Queue.OPTIMIZER:
            fence = _take_optimizer(tx, row.job_id, shard_id, lease_s)
            if fence is None:
                tx.rollback()
                return None
        if owner.state == "queued":
            tx.execute(
                sa.update(job).where(job.c.id == row.job_id, job.c.state == "queued")
                .values(state="running", started_at=now())
            )  # fmt: skip
            events.append(tx, row.job_id, "job", {"state": "running"})
        name = tx.scalar(sa.select(stage.c.name).where(stage.c.id == row.stage_id))
        fact = {"stage": name, "kind": row.kind, "ordinal": row.ordinal, "state": "running", "attempt": row.attempt}
        events.append(tx, row.job_id, "shard", fact)
        stages = tx.execute(sa.select(stage).where(stage.c.job_id == row.job_id).order_by(stage.c.ordinal)).all()
        pieces: list[str] = []
        if row.kind == "merge":
            pieces = list(tx.scalars(
                sa.select(shard.c.artifact_digest).where(shard.c.stage_id == row.stage_id, shard.c.kind == "run")
                .order_by(shard.c.ordinal)
            ))  # fmt: skip
        outcomes = [_outcome(tx, s) for s in stages] if row.kind == "report" else []
    return Claim(
        shard_id=shard_id, job_id=row.job_id, stage=str(name), kind=row.kind, ordinal=row.ordinal, params=row.params,
        attempt=row.attempt, fence=fence, settings=owner.settings, scene_digest=owner.scene_digest,
        scene_suffix=owner.suffix, artifacts={s.name: s.artifact_digest for s in stages if s.artifact_digest},
        pieces=tuple(pieces), outcomes=tuple(outcomes),
    )  # fmt: skip


def renew(engine: sa.Engine, held: Claim, *, lease_s: float = LEASE_S) -> bool:
    """Prolong the lease. False: the shard is no longer ours (cancelled, or taken over), stop working on it."""
    with write(engine) as tx:
        lock_job(tx, held.job_id)
        alive = sa.select(job.c.id).where(job.c.id == held.job_id, job.c.state == "running")
        updated = tx.execute(
            sa.update(shard).where(_ours(held), alive.exists()).values(lease_until=now() + lease_s)
        ).rowcount
        if updated and held.fence is not None:
            tx.execute(
                sa.update(job).where(job.c.id == held.job_id, job.c.optimizer_token == held.fence)
                .values(optimizer_until=now() + lease_s)
            )  # fmt: skip
        return bool(updated)


def known_result(engine: sa.Engine, key: str) -> Any:
    """Return (artifact_digest, seconds, peak_bytes) of a shard of any job with this key that is done, or None."""
    with read(engine) as tx:
        return tx.execute(
            sa.select(shard.c.artifact_digest, shard.c.seconds, shard.c.peak_bytes)
            .where(shard.c.key == key, shard.c.state == "done", shard.c.artifact_digest.is_not(None))
            .limit(1)
        ).one_or_none()


def commit(
    engine: sa.Engine, held: Claim, *, digest: str, n_bytes: int, key: str | None, seconds: float, peak_bytes: int,
    cached: bool = False, check: Callable[[], object] = bool,
) -> bool:  # fmt: skip
    """Write the shard's result if the attempt is still ours (and the fence still the newest); say whether it was.

    `check` is called in the transaction, once nobody can delete the artifact any more: it raises where it is gone.
    """
    with write(engine) as tx:
        lock_job(tx, held.job_id)
        if held.fence is not None:
            token = tx.scalar(sa.select(job.c.optimizer_token).where(job.c.id == held.job_id))
            if token != held.fence:
                return False
            _release_optimizer(tx, held)
        put_artifact(tx, digest, n_bytes)
        check()
        alive = sa.select(job.c.id).where(job.c.id == held.job_id, job.c.state == "running")
        updated = tx.execute(
            sa.update(shard).where(_ours(held), alive.exists()).values(
                state="done", artifact_digest=digest, key=key, seconds=seconds, peak_bytes=peak_bytes, cached=cached,
                lease_until=None, error=None, log=None,
            )
        ).rowcount  # fmt: skip
        if not updated:
            return False
        fact = {"stage": held.stage, "kind": held.kind, "ordinal": held.ordinal, "state": "done"}
        events.append(tx, held.job_id, "shard", {**fact, "seconds": round(seconds, 3), "cached": cached})
        return True


def fail(engine: sa.Engine, held: Claim, *, error: Mapping[str, str], log: str, again: bool) -> str:
    """Record that the attempt failed; return "ready" (run it again), "failed" (for good) or "lost" (not ours)."""
    state = "ready" if again and held.attempt < MAX_ATTEMPTS else "failed"
    with write(engine) as tx:
        lock_job(tx, held.job_id)
        updated = tx.execute(
            sa.update(shard).where(_ours(held))
            .values(state=state, lease_until=None, sent_at=None, ready_at=now(), error=dict(error), log=log[-20_000:])
        ).rowcount  # fmt: skip
        if not updated:
            return "lost"
        if held.fence is not None:
            _release_optimizer(tx, held)
        fact = {"stage": held.stage, "kind": held.kind, "ordinal": held.ordinal, "state": state}
        events.append(tx, held.job_id, "shard", {**fact, "attempt": held.attempt, "error": dict(error)})
        return state


def lock_job(tx: sa.Connection, job_id: str | None) -> None:
    """Hold the job's row until the transaction ends. SQLite has one writer at a time and needs no lock."""
    tx.execute(sa.select(job.c.id).where(job.c.id == job_id).with_for_update())


def put_artifact(tx: sa.Connection, digest: str, n_bytes: int) -> None:
    """Make sure that the blob has its row, and hold the row: who would collect it waits until we have committed."""
    insert = sqlite.insert if tx.dialect.name == "sqlite" else postgresql.insert
    values = {"digest": digest, "n_bytes": n_bytes, "created_at": now()}
    kept = {"marked_at": None}
    tx.execute(insert(artifact).values(values).on_conflict_do_update(index_elements=[artifact.c.digest], set_=kept))


def _claimable() -> sa.ColumnElement[bool]:
    return (shard.c.state == "ready") | ((shard.c.state == "running") & (shard.c.lease_until < now()))


def _ours(held: Claim) -> sa.ColumnElement[bool]:
    return (shard.c.id == held.shard_id) & (shard.c.attempt == held.attempt) & (shard.c.state == "running")


def _take_optimizer(tx: sa.Connection, job_id: str, shard_id: str, lease_s: float) -> int | None:
    free = job.c.optimizer_until.is_(None) | (job.c.optimizer_until < now()) | (job.c.optimizer_shard_id == shard_id)
    return tx.scalar(
        sa.update(job).where(job.c.id == job_id, free)
        .values(optimizer_token=job.c.optimizer_token + 1, optimizer_shard_id=shard_id, optimizer_until=now() + lease_s)
        .returning(job.c.optimizer_token)
    )  # fmt: skip


def _release_optimizer(tx: sa.Connection, held: Claim) -> None:
    tx.execute(
        sa.update(job).where(job.c.id == held.job_id, job.c.optimizer_token == held.fence)
        .values(optimizer_until=None, optimizer_shard_id=None)
    )  # fmt: skip


def _outcome(tx: sa.Connection, row: sa.Row[Any]) -> dict[str, Any]:
    peak, count, reused = tx.execute(
        sa.select(
            sa.func.max(shard.c.peak_bytes), sa.func.count().filter(shard.c.kind == "run"),
            sa.func.count().filter((shard.c.kind == "run") & shard.c.cached),
        ).where(shard.c.stage_id == row.id)
    ).one()  # fmt: skip
    ended = row.finished_at if row.finished_at is not None else tx.scalar(sa.select(now()))
    return {
        "name": row.name, "state": row.state, "skipped": row.skipped, "shards": count, "reused": reused,
        "peak_bytes": peak or 0,
        "seconds": round(ended - row.started_at, 3) if row.started_at is not None else 0.0,
    }  # fmt: skip
