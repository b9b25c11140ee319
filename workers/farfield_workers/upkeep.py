"""What the reconciler does on the side, at a low rate: collect unused artifacts, delete what is past its time, count itself.

In a thread of its own: a listing of a large bucket must not hold up the sending of messages. Any number of reconcilers may
do it at once; every step is safe to repeat, and to leave in the middle.
"""

import logging
import os
import shutil
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import sqlalchemy as sa
from farfield.errors import FarfieldError
from farfield.store import collect, retention, workers
from farfield.store.artifacts import Artifacts
from farfield.store.counters import Counts
from farfield.store.retention import DAY_S, Retention

log = logging.getLogger(__name__)

FLUSH_S = 10.0
SWEPT = 2000  # artifacts a round
LEFTOVER_S = 2 * DAY_S  # age at which a temporary file has no owner any more


@dataclass(frozen=True, slots=True, kw_only=True)
class UpkeepSettings:
    """How often, and for how long things are kept."""

    collect_every_s: float = 600.0  # 0: never
    grace_s: float = collect.GRACE_S
    keep: Retention = field(default_factory=Retention)


def from_environment(environment: Mapping[str, str] = os.environ) -> UpkeepSettings:
    """Return the settings that the variables FARFIELD_* give."""

    def number(name: str, default: float) -> float:
        return float(environment.get(f"FARFIELD_{name}") or default)

    return UpkeepSettings(
        collect_every_s=number("COLLECT_EVERY_S", 600.0),
        grace_s=number("COLLECT_GRACE_S", collect.GRACE_S),
        keep=Retention(
            jobs_days=number("KEEP_JOBS_DAYS", 0), events_days=number("KEEP_EVENTS_DAYS", 0),
            scenes_days=number("KEEP_SCENES_DAYS", 0),
        ),
    )  # fmt: skip


class Upkeep:
    """Of one reconciler."""

    def __init__(self, engine: sa.Engine, artifacts: Artifacts, settings: UpkeepSettings) -> None:
        self.engine, self.artifacts, self.settings = engine, artifacts, settings
        self.counts = Counts()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._keep, name="upkeep", daemon=True)
        self._due: dict[str, float] = {}

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End soon; what was counted is told."""
        self._stop.set()
        self._thread.join(5.0)
        self._try(lambda: self.counts.flush(self.engine))

    def round(self, sent: int) -> None:
        """Count a round of the reconciler, and the messages that it sent."""
        self.counts.add("reconciler_rounds")
        self.counts.add("resent_messages", float(sent))

    def tidy(self) -> None:
        """Do what is due."""
        every = self.settings.collect_every_s
        if self._is_due("list", DAY_S if every else 0.0):
            adopted = collect.adopt(self.engine, self.artifacts)
            self.artifacts.drop_old_checkpoints()
            drop_leftovers(self.artifacts.temporary)
            log.info("listed the store", extra={"fields": {"without_a_row": adopted}})
        if self._is_due("expire", every):
            for what, number in retention.expire(self.engine, self.settings.keep).items():
                if number:
                    self.counts.add("expired", float(number), what=what)
                    log.info("deleted what is past its time", extra={"fields": {"what": what, "number": number}})
        if self._is_due("collect", every):
            collect.mark(self.engine)
            found = collect.sweep(self.engine, self.artifacts, grace_s=self.settings.grace_s, limit=SWEPT)
            self.counts.add("collected_artifacts", float(found.removed))
            self.counts.add("collected_bytes", float(found.removed_bytes))
            if found.removed:
                fields = {"artifacts": found.removed, "bytes": found.removed_bytes}
                log.info("removed unused artifacts", extra={"fields": fields})
            workers.forget(self.engine)

    def _keep(self) -> None:
        while not self._stop.wait(FLUSH_S):
            self._try(lambda: self.counts.flush(self.engine))
            self._try(self.tidy)

    def _try(self, act: Callable[[], object]) -> None:
        try:
            act()
        except (sa.exc.SQLAlchemyError, OSError, FarfieldError):
            log.warning("the upkeep is put off", exc_info=True)

    def _is_due(self, what: str, every_s: float) -> bool:
        clock = time.monotonic()
        if not every_s or clock < self._due.get(what, 0.0):
            return False
        self._due[what] = clock + every_s
        return True


def drop_leftovers(folder: Path, seconds: float = LEFTOVER_S) -> int:
    """Remove what processes that were killed left in a folder for temporary files; return how many.

    Hidden files stay: the lock of a living process (`s3`), without which nobody could clear up after it.
    """
    number = 0
    for path in folder.glob("[!.]*"):
        try:
            if time.time() - path.lstat().st_mtime < seconds:
                continue
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
            number += 1
        except FileNotFoundError:
            continue
    return number
