"""The events of a job: followed as server-sent events, from any number on, or read as JSON pages.

A stream ends with the job, with its key, or where its reader takes nothing for a minute; taken up again with Last-Event-ID it
misses nothing. What a slow reader has not taken is not gathered: the next events are read once these are sent.
"""

import asyncio
import json
import time
from collections.abc import AsyncIterator
from contextlib import AbstractContextManager, nullcontext
from typing import Annotated, Any, Literal

from farfield.store import events, jobs, tenants
from farfield.store.engine import read
from farfield.store.tenants import Caller
from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.sse import KEEPALIVE_COMMENT, EventSourceResponse, format_sse_event
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect
from starlette.types import Message, Receive, Scope, Send

from farfield_api.auth import Reader
from farfield_api.documented import refusals
from farfield_api.replies.common import Id
from farfield_api.replies.jobs import EventPageReply, EventReply
from farfield_api.state import Service, State
from farfield_api.times import iso

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])

STALL_S = 60.0  # a reader that takes nothing for so long is left
CHECK_S = 10.0  # after which the key of an open stream is looked at again, with the next event or keep-alive
Kind = Literal["job", "stage", "shard", "progress"]

_STREAM: dict[int | str, dict[str, Any]] = {
    200: {
        "model": EventPageReply,
        "description": "text/event-stream: `id` is the event's number, `event` is job, stage, shard or progress, `data` JSON; "
        "or, for a request that accepts application/json, a page of events",
        "content": {"text/event-stream": {"schema": {"type": "string"}}},
    },
    204: {"description": "the job has ended and the client has seen its last event: stop asking"},
}


class Followed(EventSourceResponse):
    """A stream that waits for its reader only so long. `held` is entered before it begins, and may refuse it."""

    held: AbstractContextManager[None] = nullcontext()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def timely(message: Message) -> None:
            async with asyncio.timeout(STALL_S):
                await send(message)

        with self.held:
            try:
                await super().__call__(scope, receive, timely)
            except (TimeoutError, ClientDisconnect):
                return  # the connection is closed: the reader goes on from the last id it has


@router.get(
    "/{job_id}/events", responses={**_STREAM, **refusals("JobNotFound", "StreamsTooMany")}, response_class=Response,
    summary="What happened, and what happens",
)  # fmt: skip
async def follow(
    job_id: Id, request: Request, caller: Reader, service: Service,
    after: Annotated[int, Query(ge=0, le=1 << 53, description="only events with a higher number")] = 0,
    limit: Annotated[int, Query(ge=1, le=1000, description="of a JSON page")] = 500,
    kind: Annotated[Kind | None, Query(description="only events of this kind")] = None,
    last_event_id: Annotated[str | None, Header(description="wins over `after`")] = None,
) -> Response:  # fmt: skip
    row = await run_in_threadpool(jobs.get, service.engine, caller.tenant_id, job_id)
    if last_event_id is not None and last_event_id.isascii() and last_event_id.isdigit():
        after = int(last_event_id[:15])
    if "application/json" in request.headers.get("accept", ""):
        page = await run_in_threadpool(_page, service, job_id, after, limit, kind)
        return Response(page.model_dump_json(), media_type="application/json")
    if row.state in jobs.ENDED and after >= row.event_seq:
        return Response(status_code=204)
    frames = _frames(service, caller, job_id, after, kind)
    followed = Followed(frames, headers={"cache-control": "no-store", "x-accel-buffering": "no"})
    followed.held = service.poller.counted(caller.key_id)
    return followed


async def _frames(service: State, caller: Caller, job_id: str, after: int, kind: Kind | None) -> AsyncIterator[bytes]:
    yield format_sse_event(retry=1000, comment="farfield")
    looked, who = time.monotonic(), (caller.key_id, caller.session)
    async for found in service.poller.follow(job_id, after):
        if time.monotonic() - looked > CHECK_S:
            looked = time.monotonic()
            if await service.poller.share(who, lambda: tenants.caller_of_id(service.engine, *who)) is None:
                return
        told = [_frame(event) for event in found if kind is None or event["kind"] == kind]
        if told or not found:
            yield b"".join(told) or KEEPALIVE_COMMENT
    if service.poller.closing:
        yield format_sse_event(retry=1000, comment="this process stops: go on at another, from the last id")


def _frame(event: dict[str, Any]) -> bytes:
    data = json.dumps({**event["data"], "at": iso(event["at"])})
    return format_sse_event(id=str(event["seq"]), event=event["kind"], data_str=data)


def _page(service: State, job_id: str, after: int, limit: int, kind: Kind | None) -> EventPageReply:
    with read(service.engine) as tx:
        found = events.after(tx, job_id, after, limit, kind=kind)
    listed = [EventReply(**{**event, "at": iso(event["at"])}) for event in found]
    return EventPageReply(events=listed, next=found[-1]["seq"] if found else after)
