"""Which workers there are: each tells of itself every few seconds. Nothing else relies on it: leases decide who works."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from farfield.stages import Queue
from farfield.store.engine import insert, now, read, write
from farfield.store.tables import worker

HEARTBEAT_S = 5.0
SILENT_S = 45.0  # native code may hold the interpreter, and with it the thread that tells
FORGET_S = 86_400.0  # after which a silent worker's row is deleted


@dataclass(slots=True, kw_only=True)
class Telling:
    """What a worker says of itself."""

    name: str
    host: str
    queues: tuple[str, ...]
    capability: Mapping[str, Any]
    shard_id: str | None = None
    stage: str | None = None
    shard_age_s: float = 0.0
    done: int = 0
    failed: int = 0
    busy_seconds: float = 0.0
    recent: int = 0


def tell(engine: sa.Engine, told: Telling, *, stopped: bool = False) -> None:
    """Write the worker's row: its heartbeat is now. `stopped`: it is about to end."""
    values: dict[str, Any] = {
        "host": told.host, "queues": ",".join(told.queues), "capability": dict(told.capability), "heartbeat_at": now(),
        "stopped_at": now() if stopped else None, "shard_id": None if stopped else told.shard_id, "done": told.done,
        "stage": None if stopped else told.stage, "failed": told.failed, "busy_seconds": told.busy_seconds,
        "shard_since": now() - told.shard_age_s if told.shard_id and not stopped else None, "recent": told.recent,
    }  # fmt: skip
    with write(engine) as tx:
        tx.execute(
            insert(tx, worker).values(name=told.name, started_at=now(), **values)
            .on_conflict_do_update(index_elements=[worker.c.name], set_=values)
        )  # fmt: skip


def end(engine: sa.Engine, name: str | None) -> None:
    """Note that the worker (None: every one) has ended, by whoever saw it."""
    which = worker.c.name == name if name is not None else sa.true()
    with write(engine) as tx:
        tx.execute(
            sa.update(worker).where(which, worker.c.stopped_at.is_(None))
            .values(stopped_at=now(), shard_id=None, stage=None, shard_since=None)
        )  # fmt: skip


def listed(engine: sa.Engine) -> list[dict[str, Any]]:
    """Return the workers, those that live first: `state` is busy, idle, silent or stopped; ages in seconds."""
    with read(engine) as tx:
        clock = float(tx.scalar(sa.select(now())) or 0.0)
        rows = tx.execute(sa.select(worker).order_by(worker.c.name)).all()
    found = []
    for r in rows:
        silent_s = max(0.0, clock - r.heartbeat_at)
        state = "silent" if silent_s > SILENT_S else "busy" if r.shard_id else "idle"
        found.append({
            "name": r.name, "host": r.host, "queues": r.queues.split(","), "capability": r.capability,
            "state": "stopped" if r.stopped_at is not None else state, "started_at": r.started_at,
            "heartbeat_at": r.heartbeat_at, "silent_s": round(silent_s, 3), "shard": r.shard_id, "stage": r.stage,
            "shard_s": round(clock - r.shard_since, 3) if r.shard_since is not None else None,
            "done": r.done, "failed": r.failed, "busy_seconds": round(r.busy_seconds, 3),
            "shards_per_minute": round(r.recent / 5.0, 2),
        })  # fmt: skip
    return sorted(found, key=lambda w: (("busy", "idle", "silent", "stopped").index(w["state"]), w["name"]))


def served_queues(engine: sa.Engine) -> dict[str, int]:
    """Return for each queue how many workers that live take from it."""
    alive = [w for w in listed(engine) if w["state"] in ("busy", "idle")]
    return {str(q): sum(str(q) in w["queues"] for w in alive) for q in Queue}


def forget(engine: sa.Engine, *, after_s: float = FORGET_S) -> int:
    """Delete the rows of workers that have been silent for long."""
    with write(engine) as tx:
        return tx.execute(sa.delete(worker).where(worker.c.heartbeat_at < now() - after_s)).rowcount
