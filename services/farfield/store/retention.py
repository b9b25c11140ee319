"""What is kept for how long: ended jobs, their events, scenes that no job uses. Zero days: for ever.

An ended job goes with its shards, events and report; artifacts that nothing needs then are the collector's. Of a
job that stays, the last event stays, too: a stream that is taken up again must find its end.
"""

from dataclasses import dataclass

import sqlalchemy as sa

from farfield.errors import JobNotFound, JobStillRunning
from farfield.store import jobs
from farfield.store.engine import now, read, write
from farfield.store.tables import event, job, scene

DAY_S = 86_400.0
BATCH = 200  # jobs or scenes a round: the service works on meanwhile


@dataclass(frozen=True, slots=True, kw_only=True)
class Retention:
    """Days that things are kept after their end (0: for ever)."""

    jobs_days: float = 0.0
    events_days: float = 0.0
    scenes_days: float = 0.0


def expire(engine: sa.Engine, keep: Retention) -> dict[str, int]:
    """Delete what is older than `keep` says, up to BATCH jobs and scenes; return how many of each."""
    return {
        "jobs": _jobs(engine, keep.jobs_days * DAY_S) if keep.jobs_days else 0,
        "events": _events(engine, keep.events_days * DAY_S) if keep.events_days else 0,
        "scenes": _scenes(engine, keep.scenes_days * DAY_S) if keep.scenes_days else 0,
    }


def _jobs(engine: sa.Engine, seconds: float) -> int:
    with read(engine) as tx:
        old = sa.select(job.c.tenant_id, job.c.id).where(
            job.c.state.in_(jobs.ENDED), job.c.finished_at < now() - seconds
        )
        found = tx.execute(old.order_by(job.c.finished_at).limit(BATCH)).all()
    number = 0
    for tenant_id, job_id in found:
        try:
            jobs.delete(engine, tenant_id, job_id, dry_run=False)
        except (JobNotFound, JobStillRunning):  # deleted or retried meanwhile
            continue
        number += 1
    return number


def _events(engine: sa.Engine, seconds: float) -> int:
    last = sa.select(job.c.event_seq).where(job.c.id == event.c.job_id).scalar_subquery()
    number = 0
    with read(engine) as tx:
        old = job.c.state.in_(jobs.ENDED) & (job.c.finished_at < now() - seconds)
        more = sa.select(event.c.job_id).where(event.c.job_id == job.c.id, event.c.seq < job.c.event_seq).exists()
        found = list(tx.scalars(sa.select(job.c.id).where(old, more).limit(BATCH)))
    for job_id in found:
        with write(engine) as tx:
            number += tx.execute(sa.delete(event).where(event.c.job_id == job_id, event.c.seq < last)).rowcount
    return number


def _scenes(engine: sa.Engine, seconds: float) -> int:
    used = sa.select(job.c.id).where(job.c.tenant_id == scene.c.tenant_id, job.c.scene_digest == scene.c.digest)
    old = (scene.c.created_at < now() - seconds) & ~used.exists()
    number = 0
    with read(engine) as tx:
        found = tx.execute(sa.select(scene.c.tenant_id, scene.c.digest).where(old).limit(BATCH)).all()
    for tenant_id, digest in found:
        with write(engine) as tx:
            mine = (scene.c.tenant_id == tenant_id) & (scene.c.digest == digest)
            # On PostgreSQL a job that is being created holds the scene's row by its foreign key: then we wait, and ask.
            tx.execute(sa.select(scene.c.digest).where(mine).with_for_update())
            number += tx.execute(sa.delete(scene).where(mine, old)).rowcount
    return number
