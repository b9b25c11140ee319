"""A load generator for a service on loopback: idle event streams and a steady rate of requests, at once, bounded.

Requests start at fixed times, whatever became of those before: a service that falls behind is not asked more slowly.
"""

import asyncio
import time
from collections.abc import Sequence
from dataclasses import dataclass

import httpx


@dataclass(frozen=True, slots=True)
class Loaded:
    """What a run of the generator found. Latencies in milliseconds, by path, sorted."""

    latencies_ms: dict[str, list[float]]
    failed: int
    streams_lost: int

    def percentile(self, path: str, share: float) -> float:
        found = self.latencies_ms[path]
        return found[min(len(found) - 1, int(share * len(found)))]


async def _stream(client: httpx.AsyncClient, path: str, ready: asyncio.Semaphore, lost: list[int]) -> None:
    try:
        async with client.stream("GET", path, headers={"accept": "text/event-stream"}) as answer:
            ready.release()
            if answer.status_code == 200:
                async for _ in answer.aiter_bytes():
                    pass
            lost.append(answer.status_code)  # it ended, although the job has not
    except httpx.HTTPError:
        lost.append(0)


async def _load(
    url: str, key: str, paths: Sequence[str], stream: str, *, streams: int, rate: int, seconds: float
) -> Loaded:
    headers, limits = {"authorization": f"Bearer {key}"}, httpx.Limits(max_connections=None)
    options = {"base_url": url, "headers": headers, "limits": limits, "trust_env": False, "timeout": 60.0}
    latencies: dict[str, list[float]] = {path: [] for path in paths}
    failed, lost, ready = [], [], asyncio.Semaphore(0)

    async with httpx.AsyncClient(**options) as client, httpx.AsyncClient(**options) as listener:
        open_ = [asyncio.create_task(_stream(listener, stream, ready, lost)) for _ in range(streams)]
        for _ in open_:
            await asyncio.wait_for(ready.acquire(), 60.0)

        async def ask(path: str) -> None:
            began = time.perf_counter()
            try:
                answer = await client.get(path)
                answer.raise_for_status()
                latencies[path].append(1e3 * (time.perf_counter() - began))
            except httpx.HTTPError as error:
                failed.append(error)

        began, asked = time.monotonic(), []
        for k in range(int(rate * seconds)):
            await asyncio.sleep(max(0.0, began + k / rate - time.monotonic()))
            asked.append(asyncio.create_task(ask(paths[k % len(paths)])))
        await asyncio.gather(*asked)
        n_lost = len(lost)
        for task in open_:
            task.cancel()
        await asyncio.gather(*open_, return_exceptions=True)
    return Loaded({path: sorted(found) for path, found in latencies.items()}, len(failed), n_lost)


def load(url: str, key: str, paths: Sequence[str], stream: str, *, streams: int, rate: int, seconds: float) -> Loaded:
    """Hold `streams` streams of `stream` open and ask for `paths` in turn, `rate` times a second, for so long."""
    return asyncio.run(_load(url, key, paths, stream, streams=streams, rate=rate, seconds=seconds))
