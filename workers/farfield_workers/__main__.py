"""`python -m farfield_workers [QUEUE,QUEUE...]`: one worker slot, as an orchestrator starts it.

Problem  Celery's own SIGTERM waits for the running shard, which may take an hour; killed instead, its lease lapses after a
         minute, and the attempt counts: three rolling restarts would fail a job.
Method   This process computes nothing. It starts the worker and passes SIGTERM on: a short shard ends, no other is taken. What
         still runs after FARFIELD_STOP_S is killed, and then handed back: ready at once, the attempt not counted. That is
         safe because the worker is dead by then, and works even where native code holds its interpreter.
Crash    A worker that ends by itself has its leases released, that attempt counted, and its exit code is ours: the
         orchestrator starts us again.
"""

import logging
import os
import secrets
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence

import sqlalchemy as sa
from farfield import logs
from farfield.executor import THREADS
from farfield.store import progress, workers
from farfield.store.engine import open_engine

from farfield_workers.children import die_with_parent

log = logging.getLogger(__name__)

QUEUES = "cpu,optimizer,gl"
STOP_S = 8.0
KILLED_S = 5.0


def worker_command(queues: str, *, name: str = "worker") -> list[str]:
    """Return the command of one worker: `-P solo`, because a baker's OpenGL context must not exist in a parent."""
    return [
        sys.executable, "-W", "ignore:You're running the worker", "-m", "celery", "-q", "-A", "farfield_workers.app",
        "worker", "-P", "solo", "-Q", queues,
        "-n", f"{name}@%h", "--without-gossip", "--without-mingle", "--without-heartbeat",
    ]  # fmt: skip


def new_name(slot: str = "") -> str:
    """Return a name for a worker that no other has, or will have."""
    return f"{socket.gethostname()[:60]}:{slot or os.getpid()}:{secrets.token_hex(4)}"


def supervise(
    command: Sequence[str], environment: Mapping[str, str], *, stop: threading.Event, stop_s: float,
    handed_back: Callable[[], object], released: Callable[[], object],
) -> int:  # fmt: skip
    """Run the worker until it ends or `stop` is set; return the exit code.

    handed_back  called once a worker that was asked to stop is dead
    released     called once a worker has died by itself
    """
    child = subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL, start_new_session=True,
                             preexec_fn=die_with_parent)  # fmt: skip
    while child.poll() is None and not stop.wait(0.1):
        pass
    if child.poll() is None:
        child.terminate()
        try:
            child.wait(stop_s)
        except subprocess.TimeoutExpired:
            log.info("the running shard takes longer: it is handed back")
            child.kill()
            child.wait()
    if stop.is_set():
        handed_back()
        return 0
    log.warning("the worker ended with status %d", child.returncode)
    released()
    return child.returncode if child.returncode > 0 else 1


def main() -> int:
    logs.configure("supervisor")
    queues = sys.argv[1] if len(sys.argv) > 1 else os.environ.get("FARFIELD_QUEUES", QUEUES)
    name = os.environ.get("FARFIELD_WORKER", new_name())
    environment = {**THREADS, **os.environ, "FARFIELD_WORKER": name}
    engine = open_engine(environment["FARFIELD_DATABASE_URL"])
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())

    def tell(act: Callable[[sa.Engine, str], object]) -> None:
        for _ in range(int(KILLED_S)):
            try:
                act(engine, name)
                workers.end(engine, name)
                return
            except sa.exc.SQLAlchemyError:
                log.warning("the database does not answer", exc_info=True)
                time.sleep(1.0)
        log.error("what ran here is taken over when its lease runs out")

    return supervise(
        worker_command(queues), environment, stop=stop, stop_s=float(environment.get("FARFIELD_STOP_S", STOP_S)),
        handed_back=lambda: tell(progress.hand_back), released=lambda: tell(progress.release_worker),
    )  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
