"""What the service itself costs: a shard, a request under load, a job beside `farfield place`. All on loopback."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import sqlalchemy as sa
from benchmarks.load import load
from benchmarks.measure import best_seconds, exponent
from chaos.cluster import run_cluster
from chaos.level import level
from farfield.settings import Settings, from_mapping, to_mapping
from farfield.stages import Stage
from farfield.store import jobs, scenes, tenants
from farfield.store.artifacts import LocalArtifacts
from farfield.store.engine import open_engine, read, write
from farfield.store.fair import Host, next_shard
from farfield.store.shards import put_artifact
from farfield.store.tables import job, scene, shard, stage
from farfield_workers.serve import migrate
from servers import MIGRATIONS

TESTS = Path(__file__).parents[1]
TOY = {"FARFIELD_PIPELINE": "toy_pipeline:PIPELINE", "PYTHONPATH": f"{TESTS}:{os.environ.get('PYTHONPATH', '')}"}


def toy_job(cluster, **wish):
    """Create a job of the toy pipeline past the API, and return its id: the reconciler finds it."""
    data, artifacts = json.dumps(wish).encode(), LocalArtifacts(cluster.artifacts)
    digest = artifacts.put(data)
    scenes.add(
        cluster.engine, cluster.tenant_id, digest=digest, name="toy.glb", suffix=".glb", n_bytes=len(data), summary={},
        inspect_digest=artifacts.put(b"{}"), inspect_bytes=2,
    )  # fmt: skip
    return jobs.create(
        cluster.engine, cluster.tenant_id, name="toy", scene_digest=digest, settings=to_mapping(Settings()),
        stages=list(Stage), idempotency_key=None,
    )[0]  # fmt: skip


def wait_for(cluster, job_id, seconds):
    end = time.monotonic() + seconds
    while jobs.get(cluster.engine, cluster.tenant_id, job_id).state in ("queued", "running"):
        assert time.monotonic() < end
        time.sleep(0.2)
    assert jobs.get(cluster.engine, cluster.tenant_id, job_id).state == "done"


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_shard_costs_a_few_milliseconds_of_processor_time_however_many_there_are(kind, request, report):
    """Scheduling, claim, commit, progress and the shard's own files: the toy stage computes nothing to speak of."""
    sizes = (1_000, 10_000, 100_000) if request.config.getoption("--bench-large") else (300, 1_000, 3_000)
    costs = []
    with run_cluster(kind, workers=2, lease_s=60.0, **TOY) as cluster:
        wait_for(cluster, toy_job(cluster, shards=10), 120)  # what is made once
        for n in sizes:
            before = cluster.cpu_seconds()
            job_id = toy_job(cluster, shards=n)
            wait_for(cluster, job_id, 60 + 0.1 * n)
            costs.append(cluster.cpu_seconds() - before)
            began = time.perf_counter()
            jobs.stages_of(cluster.engine, job_id)
            listed_ms = 1e3 * (time.perf_counter() - began)
    slope = (costs[-1] - costs[0]) / (sizes[-1] - sizes[0])
    report(
        stage="service", work="a shard, all processes", input=kind, seconds=slope, rate=1 / slope, unit="shards/CPU s",
        exponent=exponent(sizes, costs), sizes=", ".join(f"{n:,}" for n in sizes),
    )  # fmt: skip
    print(
        f"\n{kind}: {1e3 * slope:.2f} ms of processor time a shard; stages of the last job read in {listed_ms:.1f} ms"
    )


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_two_hundred_streams_and_fifty_requests_a_second(kind, report):
    with run_cluster(kind, workers=1, lease_s=60.0, FARFIELD_RATE_READ="", **TOY) as cluster:
        done = toy_job(cluster, shards=6)
        wait_for(cluster, done, 120)
        idle = toy_job(cluster, shards=4, seconds=60.0)
        status, tile = f"/v1/jobs/{done}", f"/v1/placements/{done}/pages/p.bin"
        assert cluster.ask("GET", tile).status_code == 200
        before, began = cluster.cpu_seconds(), time.monotonic()
        found = load(
            str(cluster.client.base_url), cluster.key, (status, tile), f"/v1/jobs/{idle}/events", streams=200, rate=50,
            seconds=20.0,
        )  # fmt: skip
        share = (cluster.cpu_seconds() - before) / (time.monotonic() - began)
    for name, path in (("status", status), ("tile", tile)):
        p50, p99 = found.percentile(path, 0.5), found.percentile(path, 0.99)
        print(f"\n{kind} {name}: median {p50:.1f} ms, 99th percentile {p99:.1f} ms of {len(found.latencies_ms[path])}")
        report(stage="service", work=f"{name} under load, p99", input=f"{kind}, 200 streams", seconds=p99 / 1e3, rate=50,
               unit="requests/s")  # fmt: skip
    print(
        f"{found.failed} failed, {found.streams_lost} streams lost, {share:.2f} cores used, load {os.getloadavg()[0]:.1f}"
    )
    assert found.failed == 0
    assert found.streams_lost == 0


