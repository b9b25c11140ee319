"""Jobs: created once for an idempotency key, listed in pages, cancelled, retried, deleted. Their events: routes/events.py."""

import json
from typing import Annotated, Any

from farfield.errors import JobNotFinished, SettingsInvalid
from farfield.settings import Settings, from_mapping, to_mapping
from farfield.stages import Stage
from farfield.store import jobs, scenes
from farfield.store.tables import PRIORITIES
from fastapi import APIRouter, Header, Path, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, WrapValidator

from farfield_api.answers import etag_of
from farfield_api.auth import Reader, Submitter
from farfield_api.conditions import expect_match
from farfield_api.documented import refusals
from farfield_api.errors import PreconditionFailed
from farfield_api.paging import CursorText, DryRun, Limit, Part, Since, Until, cut, read_cursor, seconds
from farfield_api.replies.common import DIGEST, ID, PLAIN, SCENE, Id
from farfield_api.replies.jobs import (
    CurveReply,
    JobDeleted,
    JobDetailReply,
    JobPageReply,
    JobReply,
    JobState,
    Priority,
    ShardPageReply,
    Verdict,
)
from farfield_api.routes.devices import with_device
from farfield_api.state import Service, State
from farfield_api.times import iso

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])

# The schema is the dataclass's; the checks are the domain's own, so that a bad value has the same error everywhere.
CheckedSettings = Annotated[Settings, WrapValidator(lambda value, inner: _checked(value))]


def _checked(value: Any) -> Settings:
    settings = from_mapping(value)
    if settings.placement.base is not None:  # else the job would end as BaseUnfit, minutes later
        raise SettingsInvalid(
            "placement.base", "a job places from scratch; `farfield place --from` starts from a placement"
        )
    return settings


class JobRequest(BaseModel):
    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"examples": [{"scene": SCENE, "settings": {"budget": "16 ms"}}]}
    )
    scene: str = Field(pattern=DIGEST, description="digest of an uploaded scene")
    settings: CheckedSettings = Field(default_factory=Settings, description="what is left out has its default")
    name: str | None = Field(
        None, max_length=255, pattern=PLAIN, description="what to call it; the scene's name by default"
    )
    priority: Priority = Field("normal", description="before or after other jobs of the tenant")
    webhook: str | None = Field(
        None, pattern=ID, description="id of a webhook to tell of this job, whether it hears of all or not"
    )


@router.post(
    "", status_code=201, summary="Place impostors for a scene; 200 where the idempotency key is known",
    responses={200: {"model": JobDetailReply, "description": "the job that the idempotency key made before"},
               **refusals("SceneNotFound", "WebhookNotFound", "IdempotencyConflict", "SettingsInvalid",
                          "DeviceNotCalibrated", "QuotaExceeded", "RunningQuotaExceeded")},
)  # fmt: skip
def create(
    wanted: JobRequest, response: Response, caller: Submitter, service: Service,
    idempotency_key: Annotated[
        str | None, Header(min_length=1, max_length=255, description="the same key again is the same job")
    ] = None,
) -> JobDetailReply:  # fmt: skip
    settings, device_id = with_device(service.engine, caller.tenant_id, wanted.settings)
    name = wanted.name or scenes.get(service.engine, caller.tenant_id, wanted.scene).name
    job_id, message = jobs.create(
        service.engine, caller.tenant_id, name=name, scene_digest=wanted.scene,
        settings=to_mapping(settings), stages=list(Stage), idempotency_key=idempotency_key, device_profile_id=device_id,
        asked=to_mapping(wanted.settings), priority=wanted.priority, webhook_id=wanted.webhook,
        quota=service.settings.quota,
    )  # fmt: skip
    if message is None:
        response.status_code = 200
    else:
        service.queue.send(message)
    response.headers["location"] = f"/v1/jobs/{job_id}"
    return _shown(service, caller.tenant_id, job_id)


@router.get("", summary="Jobs, newest first, in pages", responses=refusals("CursorInvalid"))
def list_jobs(
    caller: Reader, service: Service, state: JobState | None = None,
    scene: Annotated[str | None, Query(pattern=DIGEST, description="digest of their scene")] = None,
    verdict: Verdict | None = None, name: Part = None, created_after: Since = None, created_before: Until = None,
    cursor: CursorText = None, limit: Limit = 50,
) -> JobPageReply:  # fmt: skip
    rows = jobs.page(
        service.engine, caller.tenant_id, before=read_cursor(cursor), limit=limit + 1, state=state, scene_digest=scene,
        verdict=verdict, name=name, since=seconds(created_after), until=seconds(created_before),
    )  # fmt: skip
    rows, following = cut(rows, limit)
    stages = jobs.stages_of_all(service.engine, [row.id for row in rows])
    return JobPageReply(jobs=[JobReply(**_brief(row, stages[row.id])) for row in rows], next=following)


