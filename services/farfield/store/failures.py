"""Attempts that end without a result: failed, put off for want of disk or store, or refused because no host is large enough."""

from collections.abc import Mapping
from typing import Any

import sqlalchemy as sa

from farfield.store import events
from farfield.store.engine import now, read, write
from farfield.store.shards import MAX_ATTEMPTS, OURS, Claim, lock_job, ours, release_optimizer
from farfield.store.tables import shard, stage

PUT_OFF_S = (2.0, 4.0, 8.0, 15.0, 30.0, 60.0)  # pauses; the last one again and again
MAX_PUT_OFF = 20  # a quarter of an hour


def fail(engine: sa.Engine, held: Claim, *, error: Mapping[str, str], log: str, again: bool) -> str:
    """Record that the attempt failed; return "ready" (run it again), "failed" (for good) or "lost" (not ours)."""
    return _back(
        engine, held, state="ready" if again and held.attempt < MAX_ATTEMPTS else "failed", error=error, log=log
    )


def put_off(engine: sa.Engine, held: Claim, *, error: Mapping[str, str], log: str) -> str:
    """Hand the shard back for a while, for want of something that comes back: disk space, the store. No attempt of its.

    Returns "ready", "lost", or "failed" after MAX_PUT_OFF times.
    """
    with read(engine) as tx:
        times = tx.scalar(sa.select(shard.c.put_off).where(shard.c.id == held.shard_id)) or 0
    if times >= MAX_PUT_OFF:
        return _back(engine, held, state="failed", error=error, log=log)
    later = {"ready_at": now() + PUT_OFF_S[min(times, len(PUT_OFF_S) - 1)], "put_off": times + 1}
    return _back(engine, held, state="ready", error=error, log=log, **later, attempt=shard.c.attempt - 1)


def _back(engine: sa.Engine, held: Claim, *, state: str, error: Mapping[str, str], log: str, **values: Any) -> str:
    with write(engine) as tx:
        lock_job(tx, held.job_id)
        updated = tx.execute(
            sa.update(shard).where(OURS).values(
                **{"state": state, "lease_until": None, "ready_at": now(), "error": dict(error), "log": log[-20_000:],
                   **values}
            ), ours(held)
        ).rowcount  # fmt: skip
        if not updated:
            return "lost"
        if held.fence is not None:
            release_optimizer(tx, held)
        fact = {"stage": held.stage, "kind": held.kind, "ordinal": held.ordinal, "state": state}
        events.append(tx, held.job_id, "shard", {**fact, "attempt": held.attempt, "error": dict(error)})
        return state


def refuse(engine: sa.Engine, shard_id: str, error: Mapping[str, str]) -> str | None:
    """Fail a shard that is ready and that nobody can run; return its job, or None where it is not ready any more."""
    with write(engine) as tx:
        at = tx.execute(
            sa.select(shard.c.job_id, shard.c.kind, shard.c.ordinal, stage.c.name)
            .join(stage, stage.c.id == shard.c.stage_id).where(shard.c.id == shard_id)
        ).one_or_none()  # fmt: skip
        if at is None:
            return None
        lock_job(tx, at.job_id)
        ready = (shard.c.id == shard_id) & (shard.c.state == "ready")
        if not tx.execute(sa.update(shard).where(ready).values(state="failed", error=dict(error))).rowcount:
            return None
        fact = {"stage": at.name, "kind": at.kind, "ordinal": at.ordinal, "state": "failed", "error": dict(error)}
        events.append(tx, at.job_id, "shard", fact)
        return str(at.job_id)
