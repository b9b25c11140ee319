"""Scenes: sent once, hashed on the way, read in a process with limits before they are accepted."""

from typing import Any

from farfield.store import quotas, scenes
from fastapi import APIRouter, HTTPException, Request, Response

from farfield_api import upload
from farfield_api.accept import accept
from farfield_api.auth import Reader, Submitter
from farfield_api.documented import refusals
from farfield_api.paging import CursorText, DryRun, Limit, Part, cut, read_cursor
from farfield_api.replies.common import Digest
from farfield_api.replies.scenes import SceneDeleted, ScenePageReply, SceneReply
from farfield_api.state import Service
from farfield_api.times import iso

router = APIRouter(prefix="/v1/scenes", tags=["scenes"])
_NOT_FOUND = refusals("SceneNotFound")

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
    "", status_code=201, openapi_extra=_BODY, summary="Upload a scene; 200 where it was known", max_body_size=1 << 50,
    response_model_exclude_unset=True,
    responses={200: {"model": SceneReply, "description": "the tenant had sent it before"},
               **refusals("UploadTooLarge", "UploadAltered", "SceneUnreadable", "SceneOverLimit", "QuotaExceeded")},
)  # fmt: skip
async def send(request: Request, response: Response, caller: Submitter, service: Service) -> SceneReply:
    # The limit above is no limit: `receive` counts, and names what was exceeded.
    limits = service.settings
    file = await upload.receive(
        request, service.artifacts.temporary, limit=limits.max_scene_bytes, stall_s=limits.stall_s,
        room=lambda n: quotas.check_upload(service.engine, caller.tenant_id, limits.quota, already=n),
    )  # fmt: skip
    try:
        row, new = await accept(service, caller.tenant_id, file)
    finally:
        file.path.unlink(missing_ok=True)
    response.status_code = 201 if new else 200
    response.headers["location"] = f"/v1/scenes/{file.digest}"
    return SceneReply(**_shown(row))


@router.get(
    "", summary="The tenant's scenes, newest first", response_model_exclude_unset=True,
    responses=refusals("CursorInvalid"),
)  # fmt: skip
def list_scenes(
    caller: Reader, service: Service, name: Part = None, cursor: CursorText = None, limit: Limit = 50
) -> ScenePageReply:
    rows = scenes.page(service.engine, caller.tenant_id, before=read_cursor(cursor), limit=limit + 1, name=name)
    rows, following = cut(rows, limit, key="digest")
    listed = [{k: v for k, v in _shown(row).items() if k != "suggested"} for row in rows]  # which may be long
    return ScenePageReply(scenes=[SceneReply(**shown) for shown in listed], next=following)


@router.head(
    "/{digest}", summary="Is this file known (to this tenant)?", response_model_exclude_unset=True, responses=_NOT_FOUND
)
@router.get(
    "/{digest}", summary="What was read of a scene: counts, bounds, warnings, suggested settings",
    response_model_exclude_unset=True, responses=_NOT_FOUND,
)  # fmt: skip
def show(digest: Digest, caller: Reader, service: Service) -> SceneReply:
    return SceneReply(**_shown(scenes.get(service.engine, caller.tenant_id, digest)))


@router.delete(
    "/{digest}", summary="Delete a scene that no job needs; `dry_run` says what goes with it",
    responses=refusals("SceneNotFound", "SceneInUse"),
)  # fmt: skip
def delete(digest: Digest, caller: Submitter, service: Service, dry_run: DryRun = False) -> SceneDeleted:
    counts = scenes.delete(service.engine, caller.tenant_id, digest, dry_run=dry_run)
    return SceneDeleted(deleted=not dry_run, **counts)


@router.get(
    "/{digest}/objects", summary="All that `farfield inspect` says, with the list of objects", response_class=Response,
    responses={200: {"description": "what was read", "content": {"application/json": {"schema": {"type": "object"}}}},
               **_NOT_FOUND},
)  # fmt: skip
def objects(digest: Digest, caller: Reader, service: Service) -> Response:
    row = scenes.get(service.engine, caller.tenant_id, digest)
    return Response(bytes(service.artifacts.buffer(row.inspect_digest)), media_type="application/json")


@router.get(
    "/{digest}/picture", summary="The scene from above, north (-z) up, as PNG", response_class=Response,
    responses={200: {"description": "the picture",
                     "content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}}, **_NOT_FOUND},
)  # fmt: skip
def picture(digest: Digest, caller: Reader, service: Service) -> Response:
    row = scenes.get(service.engine, caller.tenant_id, digest)
    if row.picture_digest is None:
        raise HTTPException(404, "this scene was sent before pictures were made")
    headers = {"cache-control": "private, max-age=31536000, immutable"}
    return Response(bytes(service.artifacts.buffer(row.picture_digest)), headers=headers, media_type="image/png")


def _shown(row: Any) -> dict[str, Any]:
    return {
        **row.summary,
        "digest": row.digest,
        "tenant": row.tenant_id,
        "name": row.name,
        "bytes": row.n_bytes,
        "uploaded_at": iso(row.created_at),
        "links": {
            "self": f"/v1/scenes/{row.digest}",
            "objects": f"/v1/scenes/{row.digest}/objects",
            "picture": f"/v1/scenes/{row.digest}/picture" if row.picture_digest is not None else None,
        },
    }
