"""The same job on PostgreSQL, a broker over TCP and an S3 bucket: processes that share only URLs, and the bytes of one."""

import json
import os
import secrets
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from fleet import Fleet, calm_files
from servers import broker, free_port, postgres, s3_server  # noqa: F401  (fixtures)

TESTS = Path(__file__).parents[1]
TOY = {
    "FARFIELD_PIPELINE": "toy_pipeline:PIPELINE", "PYTHONPATH": str(TESTS),
    "FARFIELD_INSPECT": f"{sys.executable} {TESTS / 'toy_inspect.py'}",
}  # fmt: skip


@pytest.fixture
def accept(request):
    if not request.config.getoption("--accept"):
        pytest.skip("takes a minute or more: --accept")


@pytest.fixture
def fleet(request, tmp_path, postgres, broker, s3_server):  # noqa: F811
    bucket = f"s3://farfield-{secrets.token_hex(6)}/blobs"
    environment = {**s3_server, "FARFIELD_STOP_S": "3", **getattr(request, "param", {})}
    fleet = Fleet(tmp_path, database=postgres.new(), broker=broker, bucket=bucket, environment=environment)
    fleet.migrate()
    yield fleet
    fleet.stop()


def _start(fleet):
    client = fleet.serve(free_port())
    fleet.start("reconciler", "farfield_workers.reconciler", host="reconciler")
    fleet.start("worker", "farfield_workers", "cpu", host="one")
    fleet.start("baker", "farfield_workers", "gl,optimizer", host="two")
    return client


def _nothing_stays_but_copies(fleet):
    """What a host loses is read again from the bucket; what a process logs tells no secret."""
    for host in ("one", "two", "api", "reconciler"):
        kept = [p for p in (fleet.folder / host).rglob("*") if p.is_file() and os.path.getsize(p)]
        assert all(len(p.name) == 64 for p in kept), kept
    hidden = [fleet.key, fleet.environment["FARFIELD_SECRET"], fleet.environment["AWS_SECRET_ACCESS_KEY"]]
    for name in fleet.processes:
        assert not any(secret in fleet.log(name) for secret in hidden)


@pytest.mark.parametrize("fleet", [TOY], indirect=True, ids=["toy"])
def test_processes_that_share_only_urls_make_the_bytes_of_one(fleet, tmp_path):
    wish = {"skip": False, "shards": 7}
    expected = calm_files(tmp_path / "calm", wish)
    scene = tmp_path / "toy.glb"
    scene.write_text(json.dumps(wish))
    with closing(_start(fleet)) as client:
        job = fleet.submit(scene)
        state = fleet.wait(client, job)
        assert (state["state"], state["verdict"]) == ("done", "valid"), state
        for name, content in expected.items():
            path = f"/v1/placements/{job}/{name.removeprefix('placement/')}"
            assert client.get(path).content == content
            part = client.get(path, headers={"range": "bytes=1-2"})
            assert (part.status_code, part.content) == (206, content[1:3])
        assert client.get("/readyz").json()["status"] == "ready"
    fleet.stop()
    _nothing_stays_but_copies(fleet)


def test_a_job_of_a_fleet_has_the_bytes_of_a_laptops(accept, request, fleet, tmp_path):
    placed, (scene, settings) = request.getfixturevalue("placed"), request.getfixturevalue("level")
    files_of = request.getfixturevalue("files_of")
    with closing(_start(fleet)) as client:
        job = fleet.submit(scene, "--settings", str(settings))
        state = fleet.wait(client, job, 400)
        assert state["state"] == "done", state
        fleet.fetch(job, tmp_path / "fetched")
    assert files_of(tmp_path / "fetched" / "placement") == files_of(placed[0] / "placement")
    assert (tmp_path / "fetched" / "scene.glb").read_bytes() == (placed[0] / "scene.glb").read_bytes()
    fleet.stop()
    _nothing_stays_but_copies(fleet)


def test_a_host_that_is_cut_off_loses_nothing_and_rejoins(accept):
    """Three hosts as network namespaces; the link of one goes down while it works."""
    probe = subprocess.run(["ip", "netns", "add", "farfield-probe"], capture_output=True, text=True)
    if probe.returncode != 0:
        pytest.skip(f"no network namespaces here: {probe.stderr.strip()}")
    subprocess.run(["ip", "netns", "del", "farfield-probe"], check=True)
    done = subprocess.run([sys.executable, str(TESTS / "hosts.py")], capture_output=True, text=True, timeout=500)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
