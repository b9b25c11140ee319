"""What an operator sees: readiness that tells the truth, metrics of the whole service, logs without secrets."""

import io
import json
import logging
import os
import re
from dataclasses import replace

import pytest
import sqlalchemy as sa
from farfield import logs
from farfield.store import workers
from farfield.store.counters import Counts, add
from farfield.store.engine import write
from farfield.store.tables import worker as worker_table
from farfield.store.workers import Telling
from farfield_api import readiness
from farfield_api.app import make_app
from prometheus_client.parser import text_string_to_metric_families
from starlette.testclient import TestClient


def _scrape(service, operator):
    answer = service.client.get("/metrics", headers=operator)
    assert answer.status_code == 200, answer.text
    return {
        (s.name, tuple(sorted(s.labels.items()))): s.value
        for family in text_string_to_metric_families(answer.text)
        for s in family.samples
    }


def _ready(service, words=""):
    service.client.app.state.farfield.readiness._kept = None
    answer = service.client.get(f"/readyz{words}", headers={"authorization": ""})
    return answer.status_code, answer.json()


def _worker(service, name="a:1", queues=("cpu", "optimizer", "gl"), **told):
    capability = {"cores": 2, "memory_bytes": 1 << 30, "version": "1", "renderer": "Mesa, llvmpipe"}
    workers.tell(service.engine, Telling(name=name, host="a", queues=queues, capability=capability, **told))


def test_ready_says_each_check_and_a_broker_or_worker_that_is_away_only_degrades(service):
    status, told = _ready(service)
    assert (status, told["status"]) == (200, "degraded")
    assert {n: told["checks"][n] for n in readiness.HARD} == dict.fromkeys(readiness.HARD, "ok")
    assert "answer" in told["checks"]["broker"]
    assert told["checks"]["workers"] == "nobody works on: cpu, optimizer, gl"
    _worker(service, queues=("cpu", "gl"))
    assert _ready(service)[1]["checks"]["workers"] == "nobody works on: optimizer"
    assert _ready(service, "?strict=true")[0] == 503
    service.client.app.state.farfield.readiness.broker = lambda: None
    _worker(service)
    assert _ready(service)[1] == {"status": "ready", "checks": dict.fromkeys(readiness.HARD + readiness.SOFT, "ok")}
    assert _ready(service, "?strict=true")[0] == 200


def test_not_ready_without_a_database_that_can_be_written(service):
    with sa.create_engine(service.engine.url).connect() as other:
        other.exec_driver_sql("BEGIN IMMEDIATE")  # a writer that does not end
        status, told = _ready(service)
        assert (status, told["checks"]["database"]) == (503, "did not answer within 2 s")
        assert service.client.get("/livez").status_code == 200


def test_not_ready_when_the_database_is_older_than_the_code_but_when_it_is_newer(service):
    service.client.app.state.farfield.readiness.broker = lambda: None
    known = service.client.app.state.farfield.readiness.revisions
    for version, expected in ((known[1], 503), ("from the future", 200), (known[0], 200)):
        with write(service.engine) as tx:
            tx.execute(sa.text("UPDATE alembic_version SET version_num = :v").bindparams(v=version))
        status, told = _ready(service)
        assert (status, told["checks"]["migrations"] == "ok") == (expected, expected == 200), version


def test_not_ready_without_a_store_and_no_path_is_told(service):
    artifacts = service.settings.artifacts
    os.rename(artifacts, artifacts.with_name("gone"))
    status, told = _ready(service)
    assert status == 503
    assert told["checks"]["store"] != "ok"
    assert str(artifacts.parent) not in json.dumps(told)


