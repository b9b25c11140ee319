"""The service runs the real stages on the city's cut-out: its workers are killed on the way, and the bytes are `place`'s."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest

FARFIELD = (sys.executable, "-m", "farfield.cli.main")


@pytest.fixture
def service(tmp_path):
    """The launcher's process, and a client with its key."""
    command = [*FARFIELD, "serve", "--port", "0", "--workers", "2", "--data", str(tmp_path / "data"), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            told = json.loads(process.stdout.readline())
            key = Path(told["key_file"]).read_text().strip()
            with httpx.Client(base_url=told["url"], headers={"authorization": f"Bearer {key}"}, timeout=30) as client:
                yield process, told, client
        finally:
            process.terminate()
            process.wait(30)


def workers_of(launcher: int) -> list[int]:
    children = [int(pid) for pid in Path(f"/proc/{launcher}/task/{launcher}/children").read_text().split()]
    return [pid for pid in children if b"celery" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def wait_for_shard(client, job: str, stage: str, seconds: float = 180) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        shards = client.get(f"/v1/jobs/{job}/stages/{stage}/shards")
        if shards.status_code == 200 and any(s["state"] == "running" for s in shards.json()["shards"]):
            return
        time.sleep(0.02)
    raise AssertionError(f"no shard of {stage} was seen running")


def test_killed_workers_leave_the_bytes_of_an_undisturbed_run(placed, level, files_of, service, tmp_path):
    launcher, told, client = service
    scene, settings = level
    words = ["submit", str(scene), "--url", told["url"], "--key-file", told["key_file"], "--settings", str(settings)]
    job = json.loads(subprocess.check_output([*FARFIELD, *words, "--json"], text=True))["id"]
    for stage in ("candidates", "placement", "bake"):
        wait_for_shard(client, job, stage)
        for pid in workers_of(launcher.pid):
            os.kill(pid, signal.SIGKILL)
    end = time.monotonic() + 240
    while (state := client.get(f"/v1/jobs/{job}").json())["state"] in ("queued", "running"):
        assert time.monotonic() < end, state
        time.sleep(0.2)
    assert (state["state"], state["verdict"]) == ("done", "valid"), state
    service = ["--url", told["url"], "--key-file", told["key_file"], "--json"]
    fetch = [*FARFIELD, "fetch", job, "--out", str(tmp_path / "fetched"), *service]
    expected = files_of(placed[0] / "placement")
    assert json.loads(subprocess.check_output(fetch, text=True))["fetched"] == len(expected) + 2
    assert files_of(tmp_path / "fetched" / "placement") == expected
    assert (tmp_path / "fetched" / "scene.glb").read_bytes() == (placed[0] / "scene.glb").read_bytes()
    # What is there already does not come again: the report, which has no digest, and the manifest do.
    next((tmp_path / "fetched" / "placement" / "pages").iterdir()).write_bytes(b"damaged")
    assert json.loads(subprocess.check_output(fetch, text=True))["fetched"] == 3
    assert files_of(tmp_path / "fetched" / "placement") == expected
    logged = subprocess.check_output([*FARFIELD, "logs", job, "--follow", *service], text=True).splitlines()
    assert json.loads(logged[-1])["verdict"] == "valid"
    listed = json.loads(subprocess.check_output([*FARFIELD, "jobs", *service], text=True))["jobs"]
    assert [j["id"] for j in listed] == [job]
