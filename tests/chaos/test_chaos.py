"""Nothing is lost, doubled or different, whatever dies: seeded runs of the real stages under random faults.

A few in `make test`, 50 in `make chaos`. Each run places a small town, with faults drawn from its seed while it runs, and
must end with the bytes of an undisturbed run, every stage advanced once.
"""

import functools
import random
import time
from collections import Counter

import pytest
import sqlalchemy as sa
from chaos.audit import audit
from chaos.cluster import Cluster, run_cluster
from chaos.faults import COSTLY, FAULTS
from chaos.level import level, undisturbed
from farfield.store.engine import read
from farfield.store.tables import shard

TOWNS = 4
MOST_FAULTS = 6
expected = functools.cache(undisturbed)


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def cluster(request):
    with run_cluster(request.param, small=True) as running:
        yield running


def submit(cluster: Cluster, town: int) -> str:
    glb, settings = level(town)
    headers = {"content-disposition": f'attachment; filename="town-{town}.glb"'}
    told = cluster.ask("POST", "/v1/scenes", content=glb, headers=headers)
    assert told.is_success, told.text
    key = {"idempotency-key": f"town-{time.monotonic_ns()}"}
    made = cluster.ask("POST", "/v1/jobs", json={"scene": told.json()["digest"], "settings": settings}, headers=key)
    assert made.is_success, made.text
    return made.json()["id"]


def frail(cluster: Cluster) -> bool:
    """Say whether a shard is on its last attempts: a job whose worker died three times is meant to fail."""
    with read(cluster.engine) as tx:
        open_ = shard.c.state.in_(("ready", "running"))
        return (tx.scalar(sa.select(sa.func.max(shard.c.attempt)).where(open_)) or 0) >= 2


def disturb(cluster: Cluster, job_id: str, rng: random.Random, *, seconds: float = 240.0) -> list[str]:
    """Let things go wrong until the job has ended; return what did."""
    told, end = [], time.monotonic() + seconds
    while cluster.ask("GET", f"/v1/jobs/{job_id}").json()["state"] in ("queued", "running"):
        assert time.monotonic() < end, f"the job stands still after {told}: {_open(cluster)}\n{cluster.story()}"
        name = rng.choice(sorted(FAULTS))
        if len(told) < MOST_FAULTS and not (name in COSTLY and frail(cluster)):
            told.append(name)
            try:
                FAULTS[name](cluster, rng)
            except sa.exc.DBAPIError:  # the fault before has taken our own connection
                pass
        time.sleep(rng.uniform(0.05, 0.8))
    return told


def _open(cluster: Cluster) -> list[tuple]:
    columns = ("kind", "ordinal", "queue", "state", "attempt", "put_off", "ready_at", "lease_until", "worker", "error")
    with read(cluster.engine) as tx:
        rows = tx.execute(sa.select(*(shard.c[name] for name in columns)).where(shard.c.state != "done"))
        return [tuple(row) for row in rows]


def run(cluster: Cluster, seed: int) -> list[str]:
    rng = random.Random(seed)
    town = seed % TOWNS
    calm = expected(town)  # first: it compiles the kernels, if that is still to be done
    job_id = submit(cluster, town)
    told = disturb(cluster, job_id, rng)
    try:
        audit(cluster, job_id, calm)
    except AssertionError as error:
        raise AssertionError(f"seed {seed}, {told}: {error}") from error
    # The next run of this town has to do all of it again.
    assert cluster.ask("DELETE", f"/v1/jobs/{job_id}").is_success
    return told


def test_nothing_is_lost_doubled_or_different(cluster, request):
    runs, first = request.config.getoption("--chaos"), request.config.getoption("--chaos-first")
    faults, started = Counter(), time.monotonic()
    for seed in range(first, first + runs):
        told = run(cluster, seed + (1000 if cluster.engine.dialect.name == "postgresql" else 0))
        faults.update(told)
        print(
            f"\n{cluster.engine.dialect.name} seed {seed}: {time.monotonic() - started:.0f} s, {', '.join(told)}",
            end="",
            flush=True,
        )
    print(f"\n{runs} runs on {cluster.engine.dialect.name}: {dict(sorted(faults.items()))}")
