"""The life of a shard: claimed, renewed, committed (failed or put off: `failures`). Each is one transaction.

Claim    One UPDATE takes a shard that is ready, or whose lease ran out, and numbers the claim: of any number of
         messages for it, one wins. The number is the fence: who holds an older one can renew and commit nothing. The
         attempt is for MAX_ATTEMPTS alone: a stop or a full disk gives it back.
Locks    The job's row first, then the shard's, then the stage's or the tenant's: everybody takes them in this order, or
         PostgreSQL would see deadlocks.
Fence    A shard on the optimizer queue also takes the job's one optimizer lease, with a token that grows.
Events   A stage of many shards tells of its failures, and of its progress a hundred times: 10^5 shards would else be
         2 * 10^5 events for whoever watches. What a shard says of itself is rare (news.py).
Cost     No statement reads more than one row of a job's shards: the stage's row counts them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from farfield.stages import Queue
from farfield.store import events
from farfield.store.engine import new_id, now, read, write
from farfield.store.fair import READY, Host, fits
from farfield.store.tables import artifact, job, scene, shard, stage, tenant

LEASE_S = 60.0  # native code may hold the interpreter, and with it the thread that renews
MAX_ATTEMPTS = 3
EVENT_SHARDS = 200  # a stage of more tells of its progress only


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """A shard that is ours for now, and all that running it needs."""

    shard_id: str
    job_id: str
    stage_id: str
    stage: str
    kind: str
    ordinal: int
    params: Any
    queue: str
    attempt: int
    claim: int  # its number among the claims of this shard
    fence: int | None  # token of the optimizer lease
    settings: Mapping[str, Any]
    scene_digest: str
    scene_suffix: str
    artifacts: Mapping[str, str]  # stage -> digest, of the stages that are complete
    pieces: tuple[str, ...]  # digests of the stage's `run` shards in plan order, for `merge`
    outcomes: tuple[Mapping[str, Any], ...]  # of the stages that ran, for `report`
    n_shards: int = 1  # that its stage runs
    tenant_id: str | None = None


def claim(
    engine: sa.Engine, shard_id: str, *, worker: str, lease_s: float = LEASE_S, host: Host | None = None
) -> Claim | None:
    """Take the shard, or return None where there is nothing (more) to do, or it does not fit on the host now."""
    return next(iter(claim_group(engine, shard_id, worker=worker, lease_s=lease_s, host=host)), None)


def claim_group(
    engine: sa.Engine, shard_id: str, *, worker: str, lease_s: float = LEASE_S, host: Host | None = None,
    most: Callable[[str], int] = lambda stage_id: 1,
) -> list[Claim]:  # fmt: skip
    """Take the shard, and where its stage is large the next ones that are ready: at most `most` of a stage (`groups`).

    Not more than an eighth of what is left of the stage, so that other workers have their part of it.
    """
    with write(engine) as tx:
        at = tx.execute(_OF_SHARD, {"of_shard": shard_id}).one_or_none()
        if at is None or at.state not in ("queued", "running") or not _room(tx, host, at.need_bytes):
            return []
        taken = {"lease": lease_s, "new_worker": worker, "new_host": host.name if host else ""}
        row = tx.execute(_TAKE, {**taken, "of_shard": shard_id, "impossible": _impossible(lease_s)}).one_or_none()
        if row is None:
            return []
        fence = None
        if row.queue == Queue.OPTIMIZER:
            fence = _take_optimizer(tx, at.id, shard_id, lease_s)
            if fence is None:
                tx.rollback()
                return []
        rows = [row]
        if not _told_singly(row.kind, at.n_shards) and fence is None and row.attempt == 1:
            more = min(most(at.stage_id), (at.n_shards - at.n_done) // 8) - 1
            if more > 0:
                of = {"of_stage": at.stage_id, "of_job": at.id, "of_queue": row.queue, "more": more}
                found = tx.execute(_TAKE_MORE, {**taken, **of, "new_host": None}).all()
                rows += sorted(found, key=lambda r: r.ordinal)
        _serve(tx, row.tenant_id, at.id, started=at.state == "queued")
        if at.state == "queued":
            events.append(tx, at.id, "job", {"state": "running"})
        if _told_singly(row.kind, at.n_shards):
            fact = {"stage": at.name, "kind": row.kind, "ordinal": row.ordinal, "state": "running"}
            events.append(tx, at.id, "shard", {**fact, "attempt": row.attempt})
        made_by = tx.execute(_RESULTS, {"job": at.id}).all()
        pieces: list[str] = []
        if row.kind == "merge":
            pieces = list(tx.scalars(
                sa.select(shard.c.artifact_digest).where(shard.c.stage_id == at.stage_id, shard.c.kind == "run")
                .order_by(shard.c.ordinal)
            ))  # fmt: skip
        outcomes = []
        if row.kind == "report":
            stages = tx.execute(sa.select(stage).where(stage.c.job_id == at.id).order_by(stage.c.ordinal)).all()
            outcomes = [_outcome(tx, s) for s in stages]
    artifacts = {s.name: s.artifact_digest for s in made_by}
    return [
        Claim(
            shard_id=r.id, job_id=at.id, stage_id=at.stage_id, stage=at.name, kind=r.kind, ordinal=r.ordinal,
            params=r.params, queue=r.queue, attempt=r.attempt, claim=r.claims, fence=fence, settings=at.settings,
            scene_digest=at.scene_digest, scene_suffix=at.suffix, pieces=tuple(pieces), outcomes=tuple(outcomes),
            artifacts=artifacts, n_shards=at.n_shards, tenant_id=r.tenant_id,
        )
        for r in rows
    ]  # fmt: skip


def made(engine: sa.Engine, digest: str, job_id: str) -> Claim | None:
    """Return the shard, of this job if it can be, that made the artifact; it is not claimed. None: no shard did."""
    with read(engine) as tx:
        row = tx.execute(
            sa.select(shard, job.c.settings, job.c.scene_digest, scene.c.suffix, stage.c.name, stage.c.n_shards)
            .join(stage, stage.c.id == shard.c.stage_id).join(job, job.c.id == shard.c.job_id)
            .join(scene, (scene.c.tenant_id == job.c.tenant_id) & (scene.c.digest == job.c.scene_digest))
            .where(shard.c.artifact_digest == digest, shard.c.state == "done")
            .order_by(shard.c.job_id != job_id, shard.c.id).limit(1)
        ).one_or_none()  # fmt: skip
        if row is None:
            return None
        stages = tx.execute(sa.select(stage).where(stage.c.job_id == row.job_id)).all()
        of = (shard.c.stage_id == row.stage_id) & (shard.c.kind == "run") & (row.kind == "merge")
        pieces = tx.scalars(sa.select(shard.c.artifact_digest).where(of).order_by(shard.c.ordinal))
        return Claim(
            shard_id=row.id, job_id=row.job_id, stage_id=row.stage_id, stage=row.name, kind=row.kind,
            ordinal=row.ordinal, params=row.params, queue=row.queue, attempt=row.attempt, claim=row.claims,
            fence=None, settings=row.settings, scene_digest=row.scene_digest, scene_suffix=row.suffix,
            artifacts={s.name: s.artifact_digest for s in stages if s.artifact_digest}, pieces=tuple(pieces),
            outcomes=(), n_shards=row.n_shards,
        )  # fmt: skip


def renew(engine: sa.Engine, held: Claim, *, lease_s: float = LEASE_S) -> bool:
    """Prolong the lease. False: the shard is no longer ours (cancelled, or taken over), stop working on it."""
    with write(engine) as tx:
        lock_job(tx, held.job_id)
        updated = tx.execute(RENEW, {**ours(held), "job": held.job_id, "lease": lease_s}).rowcount
        if updated and held.fence is not None:
            tx.execute(
                sa.update(job).where(job.c.id == held.job_id, job.c.optimizer_token == held.fence)
                .values(optimizer_until=now() + lease_s)
            )  # fmt: skip
        return bool(updated)


def known_result(engine: sa.Engine, tenant_id: str | None, key: str) -> Any:
    """Return (artifact_digest, seconds, peak_bytes) of a shard of any job of the tenant with this key that is done, or None.

    Never another tenant's: a job that took no time would tell that somebody else has the same level.
    """
    with read(engine) as tx:
        return tx.execute(_KNOWN, {"key": key, "tenant": tenant_id}).one_or_none()


def commit(
    engine: sa.Engine, held: Claim, *, digest: str, n_bytes: int, key: str | None, seconds: float, peak_bytes: int,
    cached: bool = False, check: Callable[[], object] = bool,
) -> str:  # fmt: skip
    """Write the shard's result if it is still ours (and the fence still the newest).

    Returns "lost" where it is not, "last" where the job may move on by now, "more" where others of its stage run or wait.
    `check` is called in the transaction, once nobody can delete the artifact any more: it raises where it is gone.
    """
    with write(engine) as tx:
        at = tx.execute(LOCKED, {"job": held.job_id}).one_or_none()
        if at is None or at.state != "running" or (held.fence is not None and at.optimizer_token != held.fence):
            return "lost"
        put_artifact(tx, digest, n_bytes)
        check()
        facts = {"new_digest": digest, "new_key": key, "took": seconds, "peak": peak_bytes, "was_cached": cached}
        updated = tx.execute(COMMIT, {**ours(held), **facts}).rowcount
        if not updated:
            return "lost"
        if held.fence is not None:
            release_optimizer(tx, held)
        if _told_singly(held.kind, held.n_shards):
            fact = {"stage": held.stage, "kind": held.kind, "ordinal": held.ordinal, "state": "done"}
            events.append(tx, held.job_id, "shard", {**fact, "seconds": round(seconds, 3), "cached": cached})
        return counted(tx, held, int(held.kind == "run"), peak_bytes)


def counted(tx: sa.Connection, held: Claim, number: int, peak_bytes: int) -> str:
    """Count so many shards of the stage as done, and tell of its progress where it is a large one; return as `commit` does."""
    at = tx.execute(_COUNT, {"stage": held.stage_id, "number": number, "peak": peak_bytes}).one()
    told = {"stage": held.stage, "state": "running", "shards": at.n_shards, "done": at.n_done}
    before, after = (100 * n // max(at.n_shards, 1) for n in (at.n_done - number, at.n_done))
    if not _told_singly(held.kind, held.n_shards) and before != after:
        events.append(tx, held.job_id, "stage", told)
    return "more" if held.kind == "run" and at.n_done < at.n_shards else "last"


def anew(row: sa.Row[Any]) -> dict[str, Any]:
    """Return a new, ready shard in the place of `row`, to be deleted: a worker that still computes it commits to nothing."""
    kept = ("tenant_id", "job_id", "stage_id", "kind", "ordinal", "queue", "params", "need_bytes")
    place = {name: getattr(row, name) for name in kept}
    return {**place, "id": new_id(), "state": "ready", "attempt": 0, "cached": False}


def lock_job(tx: sa.Connection, job_id: str | None) -> None:
    """Hold the job's row until the transaction ends. SQLite has one writer at a time and needs no lock."""
    if tx.dialect.name != "sqlite":
        tx.execute(sa.select(job.c.id).where(job.c.id == job_id).with_for_update())


