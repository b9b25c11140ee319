"""The files that viewer and tools read: manifest, chunks, pages, scene.glb, report.json; ranges, strong ETags, caching; and
the impostors as glTF (`export`).

A job's placement is one artifact, a container of files: each is a range of it, streamed from the store (`slices`).
A folder registered with `farfield serve --placement` is served as it lies. Either way the address is
/v1/placements/NAME/manifest.json, /v1/placements/NAME/scene.glb, /v1/placements/NAME/report.json.
"""

import os
import re
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Literal

from farfield.errors import JobNotFinished, JobNotFound, PlacementNotFound, SettingsInvalid
from farfield.stages import Stage
from farfield.store import jobs
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse, StreamingResponse
from starlette.concurrency import run_in_threadpool

from farfield_api.answers import etag_of, matches
from farfield_api.auth import Reader
from farfield_api.documented import refusals
from farfield_api.errors import InputRefused
from farfield_api.export import body, export
from farfield_api.pages import file_inside
from farfield_api.paging import CursorText, Limit, cut, read_cursor
from farfield_api.replies.scenes import PlacementPageReply, PlacementReply
from farfield_api.slices import files_in, slice_response
from farfield_api.state import Service, State

router = APIRouter(prefix="/v1/placements", tags=["placements"])
_FILE: dict[str, Any] = {
    "description": "the file",
    "content": {kind: {"schema": {"type": "string", "format": "binary"}} for kind in
                ("application/octet-stream", "model/gltf-binary", "image/webp", "image/png", "image/jpeg", "image/ktx2")},
}  # fmt: skip
_FILE["content"]["application/json"] = {"schema": {}}

_NUMBER = r"[+-]?[0-9]{1,15}(\.[0-9]{0,15})?([eE][+-]?[0-9]{1,2})?"
VECTOR = f"^{_NUMBER},{_NUMBER},{_NUMBER}$"
IMMUTABLE = "private, max-age=31536000, immutable"
TYPES = {
    ".json": "application/json", ".glb": "model/gltf-binary", ".webp": "image/webp", ".png": "image/png",
    ".ktx2": "image/ktx2", ".jpg": "image/jpeg",
}  # fmt: skip


@router.get(
    "", summary="Placements to look at: registered folders, then jobs that are done, newest first",
    responses=refusals("CursorInvalid"),
)  # fmt: skip
def list_placements(
    caller: Reader, service: Service, cursor: CursorText = None, limit: Limit = 50
) -> PlacementPageReply:
    before = read_cursor(cursor)
    done = jobs.page(service.engine, caller.tenant_id, state="done", before=before, limit=limit + 1)
    rows, following = cut(done, limit)
    named = [PlacementReply(id=n, name=n, verdict=None) for n in service.settings.placements] if before is None else []
    listed = [PlacementReply(id=row.id, name=row.name, verdict=row.verdict) for row in rows]
    return PlacementPageReply(placements=[*named, *listed], next=following)


@router.get(
    "/{placement}/gltf", response_class=StreamingResponse, summary="The impostors as .glb, for other engines; If-None-Match",
    responses={200: {"description": "binary glTF 2.0: textured polygons, unlit, alpha masked (docs/export.md)",
                     "content": {"model/gltf-binary": {"schema": {"type": "string", "format": "binary"}}}},
               304: {"description": "as the client has it"},
               **refusals(PlacementNotFound, JobNotFinished, "NothingToExport", "OutsideViewSpace", "DirectionInvalid",
                          "ExportTooLarge", SettingsInvalid, InputRefused, "SceneOverLimit")},
)  # fmt: skip
async def export_gltf(
    placement: str, request: Request, caller: Reader, service: Service,
    cell: Annotated[int | None, Query(ge=0, description="only what the views of this cell show")] = None,
    position: Annotated[str | None, Query(pattern=VECTOR, description="X,Y,Z: only what is shown here, with direction")] = None,
    direction: Annotated[str | None, Query(pattern=VECTOR, description="X,Y,Z: looking along this")] = None,
    images: Annotated[Literal["png", "webp", "webp+png"], Query(description="format of the pictures")] = "png",
) -> Response:  # fmt: skip
    if cell is not None and position is not None:
        raise SettingsInvalid("cell", "is one way to choose, position and direction are another")
    source, stamp = await run_in_threadpool(_source, placement, caller, service)
    told = {"cell": cell, "position": position, "direction": direction, "images": images}
    options = [f"--{name}={value}" for name, value in told.items() if value is not None]
    headers = _headers(f"{stamp}/{version('farfield')}", f"gltf {' '.join(options)}", "private, no-cache")
    if matches(request.headers.get("if-none-match", ""), headers["etag"]):
        return Response(status_code=304, headers=headers)
    file = await export(service, source, "the placement", options)
    headers |= {
        "content-length": str(os.fstat(file.fileno()).st_size),
        "content-disposition": 'attachment; filename="impostors.glb"',
    }
    return StreamingResponse(body(file), headers=headers, media_type="model/gltf-binary")


