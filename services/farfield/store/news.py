"""What a running shard says of itself, as an event of its job: from whoever holds the shard, and nobody else."""

from collections.abc import Mapping
from typing import Any

import sqlalchemy as sa

from farfield.store import events
from farfield.store.engine import write
from farfield.store.shards import OURS, Claim, lock_job, ours
from farfield.store.tables import job, shard


def tell(engine: sa.Engine, held: Claim, fact: Mapping[str, Any]) -> bool:
    """Write an event "progress". False: the shard is no longer ours, and nothing is written."""
    with write(engine) as tx:
        lock_job(tx, held.job_id)
        if tx.execute(_RUNNING, ours(held)).one_or_none() is None:
            return False
        place = {"stage": held.stage, "kind": held.kind, "ordinal": held.ordinal, "attempt": held.attempt}
        events.append(tx, held.job_id, "progress", {**place, **fact})
        return True


_RUNNING = sa.select(shard.c.id).join(job, job.c.id == shard.c.job_id).where(OURS, job.c.state == "running")
