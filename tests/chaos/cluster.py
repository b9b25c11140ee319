"""A whole service as processes: API, reconciler, a worker a queue, broker, on SQLite or on PostgreSQL with Redis over TCP.

A thread looks after them as the launcher does: what ends is started again, and the leases of a dead worker are released.
"""

import os
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx
import psutil
import sqlalchemy as sa
from farfield.executor import THREADS
from farfield.store import progress, tenants
from farfield.store.engine import open_engine
from farfield_workers.__main__ import worker_command
from farfield_workers.broker import broker_command, wait_for_broker
from farfield_workers.children import Child, stop_children
from farfield_workers.serve import migrate
from servers import MIGRATIONS, run_postgres

LEASE_S = 4.0
QUEUES = ("cpu,optimizer,gl", "cpu,gl,optimizer")
STORE_BYTES = 256 << 20


class Cluster:
    """A running service under `folder`; `children` by name: broker, api, reconciler, worker-0, worker-1."""

    def __init__(
        self, folder: Path, database_url: str, artifacts: Path, *, lease_s: float, workers: int, more: dict[str, str]
    ) -> None:  # fmt: skip
        self.folder, self.artifacts, self.database_url = folder, artifacts, database_url
        self.engine = open_engine(database_url)
        migrate(self.engine, MIGRATIONS)
        self.tenant_id = tenants.create_tenant(self.engine, "default")
        self.key = tenants.create_key(self.engine, self.tenant_id, "chaos", ("read", "submit", "admin"))
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.listening.set_inheritable(True)
        command, self.broker_path = broker_command(folder)
        self.environment = {
            **THREADS, "FARFIELD_DATABASE_URL": database_url, "FARFIELD_BROKER_URL": f"redis+socket://{self.broker_path}",
            "FARFIELD_ARTIFACTS": str(artifacts), "FARFIELD_SECRET": secrets.token_hex(16), "FARFIELD_LEASE_S": str(lease_s),
            "FARFIELD_RENEW_S": str(lease_s / 8), "FARFIELD_FD": str(self.listening.fileno()), "FARFIELD_PLACEMENTS": "{}",
            "FARFIELD_MEMORY_BYTES": "off", **more,
        }  # fmt: skip
        self.children: dict[str, Child] = {"broker": self._child("broker", command)}
        self.children["broker"].start()
        wait_for_broker(self.broker_path)
        python = sys.executable
        self._add("api", [python, "-m", "farfield_api"])
        self._add("reconciler", [python, "-m", "farfield_workers.reconciler"])
        for k in range(workers):
            self._add(f"worker-{k}", worker_command(QUEUES[k % 2], name=f"w{k}"), worker=True)
        self.client = httpx.Client(
            base_url=f"http://127.0.0.1:{self.listening.getsockname()[1]}", timeout=30,
            headers={"authorization": f"Bearer {self.key}"}, trust_env=False,
        )  # fmt: skip
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def _child(self, name: str, command: list[str], *, worker: bool = False) -> Child:
        def environment() -> dict[str, str]:
            return (
                {**self.environment, "FARFIELD_WORKER": f"{name}:{secrets.token_hex(4)}"}
                if worker
                else self.environment
            )

        def died(given: dict[str, str]) -> None:
            progress.release_worker(self.engine, given["FARFIELD_WORKER"])

        return Child(name=name, command=command, environment=environment, log=self.folder / f"{name}.log",
                     keep_open=(self.listening.fileno(),), **({"died": died} if worker else {}))  # fmt: skip

    def _add(self, name: str, command: list[str], *, worker: bool = False) -> None:
        self.children[name] = self._child(name, command, worker=worker)
        self.children[name].start()

    def _look(self) -> None:
        while not self._ended.wait(0.05):
            for child in self.children.values():
                try:
                    child.look()
                    child._pause_s = min(child._pause_s, 0.5)  # a test kills far more often than a machine does
                except sa.exc.DBAPIError:
                    continue

    def pid(self, name: str) -> int | None:
        """Return the process of a child, None while there is none."""
        process = self.children[name].process
        return process.pid if process is not None and process.poll() is None else None

    def ask(self, method: str, path: str, *, seconds: float = 60.0, **more: object) -> httpx.Response:
        """Ask the API until it answers without an error of its own: it may be dead, or its database away, just now."""
        end = time.monotonic() + seconds
        while True:
            try:
                answer = self.client.request(method, path, **more)
                if answer.status_code < 500 and answer.status_code != 429:
                    return answer
            except httpx.TransportError:
                pass
            assert time.monotonic() < end, f"{method} {path} was not answered"
            time.sleep(0.1)

    def story(self, lines: int = 40) -> str:
        """Return the ends of all logs, for a run that failed."""
        told = []
        for name, child in self.children.items():
            text = child.log.read_text(errors="replace").splitlines()[-lines:] if child.log.exists() else []
            told.append("\n".join([f"--- {name} ({'runs' if self.pid(name) else 'is dead'})", *text]))
        return "\n".join(told)

    def cpu_seconds(self) -> float:
        """Return the processor time of all processes that run, and of those that they have waited for."""
        total = 0.0
        for name in self.children:
            if (pid := self.pid(name)) is not None:
                total += sum(psutil.Process(pid).cpu_times()[:4])
        return total

    def stop(self) -> None:
        self._ended.set()
        self._thread.join()
        self.client.close()
        for child in self.children.values():
            if child.process is not None:
                child.process.kill()
        stop_children([c for n, c in self.children.items() if n != "broker"], seconds=5.0)
        stop_children([self.children["broker"]], seconds=2.0)
        self.engine.dispose()
        self.listening.close()


@contextmanager
def small_disk(folder: Path) -> Iterator[bool]:
    """Give `folder` a small disk of its own where we may; say whether it has one."""
    folder.mkdir(parents=True, exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={STORE_BYTES}", "tmpfs", str(folder)]
    mounted = os.geteuid() == 0 and subprocess.run(mount, capture_output=True).returncode == 0
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=True)


@contextmanager
def run_cluster(
    kind: str, *, lease_s: float = LEASE_S, workers: int = 2, small: bool = False, **more: str
) -> Iterator[Cluster]:
    """Run a service of `kind` "sqlite" or "postgresql"; skips where PostgreSQL is not installed.

    small  give its store a small disk of its own, if we may
    more   environment
    """
    with ExitStack() as stack:
        folder = Path(tempfile.mkdtemp(prefix="farfield-chaos-"))
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        if kind == "sqlite":
            url = f"sqlite:///{folder / 'farfield.sqlite'}"
        else:
            url = stack.enter_context(run_postgres()).new()
        store = folder / "store"
        store.mkdir()
        mounted = stack.enter_context(small_disk(store)) if small else False
        cluster = Cluster(folder, url, store, lease_s=lease_s, workers=workers, more=more)
        cluster.small_disk = mounted
        stack.callback(cluster.stop)
        yield cluster
