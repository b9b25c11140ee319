"""Counts that only grow, added up over all processes of a service and kept in the table `counter`.

Problem  Workers come and go, and nobody can scrape a process that has ended; rows of jobs are deleted after a while, and
         a sum over them would fall.
Method   A process adds up in memory and now and then adds the sums to the rows, in one transaction whose rows are
         sorted: no deadlock, and a row that all workers share is locked for a moment every few seconds, not at every
         commit. A process that is killed loses what it has not yet added: at most one interval of a metric.
"""

import threading
from collections.abc import Iterable, Mapping

import sqlalchemy as sa

from farfield import errors
from farfield.store.engine import insert, read, write
from farfield.store.tables import counter

SHARD_BUCKETS_S = (0.05, 0.2, 1.0, 5.0, 20.0, 60.0, 300.0, 1200.0, 3600.0)
STAGE_BUCKETS_S = (1.0, 5.0, 20.0, 60.0, 300.0, 1200.0, 3600.0, 14400.0, 86400.0)
INF = "+Inf"

Key = tuple[str, str]


def labelled(labels: Mapping[str, str]) -> str:
    """Return labels as they stand in the table. Values are names of ours, never ids or what a client sent."""
    return ",".join(f"{key}={value}" for key, value in sorted(labels.items()))


def parsed(text: str) -> dict[str, str]:
    """Return what `labelled` was given."""
    return dict(pair.split("=", 1) for pair in text.split(",") if pair)


class Counts:
    """What one process has counted since it last told the table. Any thread may count."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._waiting: dict[Key, float] = {}

    def add(self, name: str, value: float = 1.0, **labels: str) -> None:
        """Count `value` (>= 0) more."""
        key = (name, labelled(labels))
        with self._guard:
            self._waiting[key] = self._waiting.get(key, 0.0) + value

    def observe(self, name: str, value: float, buckets: Iterable[float] = SHARD_BUCKETS_S, **labels: str) -> None:
        """Count one duration into `name_bucket` (the smallest that holds it) and `name_sum`."""
        bucket = next((f"{b:g}" for b in buckets if value <= b), INF)
        self.add(f"{name}_bucket", 1.0, **labels, le=bucket)
        self.add(f"{name}_sum", value, **labels)

    def flush(self, engine: sa.Engine) -> None:
        """Add everything to the table; what could not be added waits for the next time, and the error is raised."""
        with self._guard:
            taken, self._waiting = self._waiting, {}
        if not taken:
            return
        try:
            with write(engine) as tx:
                add(tx, taken)
        except BaseException:
            with self._guard:
                for key, value in taken.items():
                    self._waiting[key] = self._waiting.get(key, 0.0) + value
            raise


def add(tx: sa.Connection, counts: Mapping[Key, float]) -> None:
    """Add to the rows within the caller's transaction."""
    for (name, labels), value in sorted(counts.items()):
        statement = insert(tx, counter).values(name=name, labels=labels, value=value)
        tx.execute(
            statement.on_conflict_do_update(
                index_elements=[counter.c.name, counter.c.labels],
                set_={"value": counter.c.value + statement.excluded.value},
            )
        )


def count_stage(tx: sa.Connection, name: str, state: str, seconds: float) -> None:
    """Count a stage that has ended, in the transaction that ends it."""
    counts = Counts()
    counts.observe("stage_seconds", seconds, STAGE_BUCKETS_S, stage=name, state=state)
    add(tx, counts._waiting)


def count_lost(tx: sa.Connection, name: str) -> None:
    """Count a shard of this stage that was taken back from a worker that died or fell silent."""
    add(tx, {("leases_lost", labelled({"stage": name})): 1.0})


def count_job(tx: sa.Connection, state: str, code: str | None = None) -> None:
    """Count a job that has ended; `code` names the error of one that failed."""
    counts: dict[Key, float] = {("jobs_ended", labelled({"state": state})): 1.0}
    if code is not None:
        counts[("job_failures", labelled({"code": known_code(code)}))] = 1.0
    add(tx, counts)


def known_code(code: str) -> str:
    """Return an error's code where it is one of ours, else "Other": labels are few."""
    ours = isinstance(getattr(errors, code, None), type) or code in ("DiskFull", "OutOfMemory", "WorkerDied")
    return code if ours else "Other"


def totals(engine: sa.Engine) -> dict[Key, float]:
    """Return every count, by name and labels."""
    with read(engine) as tx:
        return {(r.name, r.labels): r.value for r in tx.execute(sa.select(counter))}
