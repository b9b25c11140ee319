"""Answers about scenes and placements."""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from farfield_api.replies.common import AT, JOB, SCENE, TENANT, Next, Reply, Time, example

_SCENE: dict[str, Any] = {
    "digest": SCENE, "tenant": TENANT, "name": "harbour.glb", "bytes": 73_400_320, "uploaded_at": AT, "objects": 4735,
    "triangles": 1_230_001, "materials": 12, "textures": 3, "bounds": [[0, 0, 0], [820, 60, 640]], "warnings": [],
    "links": {"self": f"/v1/scenes/{SCENE}", "objects": f"/v1/scenes/{SCENE}/objects",
              "picture": f"/v1/scenes/{SCENE}/picture"},
}  # fmt: skip


class SceneLinks(Reply):
    self: str
    objects: str
    picture: str | None


class SceneReply(BaseModel):
    """What was read of a scene; more keys as `farfield inspect` says them."""

    model_config = ConfigDict(extra="allow", json_schema_extra={"examples": [_SCENE]})
    digest: str
    tenant: str
    name: str
    bytes: int
    uploaded_at: Time
    objects: int | None = None
    triangles: int | None = None
    materials: int | None = None
    textures: int | None = None
    bounds: Any = Field(None, description="lowest and highest corner, metres")
    warnings: list[Any] | None = None
    suggested: Any = Field(None, description="view space, cell and budgets that fit the scene")
    links: SceneLinks


class ScenePageReply(Reply):
    model_config = example(scenes=[_SCENE], next=None)
    scenes: list[SceneReply]
    next: Next


class SceneDeleted(Reply):
    """What goes, or went, with a scene; artifacts and bytes that nothing else of the tenant needs."""

    model_config = example(deleted=False, jobs=0, artifacts=3, bytes=73_403_991)
    deleted: bool
    jobs: int = Field(description="jobs that need the scene: it cannot be deleted before them")
    artifacts: int
    bytes: int


class PlacementReply(Reply):
    id: str
    name: str
    verdict: Literal["valid", "infeasible", "unproven"] | None


class PlacementPageReply(Reply):
    model_config = example(placements=[{"id": JOB, "name": "harbour.glb", "verdict": "valid"}], next=None)
    placements: list[PlacementReply]
    next: Next
