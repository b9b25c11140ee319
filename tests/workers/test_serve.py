"""The whole service as processes: broker, API, workers, reconciler; one is killed and nothing is lost."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest
from farfield.columns import unpack_files

TESTS = Path(__file__).parents[1]
FARFIELD = (sys.executable, "-m", "farfield.cli.main")


def _environment():
    return {
        **os.environ,
        "FARFIELD_PIPELINE": "toy_pipeline:PIPELINE",
        "FARFIELD_INSPECT": f"{sys.executable} {TESTS / 'toy_inspect.py'}",
        "PYTHONPATH": str(TESTS),
        "FARFIELD_WEB": str(TESTS / "none"),
    }


class Served:
    def __init__(self, data, *words):
        self.data = data
        command = [*FARFIELD, "serve", "--port", "0", "--workers", "2", "--data", str(data), "--json", *words]
        self.process = subprocess.Popen(command, env=_environment(), stdout=subprocess.PIPE, text=True)
        self.told = json.loads(self.process.stdout.readline() or "null")
        assert self.told is not None, "it did not start"
        self.key = (data / "api-key").read_text().strip()
        self.client = httpx.Client(
            base_url=self.told["url"], headers={"authorization": f"Bearer {self.key}"}, timeout=20
        )

    def stop(self):
        if self.process.poll() is None:
            self.process.terminate()
        self.client.close()
        return self.process.wait(30)


def _children(pid):
    return [int(c) for c in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    service = Served(tmp_path_factory.mktemp("serve") / "data")
    yield service
    service.stop()


def _submit(served, scene, *words, key=None):
    command = [*FARFIELD, "submit", str(scene), "--url", served.told["url"], "--json", *words]
    environment = {**os.environ, "FARFIELD_KEY": key or served.key}
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)


def test_a_killed_worker_costs_time_but_no_bytes(served, bench, tmp_path):
    once = tmp_path / "crashed"
    scene = tmp_path / "toy.glb"
    # The worker that runs shard 1 of viewspace kills itself with SIGKILL, once.
    scene.write_text(json.dumps({"seconds": 0.2, "crash_once": str(once)}))
    killed = _submit(served, scene, "--watch")
    assert killed.returncode == 0, killed.stderr
    assert once.exists()
    job = json.loads(killed.stdout)
    assert (job["state"], job["verdict"]) == ("done", "valid")
    shards = served.client.get(f"/v1/jobs/{job['id']}/stages/viewspace/shards").json()["shards"]
    assert max(s["attempt"] for s in shards) == 2
    # The same job where nobody dies has the same files.
    calm, message = bench.submit(**json.loads(scene.read_text()))
    bench.run(message)
    artifact = bench.artifacts.buffer(bench.stages(calm)["placementdb"]["artifact"])
    for name, content in unpack_files(artifact):
        path = name.removeprefix("placement/")
        assert served.client.get(f"/v1/placements/{job['id']}/{path}").content == bytes(content), name


def test_a_small_job_ends_long_before_a_heavy_one_that_came_first(served, tmp_path):
    heavy, small = tmp_path / "heavy.glb", tmp_path / "small.glb"
    heavy.write_text(json.dumps({"seconds": 0.1, "shards": 150}))
    small.write_text(json.dumps({"seconds": 0.1, "shards": 3}))
    first = json.loads(_submit(served, heavy).stdout)["id"]
    end = time.monotonic() + 60
    while (
        not served.client.get(f"/v1/jobs/{first}/stages/viewspace/shards").json()["shards"] and time.monotonic() < end
    ):
        time.sleep(0.05)
    done = _submit(served, small, "--watch")
    assert done.returncode == 0, done.stderr
    left = served.client.get(f"/v1/jobs/{first}").json()
    assert left["state"] == "running"
    assert next(s for s in left["stages"] if s["name"] == "viewspace")["shards"]["ready"] > 20
    assert served.client.post(f"/v1/jobs/{first}/cancel").json()["state"] == "cancelled"


def test_submit_tells_its_outcome_by_its_exit_code(served, tmp_path):
    scene = tmp_path / "toy.glb"
    scene.write_text(json.dumps({"fail": "evaluation"}))
    unproven = _submit(served, scene, "--watch")
    assert (unproven.returncode, json.loads(unproven.stdout)["verdict"]) == (4, "unproven")
    assert "/open#login=" in json.loads(unproven.stdout)["viewer"]
    scene.write_text("no json")
    bad = _submit(served, scene)
    assert bad.returncode == 3
    assert bad.stderr.startswith("SceneUnreadable: ")
    assert "Traceback" not in bad.stderr
    scene.write_text("{}")
    assert _submit(served, scene, "--budget", "fast").returncode == 2
    accepted = _submit(served, scene, "--idempotency-key", "a")
    again = _submit(served, scene, "--idempotency-key", "a")
    assert accepted.returncode == again.returncode == 0
    assert json.loads(accepted.stdout)["id"] == json.loads(again.stdout)["id"]
    assert _submit(served, scene, key="ff_wrong_key").returncode == 2


def test_a_killed_launcher_takes_its_processes_along_and_the_next_one_goes_on(tmp_path):
    first = Served(tmp_path / "data")
    scene = tmp_path / "toy.glb"
    scene.write_text(json.dumps({"seconds": 0.25}))
    job = json.loads(_submit(first, scene).stdout)["id"]
    end = time.monotonic() + 20
    while first.client.get(f"/v1/jobs/{job}").json()["state"] == "queued" and time.monotonic() < end:
        time.sleep(0.05)
    everything = _children(first.process.pid)
    first.process.kill()
    first.stop()
    end = time.monotonic() + 10
    while any(Path(f"/proc/{pid}").exists() for pid in everything) and time.monotonic() < end:
        time.sleep(0.05)
    assert not [pid for pid in everything if Path(f"/proc/{pid}").exists()]
    second = Served(tmp_path / "data")
    try:
        end = time.monotonic() + 30
        while (state := second.client.get(f"/v1/jobs/{job}").json()["state"]) != "done" and time.monotonic() < end:
            time.sleep(0.1)
        assert state == "done"
        assert second.key == first.key
    finally:
        assert second.stop() == 0


def test_only_the_owner_reads_the_key_and_nobody_else_is_let_in(served):
    assert (served.data / "api-key").stat().st_mode & 0o777 == 0o600
    assert httpx.get(served.told["url"] + "/v1/jobs").status_code == 401
    strange = httpx.get(served.told["url"] + "/livez", headers={"host": "rebound.example"})
    assert strange.status_code == 400
    again = subprocess.run(
        [*FARFIELD, "serve", "--port", "0", "--data", str(served.data)], capture_output=True, text=True, timeout=30
    )
    assert again.returncode == 3
    assert "already" in again.stderr


def test_an_open_connection_is_answered_without_waiting_for_acknowledgements(served):
    """With Nagle's algorithm every answer after the first few takes the 40 ms of a delayed acknowledgement, however fast."""
    seconds = []
    for _ in range(40):
        began = time.perf_counter()
        assert served.client.get("/livez").status_code == 200
        seconds.append(time.perf_counter() - began)
    assert min(seconds[20:]) < 0.035, f"{min(seconds[20:]):.3f} s at best"


