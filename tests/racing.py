"""A worker without a broker, as a process: runs whatever is ready, in an order of its own, until every job has ended.

python racing.py DATABASE_URL ARTIFACTS SEED
"""

import random
import sys
import time
from dataclasses import replace
from pathlib import Path

import sqlalchemy as sa
import toy_pipeline
from farfield.store import progress
from farfield.store.artifacts import open_artifacts
from farfield.store.engine import open_engine, read
from farfield.store.tables import job
from farfield_workers.settings import WorkerSettings
from farfield_workers.work import work


def main(url: str, store: str, seed: str) -> None:
    engine, artifacts, order = open_engine(url), open_artifacts(store), random.Random(int(seed))
    settings = WorkerSettings(
        database_url=url, broker_url="", artifacts=Path(store), worker=f"racer {seed}", pipeline="", lease_s=60.0,
        renew_s=5.0, scene_memory_bytes=0, scene_seconds=60,
    )  # fmt: skip
    pipeline = replace(toy_pipeline.PIPELINE, isolated=frozenset())
    end = time.monotonic() + 100
    while time.monotonic() < end:
        messages = progress.ready(engine)
        order.shuffle(messages)
        for message in messages:
            work(engine, artifacts, pipeline, settings, message.shard_id)
        with read(engine) as tx:
            if not messages and tx.scalar(sa.select(sa.func.count()).where(job.c.finished_at.is_(None))) == 0:
                return
    raise SystemExit("a job has not ended")


if __name__ == "__main__":
    main(*sys.argv[1:])
