"""Answers about jobs, their stages, shards and events."""

from typing import Any, Literal

from farfield.stages import Stage
from pydantic import BaseModel, ConfigDict, Field

from farfield_api.replies.common import AT, JOB, SCENE, TENANT, Next, Reply, Time, example

JobState = Literal["queued", "running", "done", "failed", "cancelled"]
StageState = Literal["waiting", "planning", "running", "merging", "reporting", "done", "skipped", "failed"]
ShardState = Literal["ready", "running", "done", "failed", "cancelled"]
Priority = Literal["high", "normal", "low"]
Verdict = Literal["valid", "infeasible", "unproven"]

_LINKS = {"self": f"/v1/jobs/{JOB}", "events": f"/v1/jobs/{JOB}/events", "page": f"/jobs/{JOB}"}
_JOB = {
    "id": JOB, "tenant": TENANT, "name": "harbour.glb", "scene": SCENE, "budget": "16 ms", "priority": "normal",
    "state": "running", "verdict": None, "error": None, "stage": "viewspace", "bytes": None, "hopeless_views": None,
    "smallest_budget": None, "progress": 0.41, "webhook": None, "created_at": AT, "started_at": AT, "finished_at": None,
    "links": _LINKS,
}  # fmt: skip
_SHARDS = {"total": 12, "ready": 4, "running": 2, "done": 6, "failed": 0, "cancelled": 0}
_STAGE = {
    "name": "viewspace",
    "state": "running",
    "skipped": None,
    "shards": _SHARDS,
    "seconds": 3.2,
    "peak_bytes": 91_226_112,
}
_SHARD = {"kind": "run", "ordinal": 3, "state": "done", "attempt": 1, "cached": False, "seconds": 1.27,
          "peak_bytes": 91_226_112, "worker": "node-3:1", "error": None}  # fmt: skip
_EVENT = {"seq": 7, "kind": "stage", "data": {"stage": "viewspace", "state": "running", "shards": 12}, "at": AT}


class JobError(Reply):
    """Why a job or a shard failed."""

    code: str
    message: str
    advice: str = ""
    stage: str | None = None


def _once_done() -> Any:
    return Field(None, exclude_if=lambda value: value is None)


class JobLinks(Reply):
    """Addresses below the service's own; those of results once the job is done."""

    self: str
    events: str
    page: str
    report: str | None = _once_done()
    report_page: str | None = _once_done()
    placement: str | None = _once_done()
    viewer: str | None = _once_done()


class JobReply(Reply):
    model_config = example(**_JOB)
    id: str
    tenant: str
    name: str
    scene: str = Field(description="digest of its scene")
    budget: str | None
    priority: Priority
    state: JobState
    verdict: Verdict | None
    error: JobError | None
    stage: Stage | None = Field(description="the one that it is at")
    bytes: int | None = Field(description="what the placement minimises; once the job is done")
    hopeless_views: int | None
    smallest_budget: str | None
    progress: float = Field(ge=0, le=1, description="share of stages that ended: for a bar, not a promise of time")
    webhook: str | None = Field(description="the webhook that the job named")
    created_at: Time
    started_at: Time | None
    finished_at: Time | None
    links: JobLinks


class ShardCounts(Reply):
    total: int
    ready: int
    running: int
    done: int
    failed: int
    cancelled: int


class StageReply(Reply):
    name: Stage
    state: StageState
    skipped: str | None = Field(description="why it was skipped")
    shards: ShardCounts
    seconds: float | None
    peak_bytes: int | None


class JobDetailReply(JobReply):
    model_config = example(**_JOB, settings={"budget": "16 ms"}, last_event=7, stages=[_STAGE])
    settings: dict[str, Any] = Field(description="all of them: see the schema Settings")
    last_event: int
    stages: list[StageReply]


class JobPageReply(Reply):
    model_config = example(jobs=[_JOB], next="WzE3NjkuMjUsIjRmMWM5YSJd")
    jobs: list[JobReply]
    next: Next


class ShardReply(Reply):
    kind: Literal["plan", "run", "merge", "report"]
    ordinal: int
    state: ShardState
    attempt: int
    cached: bool = Field(description="taken over from an earlier job")
    seconds: float | None
    peak_bytes: int | None
    worker: str | None
    error: JobError | None


class ShardPageReply(Reply):
    model_config = example(shards=[_SHARD])
    shards: list[ShardReply]


class EventReply(Reply):
    seq: int
    kind: Literal["job", "stage", "shard", "progress"]
    data: dict[str, Any]
    at: Time


class EventPageReply(Reply):
    model_config = example(events=[_EVENT], next=7)
    events: list[EventReply]
    next: int = Field(description="number of the last event here: `after` of the next page")


class JobDeleted(Reply):
    """What goes, or went, with a job; artifacts and bytes that nothing else of the tenant needs."""

    model_config = example(deleted=False, shards=41, events=173, artifacts=22, bytes=73_400_320)
    deleted: bool
    shards: int
    events: int
    artifacts: int
    bytes: int


class CurveReply(BaseModel):
    """Memory over budget."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"budget": "300 calls", "budget_amount": 300, "unit": "calls", "bytes": 41_000,
                                         "curve": [{"budget": 300, "bytes": 41_000}, {"budget": 420, "bytes": 0}]}]}
    )  # fmt: skip
    budget: Any
    budget_amount: Any
    unit: Any
    bytes: Any
    curve: Any
