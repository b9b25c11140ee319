"""What happened to a job, in order, numbered without gaps.

The number comes from a counter in the job's row, in the transaction that also writes what the event tells of. A serial
id would be handed out before the commit: a reader that has seen 7 could then miss a 6 that commits later.
"""

from typing import Any

import sqlalchemy as sa

from farfield.store import webhooks
from farfield.store.engine import now
from farfield.store.tables import event, job


def append(connection: sa.Connection, job_id: str, kind: str, data: dict[str, Any]) -> int:
    """Write an event within the caller's transaction and return its number. `kind`: "job", "stage", "shard", "progress"."""
    row = connection.execute(
        sa.update(job)
        .where(job.c.id == job_id)
        .values(event_seq=job.c.event_seq + 1)
        .returning(job.c.event_seq, job.c.tenant_id)
    ).one()
    connection.execute(
        sa.insert(event).values(
            tenant_id=row.tenant_id, job_id=job_id, seq=row.event_seq, kind=kind, data=data, created_at=now()
        )
    )
    if kind == "job":
        webhooks.enqueue(connection, job_id, int(row.event_seq), data)
    return int(row.event_seq)


def after(
    connection: sa.Connection, job_id: str, seq: int, limit: int = 500, *, kind: str | None = None
) -> list[dict[str, Any]]:
    """Return up to `limit` events of the job (of one kind) with a number above `seq`, in order."""
    rows = connection.execute(
        sa.select(event.c.seq, event.c.kind, event.c.data, event.c.created_at)
        .where(event.c.job_id == job_id, event.c.seq > seq, event.c.kind == kind if kind is not None else sa.true())
        .order_by(event.c.seq)
        .limit(limit)
    )
    return [{"seq": r.seq, "kind": r.kind, "data": r.data, "at": r.created_at} for r in rows]


def last_numbers(connection: sa.Connection, job_ids: list[str]) -> dict[str, int]:
    """Return the number of the last event of each job that exists."""
    rows = connection.execute(sa.select(job.c.id, job.c.event_seq).where(job.c.id.in_(job_ids)))
    return {r.id: r.event_seq for r in rows}
