"""One poller a process feeds all its event streams: a hundred idle streams cost one small query at a time."""

import asyncio
import random
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from typing import Any

import sqlalchemy as sa
from farfield.store import events
from farfield.store.engine import read
from farfield.store.jobs import ENDED
from starlette.concurrency import run_in_threadpool

from farfield_api.errors import StreamsTooMany

PAGE = 500
MOST_OF_A_KEY = 1000  # open streams, in one process
KEEP_ALIVE_S = 15.0


class EventPoller:
    """Wakes the streams of a job when its counter of events has moved."""

    def __init__(self, engine: sa.Engine, poll_s: float) -> None:
        self.engine, self.poll_s = engine, poll_s
        self._watched: dict[str, set[asyncio.Event]] = {}
        self._known: dict[str, int] = {}
        self._any = asyncio.Event()
        self._open: Counter[str] = Counter()
        self.closing = False

    @contextmanager
    def counted(self, key_id: str) -> Iterator[None]:
        """Count an open stream of the key. Raises StreamsTooMany."""
        if self._open[key_id] >= MOST_OF_A_KEY:
            raise StreamsTooMany(MOST_OF_A_KEY)
        self._open[key_id] += 1
        try:
            yield
        finally:
            self._open[key_id] -= 1
            if not self._open[key_id]:
                del self._open[key_id]

    def close(self) -> None:
        """End all streams: the process is about to stop, and their clients take them up again elsewhere."""
        self.closing = True
        for watching in self._watched.values():
            for changed in watching:
                changed.set()

    async def run(self) -> None:
        """Look for news for as long as somebody watches; runs until cancelled."""
        while True:
            await self._any.wait()
            try:
                numbers = await run_in_threadpool(self._numbers, list(self._watched))
            except sa.exc.SQLAlchemyError:  # such as a pool without a free connection: this task must not end
                numbers = {}
            for job_id, number in numbers.items():
                if self._known.get(job_id) != number:
                    self._known[job_id] = number
                    for changed in self._watched.get(job_id, ()):
                        changed.set()
            await asyncio.sleep(self.poll_s)

    @contextmanager
    def watch(self, job_id: str) -> Iterator[asyncio.Event]:
        """An event that is set whenever the job may have news."""
        changed = asyncio.Event()
        self._watched.setdefault(job_id, set()).add(changed)
        self._any.set()
        try:
            yield changed
        finally:
            self._watched[job_id].discard(changed)
            if not self._watched[job_id]:
                del self._watched[job_id]
                self._known.pop(job_id, None)
            if not self._watched:
                self._any.clear()

    async def follow(self, job_id: str, after: int) -> AsyncIterator[dict[str, Any] | None]:
        """Yield the job's events above number `after` until its last one, or until `close`; None now and then, to keep the
        line open.
        """
        with self.watch(job_id) as changed:
            while not self.closing:
                changed.clear()
                found = await run_in_threadpool(self._after, job_id, after)
                for event in found:
                    after = event["seq"]
                    yield event
                    if event["kind"] == "job" and event["data"].get("state") in ENDED:
                        return
                while len(found) < PAGE and not self.closing:
                    try:  # not all at once: streams that began together would else knock together for ever
                        await asyncio.wait_for(changed.wait(), KEEP_ALIVE_S * random.uniform(0.7, 1.0))
                        break
                    except TimeoutError:
                        yield None

    def _numbers(self, job_ids: list[str]) -> dict[str, int]:
        with read(self.engine) as tx:
            return events.last_numbers(tx, job_ids)

    def _after(self, job_id: str, after: int) -> list[dict[str, Any]]:
        with read(self.engine) as tx:
            return events.after(tx, job_id, after, PAGE)
