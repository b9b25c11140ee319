"""What a worker tells of itself: its row in the table of workers, its counts, and the context of its logs.

A thread writes both every few seconds, in two short transactions. Nothing relies on them: leases decide who works. Where the
database does not answer, counts wait for the next time.
"""

import logging
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any

import sqlalchemy as sa
from farfield import logs
from farfield.store import workers
from farfield.store.counters import Counts, known_code
from farfield.store.shards import Claim
from farfield.store.workers import HEARTBEAT_S, Telling

log = logging.getLogger(__name__)

RECENT_S = 300.0


class Telemetry:
    """Of one worker process, which computes one shard at a time. `shard`, `done` and the like are called by who computes."""

    def __init__(self) -> None:
        self.counts = Counts()
        self._guard = threading.Lock()
        self._ended: deque[float] = deque()
        self._held: tuple[Claim, float] | None = None
        self._told: Telling | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @contextmanager
    def shard(self, held: Claim) -> Iterator[None]:
        """Say that this shard is computed within."""
        about: dict[str, Any] = {
            "job": held.job_id, "stage": held.stage, "kind": held.kind, "shard": held.ordinal, "attempt": held.attempt,
            "tenant": held.tenant_id,
        }  # fmt: skip
        with self._guard:
            self._held = held, time.monotonic()
        try:
            with logs.about(**about):
                yield
        finally:
            with self._guard:
                if self._told is not None and self._held is not None:
                    self._told.busy_seconds += time.monotonic() - self._held[1]
                self._held = None

    def done(self, held: Claim, *, seconds: float, n_bytes: int, cached: bool) -> None:
        """Count and log a shard whose result is committed."""
        self.counts.add("shards", stage=held.stage, outcome="cached" if cached else "computed")
        if not cached:
            self.counts.observe("shard_seconds", seconds, stage=held.stage)
            self.counts.add("stored_bytes", float(n_bytes), stage=held.stage)
        with self._guard:
            self._ended.append(time.monotonic())
            if self._told is not None:
                self._told.done += 1
        log.info("done", extra={"fields": {"seconds": round(seconds, 3), "cached": cached, "bytes": n_bytes}})

    def failed(self, held: Claim, *, code: str, again: bool) -> None:
        """Count an attempt that failed."""
        self.counts.add("shards", stage=held.stage, outcome="failed")
        self.counts.add("shard_failures", stage=held.stage, code=known_code(code))
        if again:
            self.counts.add("shard_retries", stage=held.stage)
        with self._guard:
            if self._told is not None:
                self._told.failed += 1

    def stopped(self, held: Claim) -> None:
        """Count a shard that is no longer ours: its job was cancelled, or another worker took it over."""
        log.info("stopped")
        self.counts.add("shards", stage=held.stage, outcome="stopped")

    def start(self, engine: sa.Engine, *, name: str, host: str, queues: tuple[str, ...]) -> None:
        """Tell now and then, from a thread, until `stop`."""
        self._told = Telling(name=name, host=host, queues=queues, capability=capability())
        self._stop.clear()
        self._thread = threading.Thread(target=self._keep, args=(engine,), name="telemetry", daemon=True)
        self._thread.start()

    def stop(self, engine: sa.Engine) -> None:
        """Tell that this worker ends."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(HEARTBEAT_S)
        self._tell(engine, stopped=True)

    def _keep(self, engine: sa.Engine) -> None:
        self._tell(engine)
        while not self._stop.wait(HEARTBEAT_S):
            self._tell(engine)

    def _tell(self, engine: sa.Engine, *, stopped: bool = False) -> None:
        with self._guard:
            told, held, clock = self._told, self._held, time.monotonic()
            if told is not None:
                while self._ended and self._ended[0] < clock - RECENT_S:
                    self._ended.popleft()
                told.recent, told.shard_id = len(self._ended), held[0].shard_id if held else None
                told.stage, told.shard_age_s = (held[0].stage, clock - held[1]) if held else (None, 0.0)
                told.capability = capability()
        try:
            if told is not None:
                workers.tell(engine, told, stopped=stopped)
            self.counts.flush(engine)
        except sa.exc.SQLAlchemyError:
            log.warning("the database does not answer; what was counted waits", exc_info=True)


def capability() -> dict[str, Any]:
    """Return what this worker can do: cores, memory, version, and the renderer once it is known."""
    pages, page_bytes = os.sysconf("SC_PHYS_PAGES"), os.sysconf("SC_PAGE_SIZE")
    return {
        "cores": len(os.sched_getaffinity(0)), "memory_bytes": pages * page_bytes, "version": version("farfield"),
        "renderer": _renderer(),
    }  # fmt: skip


def _renderer() -> str | None:
    """Return the renderer of the OpenGL context of this process. Makes none: most workers never need it."""
    module = sys.modules.get("farfield.bake.gl.context")
    return module.renderer() if module is not None else None


here = Telemetry()
