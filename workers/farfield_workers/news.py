"""What a long shard says of itself while it runs, as events of its job.

Problem  A stage may tell how far it is many times a second. Each event is a row that is kept, and a transaction that takes
         the job's lock; telling must never hold up the work, nor fail it.
Method   The stage leaves its newest word, a thread writes it: a second after the last one, later a fiftieth of the time
         that the shard has run, so that an hour has under 300 events. A word that nobody wrote in time is replaced. Of
         "tiles", counts by place, only those are written that differ from the last event; the first of an attempt is
         complete, what it leaves out being 0.
"""

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import sqlalchemy as sa
from farfield.store.news import tell
from farfield.store.shards import Claim

from farfield_workers.lease import UNREACHABLE

log = logging.getLogger(__name__)

LEAST_S = 1.0
SHARE = 0.02  # of the time that the shard has run


class News:
    """`tell` is called by the stage; `write` by the thread, and once more at the end."""

    def __init__(self, engine: sa.Engine, held: Claim) -> None:
        self._engine, self._held, self._started = engine, held, time.monotonic()
        self._guard, self._ended = threading.Lock(), threading.Event()
        self._thread: threading.Thread | None = None
        self._map: dict[str, Any] | None = None
        self._newest: dict[str, Any] | None = None
        self._tiles: list[int] | None = None

    def tell(self, fact: dict[str, Any]) -> None:
        """Leave word. The first one starts the thread: most shards say nothing."""
        with self._guard:
            if "map" in fact:
                self._map = fact
            else:
                # A word without tiles leaves those of the word before it standing.
                tiles = {key: self._newest[key] for key in ("tiles",) if self._newest and key in self._newest}
                self._newest = {**tiles, **fact}
        if self._thread is None:
            self._thread = threading.Thread(target=self._keep, name="news", daemon=True)
            self._thread.start()

    def end(self) -> None:
        """Stop the thread, and wait for what it is writing."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()

    def _keep(self) -> None:
        while not self._ended.wait(max(LEAST_S, SHARE * (time.monotonic() - self._started))):
            self.write()

    def write(self) -> None:
        """Write what is new. A database that does not answer costs the news, not the shard."""
        with self._guard:
            facts = [fact for fact in (self._map, self._newest) if fact is not None]
            self._map = self._newest = None
        for fact in facts:
            tiles = fact.get("tiles")
            told = (
                fact if tiles is None else {**fact, "tiles": _changed(self._tiles, tiles), "first": self._tiles is None}
            )
            try:
                tell(self._engine, self._held, told)
            except UNREACHABLE:
                log.warning("what the shard tells of itself was not written", exc_info=True)
                continue
            self._tiles = tiles if tiles is not None else self._tiles


@contextmanager
def news(engine: sa.Engine, held: Claim) -> Iterator[News]:
    """Write what is told while the block runs, and the last word at its end."""
    found = News(engine, held)
    try:
        yield found
    finally:
        found.end()
    found.write()


def _changed(before: list[int] | None, tiles: list[int]) -> list[list[int]]:
    """Return [place, count] of each count that is another than before; where there is none before, than 0."""
    old = before if before is not None else [0] * len(tiles)
    return [[k, n] for k, (was, n) in enumerate(zip(old, tiles, strict=True)) if n != was]
