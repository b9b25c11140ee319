"""The whole service as metrics, from the database: any API process tells of all workers and jobs alike.

Every API process says the same, so a dashboard takes `max` over instances, never `sum`. Labels are names of ours (states,
queues, stages, error codes), never an id, a tenant or what a client sent: the number of series is bounded by this code.
Rows are grouped over what waits or runs, which is little; what needs a look at every artifact is kept for a minute.
"""

import platform
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from importlib.metadata import version
from typing import Any

import sqlalchemy as sa
from farfield.stages import Queue
from farfield.store import counters, storage, workers
from farfield.store.artifacts import Artifacts
from farfield.store.counters import INF, SHARD_BUCKETS_S, STAGE_BUCKETS_S
from farfield.store.engine import now, read
from farfield.store.tables import JOB_STATES, job, shard
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector

from farfield_api.readiness import Readiness

KEPT_S = 60.0
# name in the table, help, labels: exported as farfield_NAME_total
COUNTERS = (
    ("jobs_ended", "Jobs that ended, by how.", ("state",)),
    ("job_failures", "Jobs that failed, by the error's code.", ("code",)),
    ("shards", "Shards that workers ended, by how: computed, cached, failed, stopped.", ("stage", "outcome")),
    ("shard_failures", "Attempts that failed, by the error's code.", ("stage", "code")),
    ("shard_retries", "Attempts after a failed one.", ("stage",)),
    ("leases_lost", "Shards taken over from a worker that died or fell silent.", ("stage",)),
    ("stored_bytes", "Bytes of artifacts that workers stored.", ("stage",)),
    ("collected_artifacts", "Unused artifacts that were removed.", ()),
    ("collected_bytes", "Bytes of unused artifacts that were removed.", ()),
    ("expired", "What was deleted because its time was over.", ("what",)),
    ("reconciler_rounds", "Rounds of the reconciler: it lives while this grows.", ()),
    ("resent_messages", "Messages that the reconciler sent.", ()),
)
HISTOGRAMS = (
    ("shard_seconds", "Seconds that a shard took to compute.", ("stage",), SHARD_BUCKETS_S),
    ("stage_seconds", "Seconds from a stage's start to its end.", ("stage", "state"), STAGE_BUCKETS_S),
)


