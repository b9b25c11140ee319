"""Scenes: sent once, hashed on the way, read in a process with limits before they are accepted."""

from typing import Any

from farfield.store import scenes
from fastapi import APIRouter, HTTPException, Request, Response

from farfield_api import upload
from farfield_api.accept import accept
from farfield_api.auth import Reader, Submitter
from farfield_api.errors import RESPONSES
from farfield_api.state import Service
from farfield_api.times import iso

router = APIRouter(prefix="/v1/scenes", tags=["scenes"], responses=RESPONSES)

_BODY = {
    "requestBody": {
        "required": True,
        "description": 'The file itself, named by `Content-Disposition: attachment; filename="level.glb"`; or a form.',
        "content": {
            "application/octet-stream": {"schema": {"type": "string", "format": "binary"}},
            "multipart/form-data": {
                "schema": {"type": "object", "properties": {"file": {"type": "string", "format": "binary"}}}
            },
        },
    }
}


@router.post(
    "", status_code=201, openapi_extra=_BODY, summary="Upload a scene; 200 where it was known", max_body_size=1 << 50
)
async def send(request: Request, response: Response, caller: Submitter, service: Service) -> dict[str, Any]:
    # The limit above is no limit: `receive` counts, and names what was exceeded.
    limits = service.settings
    file = await upload.receive(
        request, service.artifacts.temporary, limit=limits.max_scene_bytes, stall_s=limits.stall_s
    )
    try:
        row, new = await accept(service, caller.tenant_id, file)
    finally:
        file.path.unlink(missing_ok=True)
    response.status_code = 201 if new else 200
    response.headers["location"] = f"/v1/scenes/{file.digest}"
    return _shown(row)


@router.get("", summary="The newest scenes")
def list_scenes(caller: Reader, service: Service, limit: int = 50) -> dict[str, Any]:
    rows = scenes.page(service.engine, caller.tenant_id, limit=max(1, min(limit, 200)))
    return {"scenes": [_shown(row) for row in rows]}


@router.head("/{digest}", summary="Is this file known (to this tenant)?")
@router.get("/{digest}", summary="What was read of a scene: counts, bounds, warnings, suggested settings")
def show(digest: str, caller: Reader, service: Service) -> dict[str, Any]:
    return _shown(scenes.get(service.engine, caller.tenant_id, digest))


@router.get("/{digest}/objects", summary="All that `farfield inspect` says, with the list of objects")
def objects(digest: str, caller: Reader, service: Service) -> Response:
    row = scenes.get(service.engine, caller.tenant_id, digest)
    return Response(bytes(service.artifacts.buffer(row.inspect_digest)), media_type="application/json")


@router.get(
    "/{digest}/picture", summary="The scene from above, north (-z) up, as PNG", response_class=Response,
    responses={200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}}},
)  # fmt: skip
def picture(digest: str, caller: Reader, service: Service) -> Response:
    row = scenes.get(service.engine, caller.tenant_id, digest)
    if row.picture_digest is None:
        raise HTTPException(404, "this scene was sent before pictures were made")
    headers = {"cache-control": "private, max-age=31536000, immutable"}
    return Response(bytes(service.artifacts.buffer(row.picture_digest)), headers=headers, media_type="image/png")


def _shown(row: Any) -> dict[str, Any]:
    return {
        **row.summary,
        "digest": row.digest,
        "name": row.name,
        "bytes": row.n_bytes,
        "uploaded_at": iso(row.created_at),
        "links": {
            "self": f"/v1/scenes/{row.digest}",
            "objects": f"/v1/scenes/{row.digest}/objects",
            "picture": f"/v1/scenes/{row.digest}/picture" if row.picture_digest is not None else None,
        },
    }
