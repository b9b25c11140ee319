"""Several hosts on one machine: network namespaces, and a link that is cut while its host works. Needs CAP_NET_ADMIN.

hub   database, broker, bucket, API, reconciler     10.77.0.1
one   a worker                                      10.77.1.2
two   a worker, whose link goes down mid-shard      10.77.2.2

Checked: the job ends while `two` is away, about a lease after it was cut off, with the bytes of a calm run; when its link
is back, `two` commits nothing of what it was doing, and works on the next job.
"""

import json
import os
import secrets
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import sqlalchemy as sa
from farfield.store.engine import open_engine, read
from farfield.store.tables import shard
from fleet import Fleet, calm_files
from servers import free_port, run_broker, run_postgres, run_s3

TESTS = Path(__file__).parent
TAG = f"ff{os.getpid()}"
HUB = "10.77.0.1"
LEASE_S = 10.0


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True)


def make_hosts() -> None:
    """Make the namespaces, wired as above."""
    ip("netns", "add", f"{TAG}-hub")
    ip("-n", f"{TAG}-hub", "link", "set", "lo", "up")
    ip("-n", f"{TAG}-hub", "address", "add", f"{HUB}/32", "dev", "lo")
    for i, name in enumerate(("one", "two"), 1):
        host = f"{TAG}-{name}"
        ip("netns", "add", host)
        ip("-n", f"{TAG}-hub", "link", "add", name, "type", "veth", "peer", "name", "uplink", "netns", host)
        ip("-n", f"{TAG}-hub", "address", "add", f"10.77.{i}.1/24", "dev", name)
        ip("-n", host, "address", "add", f"10.77.{i}.2/24", "dev", "uplink")
        for where, link in ((f"{TAG}-hub", name), (host, "uplink"), (host, "lo")):
            ip("-n", where, "link", "set", link, "up")
        ip("-n", host, "route", "add", "default", "via", f"10.77.{i}.1")


def remove_hosts(tag: str) -> None:
    for name in ("hub", "one", "two"):
        subprocess.run(["ip", "netns", "del", f"{tag}-{name}"], check=False, stderr=subprocess.DEVNULL)


def scenario(tag: str) -> None:
    """What happens within the hub."""
    folder = Path(tempfile.mkdtemp(prefix="farfield-hosts-"))
    with run_postgres(f"127.0.0.1,{HUB}", "10.77.0.0/16") as server, run_broker(HUB) as broker, run_s3(HUB) as s3:
        created = server.new()
        url = server.url(str(sa.make_url(created).database), host=HUB)
        environment = {
            **s3, "FARFIELD_PIPELINE": "toy_pipeline:PIPELINE", "PYTHONPATH": str(TESTS), "FARFIELD_STOP_S": "2",
            "FARFIELD_INSPECT": f"{sys.executable} {TESTS / 'toy_inspect.py'}",
            "FARFIELD_LEASE_S": str(LEASE_S), "FARFIELD_RENEW_S": "1",
        }  # fmt: skip
        bucket = f"s3://farfield-{secrets.token_hex(4)}/blobs"
        fleet = Fleet(folder, database=url, broker=broker, bucket=bucket, environment=environment)
        try:
            fleet.migrate()
            _run(fleet, tag, folder)
        except BaseException:
            for name in fleet.processes:
                print(f"== {name}\n{fleet.log(name)[-3000:]}")
            raise
        finally:
            fleet.stop()