def put_artifact(tx: sa.Connection, digest: str, n_bytes: int) -> None:
    """Make sure that the blob has its row, and hold the row: who would collect it waits until we have committed."""
    tx.execute(PUT[tx.dialect.name], {"new_digest": digest, "new_bytes": n_bytes})


def lapsed(lease_s: float = LEASE_S) -> sa.ColumnElement[bool]:
    """A lease that ran out, or that no clock of today can have given: then the database's has jumped back.

    A lease that this takes for lapsed too early costs work that is done twice, never a result: the claim is the fence.
    """
    return _lapsed(_impossible(lease_s))


def _impossible(lease_s: float) -> float:
    return max(2 * lease_s, LEASE_S)


def _lapsed(impossible: Any) -> sa.ColumnElement[bool]:
    ended = (shard.c.lease_until < now()) | (shard.c.lease_until > now() + impossible)
    return (shard.c.state == "running") & ended


def _room(tx: sa.Connection, host: Host | None, need_bytes: int) -> bool:
    """Say whether the host has room, held until we have committed: two of its workers must not both take it."""
    if host is None or host.memory_bytes is None:
        return True
    if tx.dialect.name == "postgresql":
        tx.execute(_LOCK_HOST, {"host": f"host {host.name}"})
    held = tx.scalar(_HELD, {"host": host.name})
    return fits(Host(name=host.name, memory_bytes=host.memory_bytes), need_bytes, held=int(held or 0))