@router.get(
    "/{job_id}", summary="State, stages with their shards, skipped stages with the reason, verdict",
    response_model=JobDetailReply, responses=refusals("JobNotFound"),
)  # fmt: skip
def show(job_id: Id, caller: Reader, service: Service) -> Response:
    # As bytes: FastAPI would check the reply once more and write it again, in another thread.
    body = _shown(service, caller.tenant_id, job_id).model_dump_json().encode()
    return Response(body, media_type="application/json", headers={"etag": etag_of(body)})


@router.get("/{job_id}/stages/{stage}/shards", summary="The shards of a stage", responses=refusals("JobNotFound"))
def shards(
    job_id: Id, stage: Annotated[Stage, Path()], caller: Reader, service: Service,
    start: Annotated[int, Query(ge=0, le=10**9, description="place of the first, in each kind")] = 0,
    limit: Annotated[int, Query(ge=1, le=5000)] = 1000,
) -> ShardPageReply:  # fmt: skip
    jobs.get(service.engine, caller.tenant_id, job_id)
    rows = jobs.shards_of(service.engine, job_id, stage, start=start, limit=limit)
    keys = ("kind", "ordinal", "state", "attempt", "cached", "seconds", "peak_bytes", "worker", "error")
    return ShardPageReply(shards=[{key: getattr(row, key) for key in keys} for row in rows])  # type: ignore[misc]


@router.post("/{job_id}/cancel", summary="Stop it; what is done stays", responses=refusals("JobNotFound"))
def cancel(job_id: Id, caller: Submitter, service: Service) -> JobDetailReply:
    jobs.cancel(service.engine, caller.tenant_id, job_id)
    return _shown(service, caller.tenant_id, job_id)


@router.post(
    "/{job_id}/retry", summary="Let a failed or cancelled job go on from what is done",
    responses=refusals("JobNotFound", "JobNotStopped", "QuotaExceeded", "RunningQuotaExceeded"),
)  # fmt: skip
def retry(job_id: Id, caller: Submitter, service: Service) -> JobDetailReply:
    for message in jobs.retry(service.engine, caller.tenant_id, job_id, quota=service.settings.quota):
        service.queue.send(message)
    return _shown(service, caller.tenant_id, job_id)


@router.delete(
    "/{job_id}", summary="Delete an ended job; `dry_run` says what goes with it. If-Match: only as it was seen",
    responses=refusals("JobNotFound", "JobStillRunning", PreconditionFailed),
)  # fmt: skip
def delete(job_id: Id, request: Request, caller: Submitter, service: Service, dry_run: DryRun = False) -> JobDeleted:
    def expect(row: Any) -> None:
        expect_match(request, _detail(row, jobs.stages_of(service.engine, job_id)))

    counts = jobs.delete(service.engine, caller.tenant_id, job_id, dry_run=dry_run, expect=expect)
    return JobDeleted(deleted=not dry_run, **counts)


@router.get(
    "/{job_id}/report", summary="The certificate and its figures (docs/formats/report.md)",
    response_class=Response,
    responses={200: {"description": "the report", "content": {"application/json": {"schema": {"type": "object"}}}},
               **refusals("JobNotFound", JobNotFinished)},
)  # fmt: skip
def report(job_id: Id, caller: Reader, service: Service) -> Response:
    return Response(_report(service, caller.tenant_id, job_id), media_type="application/json")


@router.get(
    "/{job_id}/curve", summary="Memory over budget: what a larger budget would need",
    responses=refusals("JobNotFound", JobNotFinished),
)  # fmt: skip
def curve(job_id: Id, caller: Reader, service: Service) -> CurveReply:
    told = json.loads(_report(service, caller.tenant_id, job_id))
    return CurveReply(**{key: told.get(key) for key in CurveReply.model_fields})


def _report(service: State, tenant_id: str, job_id: str) -> bytes:
    row = jobs.get(service.engine, tenant_id, job_id)
    if row.report_digest is None:
        raise JobNotFinished(job_id, row.state)
    return bytes(service.artifacts.buffer(row.report_digest))


def _shown(service: State, tenant_id: str, job_id: str) -> JobDetailReply:
    return _detail(*jobs.shown(service.engine, tenant_id, job_id))


def _detail(row: Any, stages: list[dict[str, Any]]) -> JobDetailReply:
    listed = [{key: value for key, value in stage.items() if key != "artifact"} for stage in stages]
    more: dict[str, Any] = {"settings": row.settings, "last_event": row.event_seq, "stages": listed}
    return JobDetailReply(**_brief(row, stages), **more)


def _brief(row: Any, stages: list[dict[str, Any]]) -> dict[str, Any]:
    at = next((s["name"] for s in stages if s["state"] not in ("done", "skipped", "failed", "waiting")), None)
    ready = row.state == "done"
    figures = row.figures or {}
    return {
        "id": row.id, "tenant": row.tenant_id, "name": row.name, "scene": row.scene_digest,
        "budget": row.settings.get("budget"), "priority": PRIORITIES[row.priority],
        "state": row.state, "verdict": row.verdict, "error": row.error, "stage": at,
        **{key: figures.get(key) for key in ("bytes", "hopeless_views", "smallest_budget")},
        "progress": 1.0 if ready else _progress(stages), "webhook": row.webhook_id,
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
