"""Many streams of one job: each is told of everything once, in order, and together they ask the database little."""

import asyncio
import random
import threading
import time

from farfield_api.streams import EventPoller

STREAMS, EVENTS = 60, 40


class Job(EventPoller):
    """A poller over a list instead of a database. An event is seen once it is there, as after a commit."""

    def __init__(self) -> None:
        super().__init__(None, poll_s=0.002)
        self.events, self.asked = [], 0
        self.gate = threading.Event()  # a read that finds nothing waits for it
        self.gate.set()

    def add(self, kind: str, **data) -> None:
        self.events.append({"seq": len(self.events) + 1, "kind": kind, "data": data})

    def _numbers(self, job_ids):
        return {job_id: len(self.events) for job_id in job_ids}

    def _after(self, job_id, after):
        self.asked += 1
        found = self.events[after:]
        time.sleep(random.uniform(0, 0.003))  # the answer is on its way while more happens
        if not found:
            self.gate.wait(10.0)
        return found


def test_streams_share_their_reads_and_miss_nothing():
    job = Job()
    stop = threading.Event()

    def happen() -> None:
        for k in range(EVENTS):
            stop.wait(random.uniform(0, 0.012))
            job.add("shard", done=k)
        job.add("job", state="done")

    async def read(wait: float, after: int) -> list[int]:
        await asyncio.sleep(wait)
        return [event["seq"] async for found in job.follow("job", after) for event in found]

    async def run() -> list[list[int]]:
        polling = asyncio.create_task(job.run())
        thread = threading.Thread(target=happen)
        thread.start()
        late = [asyncio.create_task(read(random.uniform(0, 0.2), k % 3)) for k in range(STREAMS)]
        given_up = asyncio.create_task(read(0.0, 0))
        await asyncio.sleep(0.05)
        given_up.cancel()
        told = await asyncio.wait_for(asyncio.gather(*late), 10.0)
        polling.cancel()
        thread.join()
        return told

    for k, told in enumerate(asyncio.run(run())):
        assert told == list(range(k % 3 + 1, EVENTS + 2))
    assert job.asked < STREAMS * EVENTS / 3


def test_a_stream_does_not_share_a_read_that_began_before_its_news():
    job = Job()
    job.add("shard")

    async def run() -> None:
        polling = asyncio.create_task(job.run())
        first, second = (asyncio.create_task(anext(job.follow("job", 1))) for _ in range(2))
        while job.asked == 0 or job._asking:  # until both wait for news
            await asyncio.sleep(0.01)
        asked = job.asked
        job.gate.clear()
        next(iter(job._watched["job"])).set()
        while job.asked == asked:  # one of them reads, finds nothing and is not answered yet
            await asyncio.sleep(0.001)
        job.add("job", state="done")
        done, _ = await asyncio.wait([first, second], timeout=5.0, return_when=asyncio.FIRST_COMPLETED)
        assert [task.result()[0]["seq"] for task in done] == [2]
        job.gate.set()
        for task in (first, second):
            assert (await asyncio.wait_for(task, 5.0))[0]["seq"] == 2
        polling.cancel()

    asyncio.run(run())