def test_metrics_tell_of_jobs_shards_queues_and_requests(service, worker, operator):
    job = service.create()
    waiting = _scrape(service, operator)
    assert waiting["farfield_queue_depth", (("queue", "cpu"),)] == 1
    assert waiting["farfield_queue_depth", (("queue", "gl"),)] == 0
    assert 0 <= waiting["farfield_queue_oldest_seconds", (("queue", "cpu"),)] < 60
    assert waiting["farfield_jobs", (("state", "queued"),)] == 1
    worker()
    from farfield_workers import telemetry

    telemetry.here.counts.flush(service.engine)
    service.client.app.state.cluster._kept = None  # its minute is over
    done = _scrape(service, operator)
    assert done["farfield_jobs", (("state", "done"),)] == 1
    assert done["farfield_jobs_ended_total", (("state", "done"),)] == 1
    assert done["farfield_queue_depth", (("queue", "cpu"),)] == 0
    assert done["farfield_shards_total", (("outcome", "computed"), ("stage", "viewspace"))] >= 6
    assert done["farfield_shard_seconds_bucket", (("le", "+Inf"), ("stage", "viewspace"))] >= 6
    assert done["farfield_stage_seconds_count", (("stage", "bake"), ("state", "done"))] == 1
    assert done["farfield_stored_bytes_total", (("stage", "placementdb"),)] > 1000
    assert done["farfield_artifacts", (("kind", "scenes"),)] >= 1
    assert done["farfield_artifact_bytes", (("kind", "unreferenced"),)] == 0
    made = (("method", "POST"), ("route", "/v1/jobs"), ("status", "201"))
    assert done["farfield_http_requests_total", made] == 1
    assert done["farfield_http_request_seconds_count", (("method", "POST"), ("route", "/v1/jobs"))] == 1
    text = service.client.get("/metrics", headers=operator).text
    assert job not in text
    assert service.tenant_id not in text


def test_what_clients_choose_makes_no_series(service, operator):
    for i in range(20):
        service.client.get(f"/v1/jobs/{i:032x}")
        service.client.request(f"ODD{i}", "/v1/jobs")
        service.client.get(f"/no/such/page/{i}")
    series = {
        dict(labels).get("route") for name, labels in _scrape(service, operator) if name.startswith("farfield_http")
    }
    assert {"/v1/jobs/{job_id}"} <= series
    assert not [route for route in series if route and re.search(r"\d{2}|000", route)]
    assert len(series) < 12


def test_counts_of_many_processes_add_up_and_outlive_them(service, operator):
    for seconds in (0.01, 3.0, 9000.0):
        counts = Counts()
        counts.observe("shard_seconds", seconds, stage="bake")
        counts.add("shard_failures", stage="bake", code="SceneEmpty")
        counts.flush(service.engine)
    with write(service.engine) as tx:
        add(tx, {("leases_lost", "stage=bake"): 2.0})
    found = _scrape(service, operator)
    buckets = [found["farfield_shard_seconds_bucket", (("le", le), ("stage", "bake"))] for le in ("0.05", "5", "+Inf")]
    assert buckets == [1, 2, 3]
    assert found["farfield_shard_seconds_sum", (("stage", "bake"),)] == pytest.approx(9003.01)
    assert found["farfield_shard_failures_total", (("code", "SceneEmpty"), ("stage", "bake"))] == 3
    assert found["farfield_leases_lost_total", (("stage", "bake"),)] == 2


def test_workers_and_storage_are_shown_to_the_operator_alone(service, worker, operator):
    _worker(service, shard_id="0" * 32, stage="bake", shard_age_s=3.0, done=4, failed=1, recent=10)
    _worker(service, name="b:1", queues=("gl",))
    with write(service.engine) as tx:
        tx.execute(sa.update(worker_table).where(worker_table.c.name == "b:1").values(heartbeat_at=1.0))
    told = service.client.get("/v1/workers", headers=operator).json()
    assert [(w["name"], w["state"]) for w in told["workers"]] == [("a:1", "busy"), ("b:1", "silent")]
    first = told["workers"][0]
    assert (first["stage"], first["done"], first["failed"], first["shards_per_minute"]) == ("bake", 4, 1, 2.0)
    assert first["capability"]["renderer"] == "Mesa, llvmpipe"
    assert 3.0 <= first["shard_s"] < 60
    assert told["queues"] == {"cpu": 1, "optimizer": 1, "gl": 1}
    service.create()
    worker()
    storage = service.client.get("/v1/storage", headers=operator).json()
    assert storage["total"]["bytes"] == sum(kind["bytes"] for kind in storage["kinds"].values()) > 10_000
    assert {t["name"]: t["jobs"] for t in storage["tenants"]} == {"toy": 1, "us": 0}
    key = service.new_key("read", "admin", tenant="guest")
    for path in ("/metrics", "/v1/workers", "/v1/storage"):
        assert service.client.get(path, headers={"authorization": f"Bearer {key}"}).status_code == 403, path