def test_nothing_listens_beyond_loopback_unasked(tmp_path):
    refused = subprocess.run(
        [*FARFIELD, "serve", "--host", "0.0.0.0", "--data", str(tmp_path)], capture_output=True, text=True, timeout=30
    )
    assert refused.returncode == 3
    assert "--allow-remote" in refused.stderr


def test_killed_processes_come_back(served, tmp_path):
    scene = tmp_path / "toy.glb"
    scene.write_text(json.dumps({"seconds": 0.1}))
    everything = _children(served.process.pid)
    for pid in everything:  # also the broker, with all its messages, and the API
        os.kill(pid, signal.SIGKILL)
    end = time.monotonic() + 30
    while len(_children(served.process.pid)) < len(everything) and time.monotonic() < end:
        time.sleep(0.1)
    done = _submit(served, scene, "--watch")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("host", ["127.0.0.2", "::1"])
def test_any_loopback_address_is_answered_and_no_proxy_asked(tmp_path, monkeypatch, host):
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    monkeypatch.delenv("no_proxy", raising=False)
    monkeypatch.delenv("NO_PROXY", raising=False)
    service = Served(tmp_path / "data", "--host", host)
    try:
        shown = f"[{host}]" if ":" in host else host
        assert service.told["url"].startswith(f"http://{shown}:")
        assert service.data.stat().st_mode & 0o777 == 0o700
    finally:
        assert service.stop() == 0