class ClusterMetrics(Collector):
    """Collects when it is scraped; where the database does not answer, it says only that."""

    def __init__(self, engine: sa.Engine, artifacts: Artifacts, readiness: Readiness) -> None:
        self.engine, self.artifacts, self.readiness = engine, artifacts, readiness
        self._guard = threading.Lock()
        self._kept: tuple[float, list[Metric]] | None = None

    def collect(self) -> Iterator[Metric]:
        yield _gauge("build_info", "Versions of this process.", [(_build(), 1.0)])
        answer = self.readiness.ask()
        rows = [({"check": name}, float(text == "ok")) for name, text in answer.checks.items()]
        yield _gauge("ready", "1 where the check of /readyz passes.", rows)
        free = shutil.disk_usage(self.artifacts.temporary).free
        yield _gauge("disk_free_bytes", "Free bytes where artifacts are written.", [({}, float(free))])
        if answer.checks["database"] != "ok":
            return
        yield from self._now()
        yield from self._counted()
        yield from self._stored()

    def _now(self) -> Iterator[Metric]:
        count = sa.func.count()
        alive = sa.select(job.c.id).where(job.c.id == shard.c.job_id, job.c.state.in_(("queued", "running")))
        lapsed = (shard.c.state == "running") & (shard.c.lease_until < now())
        with read(self.engine) as tx:
            jobs: dict[str, int] = dict(tx.execute(sa.select(job.c.state, count).group_by(job.c.state)).tuples().all())
            waits = sa.select(shard.c.queue, count, sa.func.max(now() - shard.c.ready_at))
            could = (shard.c.state == "ready") & (shard.c.ready_at.is_(None) | (shard.c.ready_at <= now()))
            waits = waits.where(could | lapsed, alive.exists()).group_by(shard.c.queue)
            ready = {q: (n, age) for q, n, age in tx.execute(waits)}
            runs = sa.select(shard.c.queue, count).where(shard.c.state == "running", ~lapsed).group_by(shard.c.queue)
            running: dict[str, int] = dict(tx.execute(runs).tuples().all())
            late = tx.scalar(sa.select(count).select_from(shard).where(lapsed, alive.exists()))
        yield _gauge("jobs", "Jobs by state.", [({"state": s}, jobs.get(s, 0)) for s in JOB_STATES])
        each: Callable[[Callable[[str], Any]], list[Any]] = lambda f: [({"queue": str(q)}, f(str(q))) for q in Queue]  # noqa: E731
        yield _gauge("queue_depth", "Shards that wait for a worker.", each(lambda q: ready.get(q, (0, 0))[0]))
        yield _gauge(
            "queue_oldest_seconds", "How long the shard that waits longest has waited.",
            each(lambda q: max(0.0, ready.get(q, (0, 0.0))[1] or 0.0)),
        )  # fmt: skip
        yield _gauge("running_shards", "Shards being computed.", each(lambda q: running.get(q, 0)))
        yield _gauge("lapsed_shards", "Shards whose worker died or fell silent, not yet taken over.", [({}, late or 0)])
        told = workers.listed(self.engine)
        states = [
            ({"queue": str(q), "state": s}, sum(w["state"] == s and str(q) in w["queues"] for w in told))
            for q in Queue
            for s in ("busy", "idle", "silent")
        ]
        yield _gauge(
            "workers", "Workers by queue and state; one that takes from several queues counts in each.", states
        )

    def _counted(self) -> Iterator[Metric]:
        totals = counters.totals(self.engine)
        for name, text, labels in COUNTERS:
            family = CounterMetricFamily(f"farfield_{name}", text, labels=labels)
            rows = {
                tuple(counters.parsed(k).get(x, "") for x in labels): v for (n, k), v in totals.items() if n == name
            }
            for values, value in sorted(rows.items() if labels else {(): rows.get((), 0.0)}.items()):
                family.add_metric(values, value)
            yield family
        for name, text, labels, buckets in HISTOGRAMS:
            yield _histogram(name, text, labels, buckets, totals)

    def _stored(self) -> Iterable[Metric]:
        with self._guard:
            if self._kept is None or time.monotonic() > self._kept[0] + KEPT_S:
                self._kept = time.monotonic(), list(self._look())
            return self._kept[1]

    def _look(self) -> Iterator[Metric]:
        kept = storage.by_kind(self.engine)
        yield _gauge(
            "artifacts", "Artifacts by what they are.", [({"kind": k}, v["artifacts"]) for k, v in kept.items()]
        )
        yield _gauge("artifact_bytes", "Their bytes.", [({"kind": k}, v["bytes"]) for k, v in kept.items()])
        yield _gauge("events", "Events of jobs that are kept.", [({}, storage.n_events(self.engine))])


def _gauge(name: str, text: str, rows: Iterable[tuple[dict[str, str], Any]]) -> GaugeMetricFamily:
    rows = list(rows)
    labels = list(rows[0][0]) if rows else []
    family = GaugeMetricFamily(f"farfield_{name}", text, labels=labels)
    for row, value in rows:
        family.add_metric([row[label] for label in labels], float(value))
    return family


def _histogram(
    name: str, text: str, labels: tuple[str, ...], buckets: tuple[float, ...], totals: dict[tuple[str, str], float]
) -> HistogramMetricFamily:
    """Return the table's counts per bucket as Prometheus wants them: running sums."""
    counts: dict[tuple[str, ...], dict[str, float]] = {}
    sums: dict[tuple[str, ...], float] = {}
    for (counted, text_of_labels), value in totals.items():
        if counted not in (f"{name}_bucket", f"{name}_sum"):
            continue
        given = counters.parsed(text_of_labels)
        values = tuple(given.get(label, "") for label in labels)
        if counted == f"{name}_sum":
            sums[values] = value
        else:
            counts.setdefault(values, {})[given["le"]] = value
    family = HistogramMetricFamily(f"farfield_{name}", text, labels=labels)
    for values, found in sorted(counts.items()):
        total, running = 0.0, []
        for le in (*(f"{b:g}" for b in buckets), INF):
            total += found.get(le, 0.0)
            running.append((le, total))
        family.add_metric(values, running, sum_value=sums.get(values, 0.0))
    return family


def _build() -> dict[str, str]:
    return {"version": version("farfield"), "python": platform.python_version()}