def test_overhead_over_place(tmp_path, report):
    """The same level by `farfield place` and by a service that is up, two workers each, nothing known beforehand."""
    glb, settings = level(1)
    scene, toml = tmp_path / "town.glb", tmp_path / "town.toml"
    scene.write_bytes(glb)
    toml.write_text(_toml(settings))
    command = [sys.executable, "-m", "farfield.cli.main"]
    more = ["--settings", str(toml)]
    taken = {"place": [], "service": []}
    with run_cluster("sqlite", workers=2, lease_s=60.0) as cluster:
        key = tmp_path / "key"
        key.write_text(cluster.key)
        service = ["--url", str(cluster.client.base_url), "--key-file", str(key), "--watch", "--json"]
        for k in range(2):
            began, cpu = time.perf_counter(), os.times()
            words = [*command, "place", str(scene), *more, "--workers", "2", "--out", str(tmp_path / f"{k}"), "--json"]
            subprocess.run(words, check=True, capture_output=True)
            spent = os.times()
            taken["place"].append((time.perf_counter() - began, spent[2] + spent[3] - cpu[2] - cpu[3]))
            began, cpu_s, cpu = time.perf_counter(), cluster.cpu_seconds(), os.times()
            ran = subprocess.run([*command, "submit", str(scene), *more, *service], capture_output=True, text=True)
            assert ran.returncode == 0, ran.stderr
            spent = os.times()
            own = spent[2] + spent[3] - cpu[2] - cpu[3]
            taken["service"].append((time.perf_counter() - began, cluster.cpu_seconds() - cpu_s + own))
            assert cluster.ask("DELETE", f"/v1/jobs/{json.loads(ran.stdout)['id']}").is_success
    best = {name: tuple(min(column) for column in zip(*runs)) for name, runs in taken.items()}
    wall, cpu = (best["service"][k] / best["place"][k] for k in (0, 1))
    print(f"\nservice over place: {wall:.2f} of the wall clock, {cpu:.2f} of the processor time; {best}")
    report(stage="service", work="a job, over `farfield place`", input="a town of 48 houses", seconds=best["service"][0],
           rate=wall, unit="x its wall clock")  # fmt: skip


def _toml(settings):
    """Write settings as TOML: what differs from the defaults, tables as dotted keys."""
    lines, plain = [], to_mapping(Settings())
    for name, value in settings.items():
        if isinstance(value, dict):
            lines += [
                f"{name}.{k} = {json.dumps(v)}" for k, v in value.items() if v is not None and v != plain[name][k]
            ]
        elif value is not None and value != plain[name]:
            lines.append(f"{name} = {json.dumps(value)}")
    text = "\n".join(lines) + "\n"
    import tomllib

    assert to_mapping(from_mapping(tomllib.loads(text))) == settings
    return text


