"""What may go wrong with a service, each as a function of the cluster and a random generator."""

import os
import random
import signal
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress

import sqlalchemy as sa
from chaos.cluster import LEASE_S, Cluster
from farfield.stages import RUN_SHARD, Stage
from farfield.store.engine import read, write
from farfield.store.tables import job, shard, stage

Fault = Callable[[Cluster, random.Random], None]


def _signal(cluster: Cluster, name: str, number: int) -> bool:
    pid = cluster.pid(name)
    if pid is not None:
        os.kill(pid, number)
    return pid is not None


def _worker(cluster: Cluster, rng: random.Random) -> str:
    return rng.choice([name for name in cluster.children if name.startswith("worker")])


def kill_worker(cluster: Cluster, rng: random.Random) -> None:
    _signal(cluster, _worker(cluster, rng), signal.SIGKILL)


def kill_who_computes(cluster: Cluster, rng: random.Random) -> None:
    """Kill the worker of a shard that is running: the optimiser, the baker, whoever it is."""
    with read(cluster.engine) as tx:
        names = list(tx.scalars(sa.select(shard.c.worker).where(shard.c.state == "running")))
    if names:
        _signal(cluster, rng.choice(names).split(":")[0], signal.SIGKILL)


def stop_worker(cluster: Cluster, rng: random.Random) -> None:
    """Stop a worker until its lease has lapsed and another has taken over, or not quite so long."""
    name = _worker(cluster, rng)
    pid, pause_s = cluster.pid(name), rng.choice([0.5, LEASE_S * 1.2])
    if pid is not None:
        os.kill(pid, signal.SIGSTOP)
        time.sleep(pause_s)
        if cluster.pid(name) == pid:
            os.kill(pid, signal.SIGCONT)


def kill_api(cluster: Cluster, rng: random.Random) -> None:
    _signal(cluster, "api", signal.SIGKILL)


def kill_reconciler(cluster: Cluster, rng: random.Random) -> None:
    _signal(cluster, "reconciler", signal.SIGKILL)


def kill_broker(cluster: Cluster, rng: random.Random) -> None:
    _signal(cluster, "broker", signal.SIGKILL)


def flush_broker(cluster: Cluster, rng: random.Random) -> None:
    with socket.socket(socket.AF_UNIX) as connection:
        try:
            connection.connect(str(cluster.broker_path))
            connection.sendall(b"FLUSHALL\r\n")
            connection.recv(16)
        except OSError:  # it is dead already
            return


def doubled_messages(cluster: Cluster, rng: random.Random) -> None:
    """Send messages that nobody asked for, some of them late, for shards that are long done or were never there."""
    from celery import Celery

    app = Celery(broker=cluster.environment["FARFIELD_BROKER_URL"], broker_connection_timeout=1)
    with read(cluster.engine) as tx:
        ids = list(tx.scalars(sa.select(shard.c.id).limit(50)))

    def send() -> None:
        try:
            for _ in range(20):
                queue = rng.choice(["cpu", "optimizer", "gl"])
                app.send_task(RUN_SHARD, args=[rng.choice([*ids, "0" * 32])], queue=queue, retry=False)
            app.close()
        except Exception:  # the broker is dead
            return

    send()
    threading.Timer(rng.uniform(0.5, 3.0), send).start()


def damage_artifact(cluster: Cluster, rng: random.Random) -> None:
    """Flip a byte of an artifact that later stages read, in place; or lose it."""
    with read(cluster.engine) as tx:
        rows = tx.execute(
            sa.select(stage.c.artifact_digest).join(job, job.c.id == stage.c.job_id)
            .where(stage.c.artifact_digest.is_not(None), job.c.finished_at.is_(None), stage.c.name != Stage.PLACEMENTDB)
        ).scalars().all()  # fmt: skip
    if not rows:
        return
    digest = rng.choice(rows)
    path = cluster.artifacts / digest[:2] / digest
    try:
        if rng.random() < 0.3:
            path.unlink()
            return
        with path.open("r+b") as file:
            at = rng.randrange(max(1, path.stat().st_size))
            file.seek(at)
            byte = file.read(1)
            file.seek(at)
            file.write(bytes([byte[0] ^ 0x40]) if byte else b"?")
    except FileNotFoundError:
        return


def fill_disk(cluster: Cluster, rng: random.Random) -> None:
    """Leave the store without a free byte for a while."""
    if not cluster.small_disk:
        return
    filler = cluster.artifacts / "filler"
    try:
        with filler.open("wb", buffering=0) as file:
            for block in (1 << 20, 4096):
                with suppress(OSError):
                    while file.write(bytes(block)) == block:
                        pass
        time.sleep(rng.uniform(0.5, 2.5))
    finally:
        filler.unlink(missing_ok=True)


def drop_database(cluster: Cluster, rng: random.Random) -> None:
    """End every connection to the database; SQLite, which has none, is locked for a while instead."""
    if cluster.engine.dialect.name == "postgresql":
        with cluster.engine.connect() as connection:
            others = "pid <> pg_backend_pid() AND datname = current_database()"
            ended = f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE {others}"
            connection.execute(sa.text(ended))
        return
    with write(cluster.engine):
        time.sleep(rng.uniform(0.5, 3.0))


def clock_jumps(cluster: Cluster, rng: random.Random) -> None:
    """Shift all that the tables hold of the running jobs' times: the same as a jump of the database's clock."""
    jump_s = rng.choice([-1.0, 1.0]) * rng.choice([3.0, 60.0, 7200.0])
    with write(cluster.engine) as tx:
        moved = {name: shard.c[name] - jump_s for name in ("lease_until", "ready_at")}
        tx.execute(sa.update(shard).values(**moved))
        tx.execute(sa.update(job).values(optimizer_until=job.c.optimizer_until - jump_s))


FAULTS: dict[str, Fault] = {
    fault.__name__: fault
    for fault in (
        kill_worker, kill_who_computes, stop_worker, kill_api, kill_reconciler, kill_broker, flush_broker,
        doubled_messages, damage_artifact, fill_disk, drop_database, clock_jumps,
    )
}  # fmt: skip
COSTLY = {"kill_worker", "kill_who_computes", "stop_worker", "clock_jumps"}  # that a shard survives twice, not thrice
