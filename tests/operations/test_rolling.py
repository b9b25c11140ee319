"""Workers and API processes are replaced one after another under a running job, and nobody notices."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import httpx
import pytest
import sqlalchemy as sa
from farfield.client import Client
from farfield.store import tenants, workers
from farfield.store.counters import totals
from farfield.store.engine import open_engine, read
from farfield.store.tables import shard
from farfield_workers.broker import broker_command, wait_for_broker
from farfield_workers.serve import migrate

TESTS = Path(__file__).parents[1]


class Fleet:
    """The processes of a service as an orchestrator runs them; the listening socket stands for its load balancer."""

    def __init__(self, folder):
        self.folder = folder
        database = f"sqlite:///{folder / 'farfield.sqlite'}"
        self.engine = open_engine(database)
        migrate(self.engine, TESTS.parent / "migrations")
        self.key = tenants.create_key(self.engine, tenants.create_tenant(self.engine, "toy"), "t", ("read", "submit"))
        command, broker = broker_command(folder)
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self.listening.getsockname()[1]}"
        self.environment = {
            **os.environ, "FARFIELD_DATABASE_URL": database, "FARFIELD_BROKER_URL": f"redis+socket://{broker}",
            "FARFIELD_ARTIFACTS": str(folder / "artifacts"), "FARFIELD_SECRET": "ab" * 32, "FARFIELD_LOG": "json",
            "FARFIELD_PIPELINE": "toy_pipeline:PIPELINE", "PYTHONPATH": str(TESTS), "FARFIELD_STOP_S": "0.5",
            "FARFIELD_INSPECT": f"{sys.executable} {TESTS / 'toy_inspect.py'}", "FARFIELD_WEB": str(folder),
            "FARFIELD_FD": str(self.listening.fileno()),
        }  # fmt: skip
        self.running = {}
        self.start("broker", command)
        wait_for_broker(broker)

    def start(self, name, command):
        with (self.folder / f"{name}.log").open("ab") as log:
            self.running[name] = subprocess.Popen(
                command, env=self.environment, stdout=log, stderr=log, pass_fds=(self.listening.fileno(),)
            )

    def start_python(self, name, module):
        self.start(name, [sys.executable, "-m", module])

    def replace(self, name, module):
        """Stop the process as an orchestrator does, and start another once it has gone."""
        old = self.running[name]
        old.send_signal(signal.SIGTERM)
        assert old.wait(25) in (0, -signal.SIGTERM), (self.folder / f"{name}.log").read_text()[-2000:]
        self.start_python(name, module)

    def stop(self):
        for process in reversed(self.running.values()):
            process.terminate()
        for process in self.running.values():
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
        self.engine.dispose()
        self.listening.close()


@pytest.fixture
def fleet(tmp_path):
    fleet = Fleet(tmp_path)
    try:
        yield fleet
    finally:
        fleet.stop()


def _wait(what, seconds=60):
    end = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < end, "it takes too long"
        time.sleep(0.1)
    return found


class Watcher(threading.Thread):
    """Asks for the job's state again and again, as a dashboard does, on connections of its own."""

    def __init__(self, fleet, job):
        super().__init__(daemon=True)
        self.fleet, self.job, self.statuses, self.again, self.ended = fleet, job, [], 0, threading.Event()

    def run(self):
        headers = {"authorization": f"Bearer {self.fleet.key}"}
        with httpx.Client(base_url=self.fleet.url, headers=headers, timeout=30, trust_env=False) as client:
            while not self.ended.wait(0.1):
                try:
                    self.statuses.append(client.get(f"/v1/jobs/{self.job}").status_code)
                except httpx.TransportError:  # the connection was closed by a process that ended: once more
                    self.again += 1


def test_a_rolling_restart_fails_no_job_and_no_request(fleet):
    fleet.start_python("api-1", "farfield_api")
    fleet.start_python("api-2", "farfield_api")
    for name in ("worker-1", "worker-2"):
        fleet.start_python(name, "farfield_workers")
    fleet.start_python("reconciler", "farfield_workers.reconciler")
    with Client(fleet.url, fleet.key, trust_proxy=False) as client:
        scene = fleet.folder / "toy.glb"
        scene.write_text(json.dumps({"shards": 5, "seconds": 2.0}))  # a shard outlasts FARFIELD_STOP_S
        job = client.create_job(client.send_scene(scene)["digest"], {}, idempotency_key="a")["id"]
        seen = []
        follower = threading.Thread(
            target=lambda: seen.extend(data for _, data in Client(fleet.url, fleet.key, trust_proxy=False).events(job)),
            daemon=True,
        )
        follower.start()
        watcher = Watcher(fleet, job)
        watcher.start()

        def computing():
            return [w for w in workers.listed(fleet.engine) if w["state"] == "busy" and w["stage"] == "viewspace"]

        _wait(computing)
        for name, module in (
            ("worker-1", "farfield_workers"), ("api-1", "farfield_api"), ("worker-2", "farfield_workers"),
            ("api-2", "farfield_api"), ("reconciler", "farfield_workers.reconciler"),
        ):  # fmt: skip
            fleet.replace(name, module)
            time.sleep(0.3)
        _wait(lambda: client.job(job)["state"] in ("done", "failed", "cancelled"), 120)
        assert client.job(job)["verdict"] == "valid"
        watcher.ended.set()
        watcher.join(30)
        follower.join(30)
    assert set(watcher.statuses) == {200}
    assert len(watcher.statuses) > 20
    assert watcher.again <= 4
    assert seen[-1]["state"] == "done"
    # A stop is no fault of a shard: no attempt was counted, no lease had to run out.
    with read(fleet.engine) as tx:
        assert set(tx.scalars(sa.select(shard.c.attempt).where(shard.c.job_id == job))) == {1}
    assert not [key for key in totals(fleet.engine) if key[0] in ("leases_lost", "shard_failures")]
    stopped = [w for w in workers.listed(fleet.engine) if w["state"] == "stopped"]
    assert len(stopped) == 2
    logged = "".join(path.read_text() for path in fleet.folder.glob("*.log"))
    assert fleet.key not in logged
    assert fleet.key.split("_", 2)[2] not in logged
    # But for the two words that Celery says when it is asked to stop, every line is an object.
    written = [line for line in (fleet.folder / "worker-1.log").read_text().splitlines() if "Warm shutdown" not in line]
    lines = [json.loads(line) for line in written if line]
    assert {"job", "stage", "shard", "attempt", "seconds", "worker"} <= next(
        set(x) for x in lines if x["message"] == "done"
    )