def test_ten_thousand_jobs_are_listed_and_served_at_once(tmp_path, report):
    """The jobs page's query, a filtered one, and the choice of the next shard, among 10^4 jobs that wait."""
    engine = open_engine(f"sqlite:///{tmp_path / 'farfield.sqlite'}")
    migrate(engine, MIGRATIONS)
    tenant_id = tenants.create_tenant(engine, "many")
    n, settings, now_s = 10_000, to_mapping(Settings()), time.time()
    with write(engine) as tx:
        put_artifact(tx, "0" * 64, 1)
        tx.execute(sa.insert(scene).values(
            tenant_id=tenant_id, digest="0" * 64, name="toy", suffix=".glb", n_bytes=1, summary={}, created_at=now_s,
            inspect_digest="0" * 64,
        ))  # fmt: skip
        rows = [{"id": f"{k:032x}", "tenant_id": tenant_id, "job_id": f"{k:032x}"} for k in range(n)]
        plain = {"name": "toy", "scene_digest": "0" * 64, "settings": settings, "state": "queued", "event_seq": 0,
                 "optimizer_token": 0, "request_digest": "0" * 64}  # fmt: skip
        tx.execute(sa.insert(job), [
            {**plain, "id": r["id"], "tenant_id": tenant_id, "created_at": now_s - k, "turn": k} for k, r in enumerate(rows)
        ])  # fmt: skip
        names = list(map(str, Stage))
        for start in range(0, n, 1000):
            part = rows[start : start + 1000]
            tx.execute(sa.insert(stage), [
                {**r, "id": f"{r['id'][:-2]}{r['id'][-2:]}"[-28:] + f"{i:04x}", "ordinal": i, "name": name,
                 "state": "waiting" if i else "planning"} for r in part for i, name in enumerate(names)
            ])  # fmt: skip
            tx.execute(sa.insert(shard), [
                {**r, "stage_id": r["id"][-28:] + "0000", "kind": "plan", "ordinal": 0, "queue": "cpu", "params": None,
                 "state": "ready", "attempt": 0, "cached": False} for r in part
            ])  # fmt: skip

    def listed(**more):
        found = jobs.page(engine, tenant_id, before=None, limit=50, **more)
        return jobs.stages_of_all(engine, [row.id for row in found])

    for work, run in (
        ("a page of jobs", listed), ("... of one state", lambda: listed(state="queued")),
        ("the next shard", lambda: next_shard(engine, "cpu", Host(name="here"))),
    ):  # fmt: skip
        seconds = best_seconds(run, within_s=1.0)
        report(stage="service", work=work, input="10,000 jobs", seconds=seconds, rate=1 / seconds, unit="/s")
        assert seconds < 0.1, work
    engine.dispose()


@pytest.mark.parametrize("supervised", [True, False])
def test_recovery_after_a_workers_death(supervised, report):
    """From SIGKILL of the worker to the claim of its shard by another: told by a supervisor, or only by the lease."""
    lease_s = 60.0 if supervised else 8.0
    with run_cluster("sqlite", workers=2, lease_s=lease_s, **TOY) as cluster:
        wait_for(cluster, toy_job(cluster, shards=2), 120)
        job_id = toy_job(cluster, shards=1, seconds=30.0)
        held = None
        while held is None:
            time.sleep(0.1)
            with read(cluster.engine) as tx:
                held = tx.execute(
                    sa.select(shard.c.id, shard.c.worker).join(stage, stage.c.id == shard.c.stage_id)
                    .where(shard.c.job_id == job_id, shard.c.state == "running", stage.c.name == "viewspace",
                           shard.c.kind == "run")
                ).one_or_none()  # fmt: skip
        name = held.worker.split(":")[0]
        if not supervised:
            cluster.children.pop(name).process.kill()  # nobody looks after it: as if its host were gone
        else:
            os.kill(cluster.pid(name), signal.SIGKILL)
        began = time.monotonic()
        while True:
            with read(cluster.engine) as tx:
                if (tx.scalar(sa.select(shard.c.attempt).where(shard.c.id == held.id)) or 0) > 1:
                    break
            time.sleep(0.02)
            assert time.monotonic() - began < 120
        seconds = time.monotonic() - began
    how = "supervised" if supervised else f"lease of {lease_s:.0f} s"
    report(
        stage="service", work="recovery from a worker's death", input=how, seconds=seconds, rate=1 / seconds, unit="/s"
    )
    assert seconds < lease_s + 5.0
