"""Which shard a free worker takes next: fair between tenants, then by priority, then fair between jobs.

Problem  A heavy job makes 10^5 shards ready at once. A small one that comes later must not wait for them, nor a tenant
         for another's jobs, nor a shard that needs much memory for ever for a host that small ones keep full.
Method   Nothing is ordered beforehand: whoever is free asks, and the tables answer. Of the tenants with work the one of
         which the least runs now is served; of its jobs the one of highest priority; of these the one of which the least
         runs now; what is equal goes to who was served longest ago, by the number of the claim and not by a clock; within
         a job in plan order, near enough. A shard that does not fit beside what runs on the host is passed over, and
         others go first for PATIENCE_S; then, unless its job runs somewhere, the host starts nothing else until it fits.
Cost     Indexes only: what runs (as many rows as there are workers), the tenants with work, and the head of the index of a
         tenant's open jobs. None grows with the shards of a job.
Tried    A queue of messages in order of submission: 10^5 shards of one job went before the one of the next.
"""

import os
from collections import Counter
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from farfield.store.engine import now, read
from farfield.store.tables import job, shard, tenant

PATIENCE_S = 60.0
LONGEST_S = 120.0  # more than any shard is put off by
ABREAST = 8  # first shards of a job, of which a worker takes one: all would else claim the same, and one get it
LOOKS = 8  # shards of a tenant that do not fit, before a worker asks for another's


@dataclass(frozen=True, slots=True, kw_only=True)
class Host:
    """The memory that workers share: those on one machine, or in one container."""

    name: str
    memory_bytes: int | None = None  # what all shards together may need; None: whatever there is
    free_bytes: int | None = None  # what the system says is free now, our own share included


@dataclass(frozen=True, slots=True)
class Next:
    """A shard to claim; or, where it is `too_large`, to fail by name: no host fits it."""

    shard_id: str
    need_bytes: int
    too_large: bool = False


def next_shard(engine: sa.Engine, queue: str, host: Host) -> Next | None:
    """Return the shard of this queue that the host should run now, or None where there is none (that fits)."""
    with read(engine) as tx:
        running = tx.execute(_RUNNING).all()
        tenants, jobs = Counter(r.tenant_id for r in running), Counter(r.job_id for r in running)
        held = sum(r.need_bytes for r in running if r.host == host.name)
        for tenant_id in _tenants(tx, tenants):
            passed: list[str] = []
            while len(passed) < LOOKS:
                found = _of_tenant(tx, tenant_id, queue, jobs, passed)
                if found is None:
                    break
                if host.memory_bytes is not None and found.need_bytes > host.memory_bytes:
                    return Next(found.id, found.need_bytes, too_large=True)
                if fits(host, found.need_bytes, held=held, waited_s=found.waited_s or 0.0):
                    return Next(found.id, found.need_bytes)
                if (found.waited_s or 0.0) > PATIENCE_S and not jobs[found.job_id]:
                    return None
                passed.append(found.job_id)
    return None


def fits(host: Host, need_bytes: int, *, held: int, waited_s: float = 0.0) -> bool:
    """Say whether a shard fits beside those that `held` bytes are set aside for.

    What strangers use of the machine counts for PATIENCE_S: an estimate is an upper one, and a job must end.
    """
    if host.memory_bytes is not None and held + need_bytes > host.memory_bytes:
        return False
    crowded = host.free_bytes is not None and need_bytes > host.free_bytes
    return not crowded or (not held and waited_s > PATIENCE_S)


def _tenants(tx: sa.Connection, running: "Counter[str]") -> list[str]:
    """Return the tenants with open jobs, in the order in which they are to be served."""
    return [r.id for r in sorted(tx.execute(_TENANTS).all(), key=lambda r: (running[r.id], r.turn, r.id))]


def _of_tenant(tx: sa.Connection, tenant_id: str, queue: str, running: "Counter[str]", passed: list[str]) -> Any:
    """Return (id, need_bytes, waited_s, job_id) of the shard whose turn it is, or None."""
    busy = [j for j in running if j not in passed]
    of = {"tenant": tenant_id, "of_queue": queue}
    found = list(tx.execute(_IDLE, {**of, "others": [*busy, *passed]}).all())
    if busy:
        found += tx.execute(_BUSY, {**of, "busy": busy}).all()
    best = min(found, key=lambda r: (r.priority, running[r.id], r.turn, r.id), default=None)
    if best is None:
        return None
    first = tx.execute(_FIRST, {"job": best.id, "of_queue": queue}).all()
    return first[os.getpid() % len(first)] if first else None  # not all workers the same one


# Statements are made once: to make one takes four times as long as to run it.
_RUNNING = sa.select(shard.c.tenant_id, shard.c.job_id, shard.c.host, shard.c.need_bytes).where(
    shard.c.state == "running",
    shard.c.host.is_not(None),  # without a host: it waits behind another of its group
)
_TENANTS = sa.select(tenant.c.id, tenant.c.turn).where(
    sa.select(job.c.id).where(job.c.tenant_id == tenant.c.id, job.c.finished_at.is_(None)).exists()
)
# A shard that was put off waits; not for longer than it was told to, even where the clock has jumped back.
READY = (
    (shard.c.state == "ready") & (shard.c.queue == sa.bindparam("of_queue"))
    & (shard.c.ready_at.is_(None) | (shard.c.ready_at <= now()) | (shard.c.ready_at > now() + LONGEST_S))
)  # fmt: skip
_JOBS = (
    sa.select(job.c.id, job.c.priority, job.c.turn)
    .where(
        job.c.tenant_id == sa.bindparam("tenant"), job.c.finished_at.is_(None),
        sa.select(shard.c.id).where(shard.c.job_id == job.c.id, READY).exists(),
    )
    .order_by(job.c.priority, job.c.turn, job.c.id)
)  # fmt: skip
_IDLE = _JOBS.where(job.c.id.not_in(sa.bindparam("others", expanding=True))).limit(1)
_BUSY = _JOBS.where(job.c.id.in_(sa.bindparam("busy", expanding=True)))
_FIRST = (
    sa.select(shard.c.id, shard.c.need_bytes, (now() - shard.c.ready_at).label("waited_s"), shard.c.job_id)
    .where(shard.c.job_id == sa.bindparam("job"), READY).order_by(shard.c.ordinal).limit(ABREAST)
)  # fmt: skip
