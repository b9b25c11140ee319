"""Holding a shard: its lease is renewed from a thread, and what holds it is stopped once the lease is lost.

The checkpoint of a long shard goes the same way: the stage writes it beside its result, where nobody else looks, and the
thread hands it over after each renewal. So who was taken over while it slept (a stopped process, a machine that was
cut off) finds its renewal refused, and writes nothing that others read.
"""

import ctypes
import logging
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

import sqlalchemy as sa
from farfield.store import groups
from farfield.store.shards import Claim

from farfield_workers.settings import WorkerSettings

log = logging.getLogger(__name__)

UNREACHABLE = (sa.exc.OperationalError, sa.exc.InterfaceError)
PATIENCE_S = 120.0
LONGEST_PAUSE_S = 5.0

T = TypeVar("T")


class ShardStopped(BaseException):
    """The shard is no longer ours: its job was cancelled, or another worker took it over."""


def patiently(ask: Callable[[], T], *, seconds: float = PATIENCE_S) -> T:
    """Return what `ask` returns, asked again for so long while the database does not answer.

    For what may be done twice: where an answer is lost, the transaction may have been committed.
    """
    end, pause_s = time.monotonic() + seconds, 0.1
    while True:
        try:
            return ask()
        except UNREACHABLE:
            if time.monotonic() > end:
                raise
            log.warning("the database does not answer; asked again in %.1f s", pause_s, exc_info=True)
        time.sleep(pause_s)
        pause_s = min(2 * pause_s, LONGEST_PAUSE_S)


@contextmanager
def leased(
    engine: sa.Engine, group: Sequence[Claim], settings: WorkerSettings, *, renewed: Callable[[], object] = bool
) -> Iterator[None]:
    """Renew the leases from a thread, and call `renewed` after each time; raise ShardStopped in the caller's thread once
    one of them is lost."""
    caller, ended, guard = threading.get_ident(), threading.Event(), threading.Lock()

    def keep() -> None:
        while not ended.wait(settings.renew_s):
            try:
                kept = groups.renew(engine, group, lease_s=settings.lease_s)
            except UNREACHABLE:
                log.warning("the lease of shard %s could not be renewed", group[0].shard_id, exc_info=True)
                continue
            if kept:
                renewed()
                continue
            with guard:
                if not ended.is_set():
                    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(caller), ctypes.py_object(ShardStopped))
            return

    thread = threading.Thread(target=keep, name="lease", daemon=True)
    thread.start()
    try:
        yield
    except Exception:  # it may run again: what there is of it is handed over, too
        with suppress(*UNREACHABLE):
            if groups.renew(engine, group, lease_s=settings.lease_s):
                renewed()
        raise
    finally:
        with guard:
            ended.set()
        thread.join()


class HandedOver:
    """The checkpoint of a shard: `mine`, which the stage writes, and `shared`, which the next attempt finds."""

    def __init__(self, mine: Path) -> None:
        self.mine, self.shared, self._seen = mine, Path(), -1

    def begin(self, shared: Path) -> None:
        """Start from what an earlier attempt left."""
        self.shared = shared
        with suppress(FileNotFoundError):
            shutil.copyfile(shared, self.mine)

    def give(self) -> None:
        """Hand over what is new. A full disk costs the checkpoint, not the shard."""
        with suppress(OSError):
            stamp = self.mine.stat().st_mtime_ns
            if self.shared != Path() and stamp != self._seen:
                temporary = self.shared.with_name(f"{self.shared.name}.{os.getpid()}.part")
                shutil.copyfile(self.mine, temporary)
                temporary.replace(self.shared)
                self._seen = stamp
