"""What a tenant has, and how much it may have: bytes stored, jobs stored, jobs that run.

Bytes count once a tenant, whatever it shares with others below the API: what another tenant has changes no figure here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from farfield.errors import QuotaExceeded, RunningQuotaExceeded, TenantNotFound
from farfield.store.engine import read, write
from farfield.store.pages import owned
from farfield.store.tables import artifact, job, scene, shard, stage, tenant

RUNNING = ("queued", "running")


@dataclass(frozen=True, slots=True, kw_only=True)
class Quota:
    """Limits of a tenant; None: none."""

    max_bytes: int | None = None
    max_jobs: int | None = None
    max_running: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Usage:
    """What a tenant has."""

    bytes: int
    jobs: int
    running: int


def usage(engine: sa.Engine, tenant_id: str) -> Usage:
    """Return what the tenant has now."""
    with read(engine) as tx:
        jobs, running = _jobs(tx, tenant_id)
        return Usage(bytes=_bytes(tx, tenant_id), jobs=jobs, running=running)


def quota_of(engine: sa.Engine, tenant_id: str, default: Quota) -> Quota:
    """Return the tenant's limits: its own, where it has any, else the service's. Raises TenantNotFound."""
    with read(engine) as tx:
        return _quota(tx, tenant_id, default)


def set_quota(
    engine: sa.Engine, tenant_id: str, quota: Quota, *, expect: Callable[[sa.Row[Any]], object] = bool
) -> None:
    """Give the tenant limits of its own; None: the service's. Raises TenantNotFound.

    expect  is called with the tenant's row as it is, and may refuse
    """
    values = {"max_bytes": quota.max_bytes, "max_jobs": quota.max_jobs, "max_running": quota.max_running}
    with write(engine) as tx:
        row = tx.execute(sa.select(tenant).where(tenant.c.id == tenant_id).with_for_update()).one_or_none()
        if row is None:
            raise TenantNotFound(tenant_id)
        expect(row)
        tx.execute(sa.update(tenant).where(tenant.c.id == tenant_id).values(**values))


def check_upload(engine: sa.Engine, tenant_id: str, default: Quota, *, already: int) -> int | None:
    """Return how large a file the tenant may send whose digest nobody knows yet; None: as large as it likes.

    What is left of its quota, or its largest scene, which it may send again at no cost: the transaction that stores the
    file is exact. Raises QuotaExceeded where `already` bytes are announced or here, and are more.
    """
    with read(engine) as tx:
        limit = _quota(tx, tenant_id, default).max_bytes
        if limit is None:
            return None
        used = _bytes(tx, tenant_id)
        known = tx.scalar(sa.select(sa.func.max(scene.c.n_bytes)).where(scene.c.tenant_id == tenant_id)) or 0
    most = max(limit - used, int(known))
    if already > most:
        raise QuotaExceeded("bytes", used, limit)
    return most


def check_bytes(tx: sa.Connection, tenant_id: str, default: Quota, more: int) -> None:
    """Raise QuotaExceeded where the tenant may not store `more` bytes. Within the transaction that stores them."""
    limit = _quota(tx, tenant_id, default, lock=True).max_bytes
    if limit is not None and (used := _bytes(tx, tenant_id)) + more > limit:
        raise QuotaExceeded("bytes", used, limit)


def check_job(tx: sa.Connection, tenant_id: str, default: Quota, *, stored: int = 1) -> None:
    """Raise QuotaExceeded or RunningQuotaExceeded where the tenant may not start a job; `stored`: 0 for one it has.

    Within the transaction that starts it: two that ask at once do so one after the other.
    """
    quota = _quota(tx, tenant_id, default, lock=True)
    jobs, running = _jobs(tx, tenant_id)
    if quota.max_jobs is not None and jobs + stored > quota.max_jobs:
        raise QuotaExceeded("jobs", jobs, quota.max_jobs)
    if quota.max_running is not None and running >= quota.max_running:
        raise RunningQuotaExceeded("running jobs", running, quota.max_running)
    if quota.max_bytes is not None and (used := _bytes(tx, tenant_id)) >= quota.max_bytes:
        raise QuotaExceeded("bytes", used, quota.max_bytes)


def needed_bytes(tx: sa.Connection, *, of: sa.Select[Any], but: sa.Select[Any]) -> tuple[int, int]:
    """Return (artifacts, bytes) of the digests in `of` that are not in `but`: what the tenant would have less of."""
    rest = sa.and_(artifact.c.digest.in_(of), artifact.c.digest.not_in(but))
    found = tx.execute(sa.select(sa.func.count(), sa.func.coalesce(sa.func.sum(artifact.c.n_bytes), 0)).where(rest))
    number, n_bytes = found.one()
    return int(number), int(n_bytes)


def digests(
    tenant_id: str, *, only_job: str | None = None, but_job: str | None = None, but_scene: str | None = None,
    scenes: bool = True,
) -> sa.Select[Any]:  # fmt: skip
    """Return the query of all digests that the tenant's rows name: of one job, or without a job or a scene."""

    def of_job(column: sa.Column[Any], job_id: sa.Column[Any]) -> sa.Select[Any]:
        query = sa.select(column.label("digest")).where(owned(column.table.c.tenant_id, tenant_id), column.is_not(None))
        if only_job is not None:
            query = query.where(job_id == only_job)
        return query.where(job_id != but_job) if but_job is not None else query

    parts = [
        of_job(shard.c.artifact_digest, shard.c.job_id),
        of_job(stage.c.artifact_digest, stage.c.job_id),
        of_job(job.c.report_digest, job.c.id),
    ]
    for column in (c for c in scene.c if c.foreign_keys and c.name.endswith("digest")):
        if only_job is None and scenes:
            query = sa.select(column.label("digest")).where(owned(scene.c.tenant_id, tenant_id), column.is_not(None))
            parts.append(query.where(scene.c.digest != but_scene) if but_scene is not None else query)
    return sa.select(sa.union(*parts).subquery().c.digest)


def scene_digests(tenant_id: str, digest: str) -> sa.Select[Any]:
    """Return the query of the digests that one scene of the tenant names."""
    parts = [
        sa.select(column.label("digest")).where(
            scene.c.tenant_id == tenant_id, scene.c.digest == digest, column.is_not(None)
        )
        for column in scene.c
        if column.foreign_keys and column.name.endswith("digest")
    ]
    return sa.select(sa.union(*parts).subquery().c.digest)


def _quota(tx: sa.Connection, tenant_id: str, default: Quota, *, lock: bool = False) -> Quota:
    query = sa.select(tenant.c.max_bytes, tenant.c.max_jobs, tenant.c.max_running).where(tenant.c.id == tenant_id)
    row = tx.execute(query.with_for_update() if lock else query).one_or_none()
    if row is None:
        raise TenantNotFound(tenant_id)
    return Quota(**{
        name: getattr(default, name) if getattr(row, name) is None else getattr(row, name) for name in row._fields
    })  # fmt: skip


def _jobs(tx: sa.Connection, tenant_id: str) -> tuple[int, int]:
    counted = sa.select(sa.func.count(), sa.func.count().filter(job.c.state.in_(RUNNING)))
    stored, running = tx.execute(counted.where(owned(job.c.tenant_id, tenant_id))).one()
    return int(stored), int(running)


def _bytes(tx: sa.Connection, tenant_id: str) -> int:
    total = sa.select(sa.func.coalesce(sa.func.sum(artifact.c.n_bytes), 0))
    return int(tx.scalar(total.where(artifact.c.digest.in_(digests(tenant_id)))) or 0)
