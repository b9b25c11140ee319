"""Jobs: created once for an idempotency key, listed in pages, watched, cancelled, retried, deleted."""

import base64
import json
from collections.abc import AsyncIterator
from typing import Annotated, Any, Literal

from farfield.errors import JobNotFinished
from farfield.settings import Settings, from_mapping, to_mapping
from farfield.stages import Stage
from farfield.store import events, jobs, scenes
from farfield.store.engine import read
from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.sse import KEEPALIVE_COMMENT, EventSourceResponse, format_sse_event
from pydantic import BaseModel, ConfigDict, Field, WrapValidator
from starlette.concurrency import run_in_threadpool

from farfield_api.auth import Reader, Submitter
from farfield_api.errors import RESPONSES, CursorInvalid
from farfield_api.routes.devices import with_device
from farfield_api.state import Service, State
from farfield_api.times import iso

router = APIRouter(prefix="/v1/jobs", tags=["jobs"], responses=RESPONSES)

State_ = Literal["queued", "running", "done", "failed", "cancelled"]
# The schema is the dataclass's; the checks are the domain's own, so that a bad value has the same error everywhere.
CheckedSettings = Annotated[Settings, WrapValidator(lambda value, inner: from_mapping(value))]


class JobRequest(BaseModel):
    model_config = ConfigDict(extra="forbid")
    scene: str = Field(pattern="^[0-9a-f]{64}$", description="digest of an uploaded scene")
    settings: CheckedSettings = Field(default_factory=Settings, description="what is left out has its default")
    name: str | None = Field(None, max_length=255, description="what to call it; the scene's name by default")


@router.post("", status_code=201, summary="Place impostors for a scene; 200 where the idempotency key is known")
def create(
    wanted: JobRequest, response: Response, caller: Submitter, service: Service,
    idempotency_key: Annotated[str | None, Header(max_length=255)] = None,
) -> dict[str, Any]:  # fmt: skip
    settings, device_id = with_device(service.engine, caller.tenant_id, wanted.settings)
    name = wanted.name or scenes.get(service.engine, caller.tenant_id, wanted.scene).name
    job_id, message = jobs.create(
        service.engine, caller.tenant_id, name=name, scene_digest=wanted.scene,
        settings=to_mapping(settings), stages=list(Stage), idempotency_key=idempotency_key, device_profile_id=device_id,
        asked=to_mapping(wanted.settings),
    )  # fmt: skip
    if message is None:
        response.status_code = 200
    else:
        service.queue.send(message)
    response.headers["location"] = f"/v1/jobs/{job_id}"
    return _shown(service, caller.tenant_id, job_id)


@router.get("", summary="Jobs, newest first, in pages")
def list_jobs(
    caller: Reader, service: Service, state: State_ | None = None, cursor: str | None = None,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
) -> dict[str, Any]:  # fmt: skip
    before = _read_cursor(cursor) if cursor is not None else None
    rows = jobs.page(service.engine, caller.tenant_id, state=state, before=before, limit=limit + 1)
    listed = [_brief(row, jobs.stages_of(service.engine, row.id)) for row in rows[:limit]]
    return {"jobs": listed, "next": _write_cursor(rows[limit - 1]) if len(rows) > limit else None}


@router.get("/{job_id}", summary="State, stages with their shards, skipped stages with the reason, verdict")
def show(job_id: str, caller: Reader, service: Service) -> dict[str, Any]:
    return _shown(service, caller.tenant_id, job_id)


@router.get("/{job_id}/stages/{stage}/shards", summary="The shards of a stage")
def shards(job_id: str, stage: Stage, caller: Reader, service: Service) -> dict[str, Any]:
    jobs.get(service.engine, caller.tenant_id, job_id)
    rows = jobs.shards_of(service.engine, job_id, stage)
    keys = ("kind", "ordinal", "state", "attempt", "cached", "seconds", "peak_bytes", "worker", "error")
    return {"shards": [{key: getattr(row, key) for key in keys} for row in rows]}


@router.post("/{job_id}/cancel", summary="Stop it; what is done stays")
def cancel(job_id: str, caller: Submitter, service: Service) -> dict[str, Any]:
    jobs.cancel(service.engine, caller.tenant_id, job_id)
    return _shown(service, caller.tenant_id, job_id)


@router.post("/{job_id}/retry", summary="Let a failed or cancelled job go on from what is done")
def retry(job_id: str, caller: Submitter, service: Service) -> dict[str, Any]:
    for message in jobs.retry(service.engine, caller.tenant_id, job_id):
        service.queue.send(message)
    return _shown(service, caller.tenant_id, job_id)


@router.delete("/{job_id}", summary="Delete an ended job with what only it needs; `dry_run` says what that is")
def delete(job_id: str, caller: Submitter, service: Service, dry_run: bool = False) -> dict[str, Any]:
    counts, _ = jobs.delete(service.engine, caller.tenant_id, job_id, dry_run=dry_run, remove=service.artifacts.remove)
    return {"deleted": not dry_run, **counts}


@router.get("/{job_id}/report", summary="The certificate and its figures")
def report(job_id: str, caller: Reader, service: Service) -> Response:
    return Response(_report(service, caller.tenant_id, job_id), media_type="application/json")