def _run(fleet: Fleet, tag: str, folder: Path) -> None:
    client = fleet.serve(free_port(HUB), HUB)
    fleet.start("reconciler", "farfield_workers.reconciler", host="hub")
    for name in ("one", "two"):
        before = ("ip", "netns", "exec", f"{tag}-{name}")
        fleet.start(name, "farfield_workers", "cpu,optimizer,gl", host=name, before=before, FARFIELD_WORKER=name)
    engine = open_engine(fleet.environment["FARFIELD_DATABASE_URL"])

    def held_by(worker: str, job: str, state: str = "running") -> list[str]:
        with read(engine) as tx:
            query = sa.select(shard.c.id).where(shard.c.worker == worker, shard.c.job_id == job, shard.c.state == state)
            return list(tx.scalars(query))

    def wait_for(what: str, seconds: float, found) -> float:  # type: ignore[no-untyped-def]
        started = time.monotonic()
        while not found():
            assert time.monotonic() - started < seconds, what
            time.sleep(0.05)
        return time.monotonic() - started

    scene, wish = folder / "toy.glb", {"skip": False, "shards": 6, "seconds": 2.0}
    scene.write_text(json.dumps(wish))
    warm = fleet.submit(_scene(folder, {"skip": False, "shards": 6, "seconds": 0.3}))  # both have started
    fleet.wait(client, warm)
    job = fleet.submit(scene)

    def sleeps() -> bool:
        with read(engine) as tx:
            at = sa.select(shard.c.id).where(
                shard.c.worker == "two", shard.c.job_id == job, shard.c.state == "running", shard.c.params.is_not(None),
                shard.c.queue == "cpu", shard.c.kind == "run", shard.c.ordinal > 0,
            )  # fmt: skip
            return tx.scalar(at) is not None

    wait_for("host two works on a shard", 120, sleeps)
    ip("-n", f"{tag}-hub", "link", "set", "two", "down")
    cut = time.monotonic()
    held = held_by("two", job)
    assert held, "it was cut off a moment too late"
    taken_s = wait_for("a shard of the host that is away is taken over", 60, lambda: not held_by("two", job))
    state = fleet.wait(client, job)
    ended_s = time.monotonic() - cut
    assert (state["state"], state["verdict"]) == ("done", "valid"), state
    with read(engine) as tx:
        attempts = sorted(tx.scalars(sa.select(shard.c.attempt).where(shard.c.job_id == job)))
    assert attempts[-1] == 2, attempts
    assert sum(a == 2 for a in attempts) == len(held)
    ip("-n", f"{tag}-hub", "link", "set", "two", "up")
    back = time.monotonic()
    # The next jobs go on until the host has done a share of one.
    rejoined_s, number = 0.0, 0
    while not rejoined_s:
        number += 1
        assert time.monotonic() - back < 240, "host two does not come back"
        following = fleet.submit(_scene(folder, {"skip": False, "shards": 6, "seconds": 0.5, "job": number}))
        assert fleet.wait(client, following)["state"] == "done"
        if held_by("two", following, "done"):
            rejoined_s = time.monotonic() - back
    with read(engine) as tx:
        assert sorted(tx.scalars(sa.select(shard.c.attempt).where(shard.c.job_id == job))) == attempts
    expected = calm_files(folder / "calm", wish)
    for name, content in expected.items():
        assert client.get(f"/v1/placements/{job}/{name.removeprefix('placement/')}").content == content, name
    told = {"lease_s": LEASE_S, "taken_over_s": round(taken_s, 1), "job_ended_after_cut_s": round(ended_s, 1),
            "attempts_lost": len(held), "worked_again_after_s": round(rejoined_s, 1)}  # fmt: skip
    print(json.dumps(told))
    client.close()
    engine.dispose()


def _scene(folder: Path, wish: dict[str, object]) -> Path:
    path = folder / f"toy-{secrets.token_hex(3)}.glb"
    path.write_text(json.dumps(wish))
    return path


def main() -> int:
    if len(sys.argv) > 1:
        scenario(sys.argv[1])
        return 0
    try:
        make_hosts()
        inside = ["ip", "netns", "exec", f"{TAG}-hub", sys.executable, __file__, TAG]
        return subprocess.run(inside, env={**os.environ, "PYTHONPATH": str(TESTS)}, check=False).returncode
    finally:
        remove_hosts(TAG)


if __name__ == "__main__":
    sys.exit(main())
