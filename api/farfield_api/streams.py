"""One poller a process feeds all its event streams: a hundred idle streams cost one small query at a time.

News     A job's new events are read once for all streams that are equally far, and told to a few streams at a time: a
         hundred that knock together would keep every request waiting.
"""

import asyncio
import random
from collections import Counter
from collections.abc import AsyncIterator, Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import sqlalchemy as sa
from farfield.store import events
from farfield.store.engine import read
from farfield.store.jobs import ENDED
from starlette.concurrency import run_in_threadpool

from farfield_api.errors import StreamsTooMany

T = TypeVar("T")
PAGE = 500
MOST_OF_A_KEY = 1000  # open streams, in one process
KEEP_ALIVE_S = 15.0
WAVE, WAVE_S = 10, 0.005  # so many streams are woken, and then others have their turn for so long


class EventPoller:
    """Wakes the streams of a job when its counter of events has moved."""

    def __init__(self, engine: sa.Engine, poll_s: float) -> None:
        self.engine, self.poll_s = engine, poll_s
        self._watched: dict[str, set[asyncio.Event]] = {}
        self._known: dict[str, int] = {}
        self._any = asyncio.Event()
        self._open: Counter[str] = Counter()
        self._asking: dict[Hashable, asyncio.Task[Any]] = {}
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
                    await self._tell(list(self._watched.get(job_id, ())))
            await asyncio.sleep(self.poll_s)

    async def _tell(self, watching: Sequence[asyncio.Event]) -> None:
        for k in range(0, len(watching), WAVE):
            for changed in watching[k : k + WAVE]:
                changed.set()
            if k + WAVE < len(watching):
                await asyncio.sleep(WAVE_S)

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

    async def follow(self, job_id: str, after: int) -> AsyncIterator[list[dict[str, Any]]]:
        """Yield the job's events above number `after`, some at a time, until its last one, or until `close`; an empty list
        now and then, to keep the line open.
        """
        with self.watch(job_id) as changed:
            while not self.closing:
                changed.clear()
                found = await self._read(job_id, after)
                if found:
                    after = found[-1]["seq"]
                    yield found
                    if any(event["kind"] == "job" and event["data"].get("state") in ENDED for event in found):
                        return
                while len(found) < PAGE and not self.closing:
                    try:  # not all at once: streams that began together would else knock together for ever
                        await asyncio.wait_for(changed.wait(), KEEP_ALIVE_S * random.uniform(0.7, 1.0))
                        break
                    except TimeoutError:
                        yield []

    async def _read(self, job_id: str, after: int) -> list[dict[str, Any]]:
        """Return the events above `after`. Streams that know of the same number share one read: it began after that number
        was known, so it holds whatever woke them.
        """
        return await self.share((job_id, after, self._known.get(job_id)), lambda: self._after(job_id, after))

    async def share(self, question: Hashable, ask: Callable[[], T]) -> T:
        """Return what `ask` returns in a thread; streams that have the same question at the same time ask once."""
        asking = self._asking.get(question)
        if asking is None:
            asking = self._asking[question] = asyncio.create_task(run_in_threadpool(ask))
            asking.add_done_callback(lambda _: self._asking.pop(question))
        return await asyncio.shield(asking)  # a stream that ends takes nothing from the others

    def _numbers(self, job_ids: list[str]) -> dict[str, int]:
        with read(self.engine) as tx:
            return events.last_numbers(tx, job_ids)

    def _after(self, job_id: str, after: int) -> list[dict[str, Any]]:
        with read(self.engine) as tx:
            return events.after(tx, job_id, after, PAGE)