@router.get("/{job_id}/curve", summary="Memory over budget: what a larger budget would need")
def curve(job_id: str, caller: Reader, service: Service) -> dict[str, Any]:
    told = json.loads(_report(service, caller.tenant_id, job_id))
    return {key: told.get(key) for key in ("budget", "budget_amount", "unit", "bytes", "curve")}


def _report(service: State, tenant_id: str, job_id: str) -> bytes:
    row = jobs.get(service.engine, tenant_id, job_id)
    if row.report_digest is None:
        raise JobNotFinished(job_id, row.state)
    return bytes(service.artifacts.buffer(row.report_digest))


_STREAM: dict[int | str, dict[str, Any]] = {
    "200": {
        "description": "text/event-stream: `id` is the event's number, `event` is job, stage or shard, `data` JSON "
        "or, for a request that accepts application/json, a page of events",
        "content": {"text/event-stream": {}, "application/json": {}},
    },
    "204": {"description": "the job has ended and the client has seen its last event: stop asking"},
}


@router.get("/{job_id}/events", responses=_STREAM, response_class=Response, summary="What happened, and what happens")
async def follow(
    job_id: str, request: Request, caller: Reader, service: Service,
    after: Annotated[int, Query(ge=0)] = 0, limit: Annotated[int, Query(ge=1, le=1000)] = 500,
    last_event_id: Annotated[str | None, Header()] = None,
) -> Response:  # fmt: skip
    row = await run_in_threadpool(jobs.get, service.engine, caller.tenant_id, job_id)
    if last_event_id is not None and last_event_id.isdecimal():
        after = int(last_event_id[:18])
    if "application/json" in request.headers.get("accept", ""):
        return Response(
            json.dumps(await run_in_threadpool(_page, service, job_id, after, limit)), media_type="application/json"
        )
    if row.state in jobs.ENDED and after >= row.event_seq:
        return Response(status_code=204)
    return EventSourceResponse(
        _frames(service, job_id, after), headers={"cache-control": "no-store", "x-accel-buffering": "no"}
    )


async def _frames(service: State, job_id: str, after: int) -> AsyncIterator[bytes]:
    yield format_sse_event(retry=1000, comment="farfield")
    async for event in service.poller.follow(job_id, after):
        if event is None:
            yield KEEPALIVE_COMMENT
        else:
            data = json.dumps({**event["data"], "at": iso(event["at"])})
            yield format_sse_event(id=str(event["seq"]), event=event["kind"], data_str=data)
    if service.poller.closing:
        yield format_sse_event(retry=1000, comment="this process stops: go on at another, from the last id")


def _page(service: State, job_id: str, after: int, limit: int) -> dict[str, Any]:
    with read(service.engine) as tx:
        found = events.after(tx, job_id, after, limit)
    listed = [{**event, "at": iso(event["at"])} for event in found]
    return {"events": listed, "next": found[-1]["seq"] if found else after}


def _shown(service: State, tenant_id: str, job_id: str) -> dict[str, Any]:
    row = jobs.get(service.engine, tenant_id, job_id)
    stages = jobs.stages_of(service.engine, job_id)
    listed = [{key: value for key, value in stage.items() if key != "artifact"} for stage in stages]
    return {**_brief(row, stages), "settings": row.settings, "last_event": row.event_seq, "stages": listed}


def _brief(row: Any, stages: list[dict[str, Any]]) -> dict[str, Any]:
    at = next((s["name"] for s in stages if s["state"] not in ("done", "skipped", "failed", "waiting")), None)
    ready = row.state == "done"
    figures = row.figures or {}
    return {
        "id": row.id, "name": row.name, "scene": row.scene_digest, "budget": row.settings.get("budget"),
        "state": row.state, "verdict": row.verdict, "error": row.error, "stage": at,
        **{key: figures.get(key) for key in ("bytes", "hopeless_views", "smallest_budget")},
        "progress": 1.0 if ready else _progress(stages),
        "created_at": iso(row.created_at), "started_at": iso(row.started_at), "finished_at": iso(row.finished_at),
        "links": {
            "self": f"/v1/jobs/{row.id}", "events": f"/v1/jobs/{row.id}/events", "page": f"/jobs/{row.id}",
            **({"report": f"/v1/jobs/{row.id}/report", "report_page": f"/jobs/{row.id}/report",
                "placement": f"/v1/placements/{row.id}/manifest.json", "viewer": f"/viewer/{row.id}"} if ready else {}),
        },
    }  # fmt: skip


def _progress(stages: list[dict[str, Any]]) -> float:
    """Return the share of stages that ended, the running one by its shards: for a bar, not a promise of time."""
    total = 0.0
    for stage in stages:
        shards = stage["shards"]
        ended = stage["state"] in ("done", "skipped", "failed")
        total += 1.0 if ended else shards["done"] / shards["total"] if shards["total"] else 0.0
    return round(total / max(len(stages), 1), 4)


def _write_cursor(row: Any) -> str:
    return base64.urlsafe_b64encode(json.dumps([row.created_at, row.id]).encode()).decode().rstrip("=")


def _read_cursor(cursor: str) -> tuple[float, str]:
    try:
        created_at, job_id = json.loads(base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)))
        return float(created_at), str(job_id)
    except (ValueError, TypeError):
        raise CursorInvalid from None