@router.head("/{placement}/{path:path}", include_in_schema=False)
@router.get(
    "/{placement}/{path:path}", response_class=FileResponse, summary="A file of a placement; ranges, If-None-Match",
    responses={200: _FILE, 206: {**_FILE, "description": "the range that was asked for"},
               304: {"description": "as the client has it"}, 416: {"description": "no such range"},
               **refusals(PlacementNotFound, JobNotFinished)},
)  # fmt: skip
def show(placement: str, path: str, request: Request, caller: Reader, service: Service) -> Response:
    folder = service.settings.placements.get(placement)
    if folder is None:
        return _of_job(placement, path, request, caller, service)
    found = _inside(folder, path)
    if found is None:
        raise PlacementNotFound(placement, path)
    # The folder may be placed again under the same name; only names that hold a digest never change.
    caching = IMMUTABLE if re.search("[0-9a-f]{16}", Path(path).name) else "private, no-cache"
    headers = _headers(_stamp(found), path, caching)
    if matches(request.headers.get("if-none-match", ""), headers["etag"]):
        return Response(status_code=304, headers=headers)
    return FileResponse(found, headers=headers, media_type=_type(path))


def _source(placement: str, caller: Reader, service: State) -> tuple[Path | str, str]:
    """Return (folder or digest, what changes whenever the placement does)."""
    folder = service.settings.placements.get(placement)
    if folder is None:
        digest = _done(placement, caller, service)[1]
        return digest, digest
    manifest = _inside(folder, "manifest.json")
    if manifest is None:
        raise PlacementNotFound(placement, "manifest.json")
    return folder, _stamp(manifest)


def _done(job_id: str, caller: Reader, service: State) -> tuple[Any, str]:
    """Return the row of a job that is done, and its placement. Raises PlacementNotFound, JobNotFinished."""
    try:
        row = jobs.get(service.engine, caller.tenant_id, job_id)
    except JobNotFound:
        raise PlacementNotFound(job_id) from None
    digest = jobs.artifact_of(service.engine, job_id, Stage.PLACEMENTDB)
    if row.state != "done" or digest is None:
        raise JobNotFinished(job_id, row.state)
    return row, digest


def _of_job(job_id: str, path: str, request: Request, caller: Reader, service: State) -> Response:
    row, digest = _done(job_id, caller, service)
    if path == "report.json":
        digest, span = row.report_digest, None
    else:
        span = files_in(service.artifacts, digest).get(path if path == "scene.glb" else f"placement/{path}")
        if span is None:
            raise PlacementNotFound(job_id, path)
    headers = _headers(digest, path, IMMUTABLE)
    if matches(request.headers.get("if-none-match", ""), headers["etag"]):
        return Response(status_code=304, headers=headers)
    start, stop = span or (0, service.artifacts.n_bytes(digest))
    return slice_response(request, service.artifacts, digest, start, stop, media_type=_type(path), headers=headers)


def _headers(source: str, path: str, caching: str) -> dict[str, str]:
    return {"etag": etag_of(f"{source}/{path}".encode()), "cache-control": caching}


def _stamp(path: Path) -> str:
    status = path.stat()
    return f"{status.st_mtime_ns}.{status.st_size}.{status.st_ino}"


def _type(path: str) -> str:
    return TYPES.get(Path(path).suffix, "application/octet-stream")


def _inside(folder: Path, path: str) -> Path | None:
    """Return the file that `path` names: scene.glb and report.json at the top, all else in placement/."""
    return file_inside(folder if path in ("scene.glb", "report.json") else folder / "placement", path)
