"""Scenes: sent once, hashed on the way, read in a process with limits before they are accepted."""

import json
from typing import Any

from farfield.errors import SceneNotFound
from farfield.store import scenes
from fastapi import APIRouter, Request, Response
from starlette.concurrency import run_in_threadpool

from farfield_api import upload
from farfield_api.auth import Reader, Submitter
from farfield_api.errors import RESPONSES
from farfield_api.state import Service, State
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
    received = await upload.receive(request, service.artifacts.temporary, service.settings.max_scene_bytes)
    try:
        try:
            row = await run_in_threadpool(scenes.get, service.engine, caller.tenant_id, received.digest)
        except SceneNotFound:
            pass
        else:
            response.status_code = 200
            return _shown(row)
        suffix = upload.suffix_of(received)
        named = received.path.with_name(received.path.name + suffix)
        received.path.rename(named)
        received.path = named
        shown = received.name or f"scene{suffix}"
        found = await upload.read_apart(service.settings.inspect_command, named, shown, service.settings)
        row = await run_in_threadpool(_accept, service, caller.tenant_id, received, suffix, found)
        response.headers["location"] = f"/v1/scenes/{received.digest}"
        return _shown(row)
    finally:
        received.path.unlink(missing_ok=True)


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


def _accept(service: State, tenant_id: str, received: upload.Received, suffix: str, found: dict[str, Any]) -> Any:
    whole = json.dumps(found, sort_keys=True).encode()
    inspect_digest = service.artifacts.put(whole)
    service.artifacts.put_file(received.path, received.digest)
    # The row holds counts; the lists are an artifact, asked for apart.
    counts = {key: len(found[key]) for key in ("objects", "materials", "textures") if isinstance(found.get(key), list)}
    summary = {**found, **counts}
    name = received.name or f"scene{suffix}"
    scenes.add(
        service.engine, tenant_id, digest=received.digest, name=name, suffix=suffix, n_bytes=received.n_bytes,
        summary=summary, inspect_digest=inspect_digest, inspect_bytes=len(whole),
    )  # fmt: skip
    return scenes.get(service.engine, tenant_id, received.digest)


def _shown(row: Any) -> dict[str, Any]:
    return {
        **row.summary,
        "digest": row.digest,
        "name": row.name,
        "bytes": row.n_bytes,
        "uploaded_at": iso(row.created_at),
    }