def _serve(tx: sa.Connection, tenant_id: str, job_id: str, *, started: bool) -> None:
    """Note whose turn it was."""
    served = tx.scalar(_SERVE_TENANT, {"tenant": tenant_id})
    tx.execute(_SERVE_JOB, {"job": job_id, "served": served})
    if started:
        tx.execute(sa.update(job).where(job.c.id == job_id).values(state="running", started_at=now()))


def _told_singly(kind: str, n_shards: int) -> bool:
    return kind != "run" or n_shards <= EVENT_SHARDS


def ours(held: Claim) -> dict[str, Any]:
    """Return the parameters of OURS."""
    return {"of_shard": held.shard_id, "held_claim": held.claim}


def _take_optimizer(tx: sa.Connection, job_id: str, shard_id: str, lease_s: float) -> int | None:
    free = job.c.optimizer_until.is_(None) | (job.c.optimizer_until < now()) | (job.c.optimizer_shard_id == shard_id)
    return tx.scalar(
        sa.update(job).where(job.c.id == job_id, free)
        .values(optimizer_token=job.c.optimizer_token + 1, optimizer_shard_id=shard_id, optimizer_until=now() + lease_s)
        .returning(job.c.optimizer_token)
    )  # fmt: skip


def release_optimizer(tx: sa.Connection, held: Claim) -> None:
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