def test_metrics_have_a_port_of_their_own_where_one_is_set(service):
    import socket

    import httpx

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with TestClient(make_app(replace(service.settings, metrics_port=port))):
        text = httpx.get(f"http://127.0.0.1:{port}/metrics", trust_env=False).text
    assert 'farfield_queue_depth{queue="cpu"} 0.0' in text


def test_every_answer_has_a_request_id_and_problems_tell_it(service):
    given = service.client.get("/v1/jobs/unknown", headers={"x-request-id": "build-17.a"})
    assert given.headers["x-request-id"] == given.json()["request_id"] == "build-17.a"
    odd = service.client.get("/v1/jobs", headers={"x-request-id": "a b\tc<script>"})
    assert re.fullmatch("[0-9a-f]{16}", odd.headers["x-request-id"])
    assert service.client.get("/v1/jobs").headers["x-request-id"] != odd.headers["x-request-id"]


@pytest.fixture
def lines():
    """What this process logs, as JSON lines."""
    stream, root = io.StringIO(), logging.getLogger()
    before, level = list(root.handlers), root.level
    logs.configure("test", {"FARFIELD_LOG": "json"})
    root.handlers[0].setStream(stream)
    yield lambda: [json.loads(line) for line in stream.getvalue().splitlines()]
    root.handlers[:] = before
    root.setLevel(level)


def test_logs_are_json_with_request_job_stage_shard_and_seconds(service, worker, lines):
    job = service.create()
    worker()
    service.client.get(f"/v1/jobs/{job}", headers={"x-request-id": "mine"})
    request = next(line for line in lines() if line.get("request") == "mine" and line["message"] == "request")
    assert (request["status"], request["job"], request["path"]) == (200, job, f"/v1/jobs/{job}")
    assert request["seconds"] >= 0
    shards = [line for line in lines() if line["message"] == "done" and line["logger"] == "farfield_workers.telemetry"]
    first = next(line for line in shards if (line["stage"], line["kind"]) == ("viewspace", "run"))
    assert (first["job"], first["shard"], first["attempt"], first["cached"]) == (job, 0, 1, False)
    assert first["seconds"] >= 0


def test_no_log_of_a_run_holds_a_key_a_token_or_a_query(service, worker, lines):
    secret = service.key
    login = service.client.post("/v1/logins", json={"to": "/jobs"}).json()["url"]
    token = re.search(r"login=([\w-]+)", login)[1]
    session = service.client.post("/v1/session", json={"login": token})
    cookie, csrf = session.cookies["farfield_session"], session.json()["csrf_token"]
    service.client.get(f"/v1/jobs?cursor={secret}&limit=1")
    service.client.get(f"/open?login={token}")
    service.client.get("/v1/jobs", headers={"authorization": f"Bearer {secret}x"})
    service.create(fail="bake", error="odd")
    worker()
    log = logging.getLogger("careless")
    log.warning("calling %s with Authorization: Bearer %s", f"postgresql://farfield:{'hunter2' * 2}@db/f", secret)
    log.warning("GET /v1/jobs?name=top-secret HTTP/1.1 and https://host/path?sig=top-secret#x")
    try:
        raise ValueError(f"bad key {secret} password=hunter2hunter2")
    except ValueError:
        log.exception("oh", extra={"fields": {"url": f"https://x/?k={secret}"}})
    text = json.dumps(lines())
    assert len(lines()) > 20
    for word in (
        secret,
        secret.split("_", 2)[2],
        token,
        cookie,
        csrf,
        "hunter2",
        "top-secret",
        service.settings.secret,
    ):
        assert word not in text, word[:8]
    assert "ValueError" in text
