"""Whether this process can do its work, told truly and soon.

Hard     database (reads and writes), migrations (at the newest version that this code knows, or beyond), artifact store:
         without one of them no request can be answered as it should be, and the answer is 503.
Soft     broker, and a worker that lives for every queue. Without them jobs are accepted and wait, and all else is
         served: taking every API process out of its load balancer would make an outage of a delay. The status is then
         `degraded`, with 200; `?strict=true` asks for 503.
Bounded  All checks run at once, in threads, and what has not answered after TIMEOUT_S has failed. A check that hangs is
         not started a second time. The answer is kept for a second: it needs no key, and writes to the database.
Says     which check failed, and nothing about where things are.
"""

import logging
import os
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from alembic.config import Config
from alembic.script import ScriptDirectory
from farfield.store import counters, workers
from farfield.store.artifacts import Artifacts
from farfield.store.engine import read, write

log = logging.getLogger(__name__)

TIMEOUT_S = 2.0
KEPT_S = 1.0
HARD = ("database", "migrations", "store")
SOFT = ("broker", "workers")


class NotReady(Exception):
    """A check failed; its words may be read by anybody."""


@dataclass(frozen=True, slots=True)
class Answer:
    status: str  # ready, degraded, not ready
    checks: Mapping[str, str]  # "ok", or what is wrong


class Readiness:
    """The checks of one process. `broker` raises where the broker does not answer."""

    def __init__(self, engine: sa.Engine, artifacts: Artifacts, broker: Callable[[], object], migrations: Path) -> None:
        self.engine, self.artifacts, self.broker = engine, artifacts, broker
        self.revisions = _revisions(migrations)
        self._pool = ThreadPoolExecutor(len(HARD) + len(SOFT), thread_name_prefix="ready")
        self._running: dict[str, Future[None]] = {}
        self._guard = threading.Lock()
        self._kept: tuple[float, Answer] | None = None

    def ask(self) -> Answer:
        """Return how it stands, at most TIMEOUT_S after being asked."""
        with self._guard:  # who asks meanwhile gets the same answer
            if self._kept is not None and time.monotonic() < self._kept[0] + KEPT_S:
                return self._kept[1]
            answer = self._look()
            self._kept = time.monotonic(), answer
            return answer

    def close(self) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _look(self) -> Answer:
        for name in HARD + SOFT:
            if name not in self._running:
                self._running[name] = self._pool.submit(getattr(self, f"_{name}"))
        wait(self._running.values(), TIMEOUT_S)
        checks = {name: self._said(name) for name in HARD + SOFT}
        bad = [name for name, text in checks.items() if text != "ok"]
        status = "not ready" if set(bad) & set(HARD) else "degraded" if bad else "ready"
        return Answer(status, checks)

    def _said(self, name: str) -> str:
        future = self._running[name]
        if not future.done():
            return f"did not answer within {TIMEOUT_S:g} s"
        del self._running[name]
        error = future.exception()
        if error is None:
            return "ok"
        if isinstance(error, NotReady):
            return str(error)
        log.warning("the check of the %s failed", name, exc_info=error)
        return "failed"

    def _database(self) -> None:
        with write(self.engine) as tx:
            # A row is written and committed: a full disk, or a replica that only reads, shows nowhere else.
            counters.add(tx, {("probe", ""): 1.0})

    def _migrations(self) -> None:
        if not self.revisions:
            raise NotReady("this process does not know the migrations")
        with read(self.engine) as tx:
            at = tx.scalar(sa.text("SELECT version_num FROM alembic_version"))
        if at is None or at in self.revisions[1:]:
            raise NotReady("the database is older than this code: migrate it")

    def _store(self) -> None:
        self.artifacts.check()
        with tempfile.TemporaryFile(dir=self.artifacts.temporary) as file:
            file.write(bytes(4096))
            file.flush()
            os.fsync(file.fileno())

    def _broker(self) -> None:
        try:
            self.broker()
        except Exception as error:
            raise NotReady("does not answer; jobs wait until it does") from error

    def _workers(self) -> None:
        idle = [queue for queue, number in workers.served_queues(self.engine).items() if not number]
        if idle:
            raise NotReady(f"nobody works on: {', '.join(idle)}")


def shown(answer: Answer) -> dict[str, Any]:
    """Return the answer as clients see it."""
    return {"status": answer.status, "checks": dict(answer.checks)}


def _revisions(folder: Path) -> tuple[str, ...]:
    """Return the revisions that this code knows, the newest first; a database at another one is newer than we are."""
    if not (folder / "alembic.ini").is_file():
        return ()
    script = ScriptDirectory.from_config(Config(str(folder / "alembic.ini")))
    return tuple(revision.revision for revision in script.walk_revisions())