# Statements of every claim and commit are made once: to make one takes four times as long as to run it.
def _put(insert: Any) -> Any:
    values = {"digest": sa.bindparam("new_digest"), "n_bytes": sa.bindparam("new_bytes"), "created_at": now()}
    statement = insert(artifact).values(values)
    return statement.on_conflict_do_update(index_elements=[artifact.c.digest], set_={"marked_at": None})


PUT = {"sqlite": _put(sqlite.insert), "postgresql": _put(postgresql.insert)}
OURS = (
    (shard.c.id == sa.bindparam("of_shard")) & (shard.c.claims == sa.bindparam("held_claim"))
    & (shard.c.state == "running")
)  # fmt: skip
_OF_SHARD = (
    sa.select(
        job.c.id, job.c.state, job.c.settings, job.c.scene_digest, scene.c.suffix, shard.c.need_bytes, shard.c.stage_id,
        stage.c.name, stage.c.n_shards, stage.c.n_done,
    )
    .join(stage, stage.c.id == shard.c.stage_id).join(job, job.c.id == shard.c.job_id)
    .join(scene, (scene.c.tenant_id == job.c.tenant_id) & (scene.c.digest == job.c.scene_digest))
    .where(shard.c.id == sa.bindparam("of_shard")).with_for_update(of=job)
)  # fmt: skip
_TAKEN = {
    "state": "running", "attempt": shard.c.attempt + 1, "claims": shard.c.claims + 1,
    "lease_until": now() + sa.bindparam("lease", type_=sa.Double), "worker": sa.bindparam("new_worker"),
    "host": sa.bindparam("new_host"),
}  # fmt: skip
_RETURNED = [
    shard.c[n] for n in ("id", "tenant_id", "kind", "ordinal", "queue", "params", "attempt", "claims")
]  # fmt: skip
_TAKE = (
    sa.update(shard)
    .where(
        shard.c.id == sa.bindparam("of_shard"), shard.c.attempt < MAX_ATTEMPTS,
        (shard.c.state == "ready") | _lapsed(sa.bindparam("impossible", type_=sa.Double)),
    )
    .values(_TAKEN).returning(*_RETURNED)
)  # fmt: skip
_TAKE_MORE = (
    sa.update(shard)
    .where(
        shard.c.state == "ready",
        shard.c.id.in_(
            sa.select(shard.c.id)
            .where(shard.c.job_id == sa.bindparam("of_job"), READY, shard.c.stage_id == sa.bindparam("of_stage"),
                   shard.c.kind == "run", shard.c.attempt == 0)
            .order_by(shard.c.ordinal).limit(sa.bindparam("more", type_=sa.Integer)).correlate(None)
        ),
    )
    .values(_TAKEN).returning(*_RETURNED)
)  # fmt: skip
_LOCK_HOST = sa.select(sa.func.pg_advisory_xact_lock(sa.func.hashtext(sa.bindparam("host", type_=sa.String))))
_HELD = sa.select(sa.func.coalesce(sa.func.sum(shard.c.need_bytes), 0)).where(
    shard.c.state == "running", shard.c.host == sa.bindparam("host")
)
_RESULTS = sa.select(stage.c.name, stage.c.artifact_digest).where(
    stage.c.job_id == sa.bindparam("job"), stage.c.artifact_digest.is_not(None)
)
_others = tenant.alias()
_SERVE_TENANT = (
    sa.update(tenant).where(tenant.c.id == sa.bindparam("tenant"))
    .values(turn=sa.select(sa.func.max(_others.c.turn) + 1).scalar_subquery()).returning(tenant.c.turn)
)  # fmt: skip
_SERVE_JOB = sa.update(job).where(job.c.id == sa.bindparam("job")).values(turn=sa.bindparam("served"))
RENEW = (
    sa.update(shard)
    .where(OURS, sa.select(job.c.id).where(job.c.id == sa.bindparam("job"), job.c.state == "running").exists())
    .values(lease_until=now() + sa.bindparam("lease", type_=sa.Double))
)
_KNOWN = (
    sa.select(shard.c.artifact_digest, shard.c.seconds, shard.c.peak_bytes)
    .where(shard.c.key == sa.bindparam("key"), shard.c.tenant_id == sa.bindparam("tenant"), shard.c.state == "done",
           shard.c.artifact_digest.is_not(None)).limit(1)
)  # fmt: skip
LOCKED = sa.select(job.c.state, job.c.optimizer_token).where(job.c.id == sa.bindparam("job")).with_for_update()
COMMIT = sa.update(shard).where(OURS).values(
    state="done", artifact_digest=sa.bindparam("new_digest"), key=sa.bindparam("new_key"), lease_until=None,
    seconds=sa.bindparam("took"), peak_bytes=sa.bindparam("peak"), cached=sa.bindparam("was_cached"), error=None, log=None,
)  # fmt: skip
_before = sa.func.coalesce(stage.c.peak_bytes, 0)
_peak = sa.bindparam("peak", type_=sa.BigInteger)
_COUNT = (
    sa.update(stage).where(stage.c.id == sa.bindparam("stage"))
    .values(n_done=stage.c.n_done + sa.bindparam("number", type_=sa.Integer),
            peak_bytes=sa.case((_before > _peak, _before), else_=_peak))
    .returning(stage.c.n_done, stage.c.n_shards)
)  # fmt: skip
