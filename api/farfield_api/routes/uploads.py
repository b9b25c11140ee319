"""Uploads that resume: tus 1.0.0 (core, creation, creation-with-upload, checksum, expiration, termination), and as JSON.

Why our own and not a library: docs/decisions/0014-our-own-tus.md.
"""

from base64 import b64decode, b64encode
from binascii import Error as NotBase64
from collections.abc import Callable, Coroutine
from email.utils import formatdate
from typing import Annotated, Any, Literal

import sqlalchemy as sa
from farfield.errors import FarfieldError
from farfield.store import uploads
from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool

from farfield_api import resumable
from farfield_api.auth import Reader, Submitter
from farfield_api.documented import refusals
from farfield_api.errors import RESPONSES, TusVersionUnknown, UploadHeaderInvalid, UploadTooLarge, UploadTypeUnknown
from farfield_api.replies.common import DIGEST
from farfield_api.replies.uploads import UploadLinks, UploadListReply, UploadProblem, UploadReply
from farfield_api.state import Service
from farfield_api.times import iso
from farfield_api.upload import plain_name

VERSION = "1.0.0"
EXTENSIONS = "creation,creation-with-upload,checksum,expiration,termination"
PIECE = "application/offset+octet-stream"
UNLIMITED = 1 << 50  # no limit: what counts is the upload's own length


class TusRoute(APIRoute):
    """Every answer names the version of the protocol, a refusal, too."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        plain = super().get_route_handler()

        async def handler(request: Request) -> Response:
            try:
                answer = await plain(request)
            except FarfieldError as error:
                answer = await request.app.exception_handlers[FarfieldError](request, error)
            answer.headers["tus-resumable"] = VERSION
            return answer

        return handler


def _version(tus_resumable: Annotated[str | None, Header(description="1.0.0")] = None) -> None:
    if tus_resumable != VERSION:
        raise TusVersionUnknown


Tus = Depends(_version)
router = APIRouter(prefix="/v1/uploads", tags=["uploads"], responses=RESPONSES, route_class=TusRoute)
_NONE = refusals("UploadNotFound")
_PIECE_BODY = {
    "requestBody": {"content": {PIECE: {"schema": {"type": "string", "format": "binary"}}}, "required": False}
}


@router.options("", status_code=204, summary="What of tus is spoken here")
def options(response: Response, caller: Reader, service: Service) -> None:
    response.headers["tus-version"] = VERSION
    response.headers["tus-extension"] = EXTENSIONS
    response.headers["tus-max-size"] = str(service.settings.max_scene_bytes)
    response.headers["tus-checksum-algorithm"] = ",".join(resumable.CHECKSUMS)


@router.post(
    "", status_code=201, dependencies=[Tus], max_body_size=UNLIMITED, openapi_extra=_PIECE_BODY, response_class=Response,
    summary="Start an upload; the answer's Location is where its bytes go",
    responses={201: {"description": "started", "content": {}},
               **refusals("TusVersionUnknown", "UploadHeaderInvalid", "UploadTooLarge", "UploadsTooMany", "StoreFull",
                          "QuotaExceeded")},
)  # fmt: skip
async def create(
    request: Request,
    caller: Submitter,
    service: Service,
    upload_length: Annotated[int | None, Header(ge=1, description="bytes of the whole file")] = None,
    upload_metadata: Annotated[
        str | None, Header(description="`filename BASE64,sha256 BASE64`: the file's name, and the digest it shall have")
    ] = None,
    content_type: Annotated[str | None, Header(include_in_schema=False)] = None,
) -> Response:
    if upload_length is None:
        raise UploadHeaderInvalid("Upload-Length is missing; a length that is told later is not read")
    if upload_length > service.settings.max_scene_bytes:
        raise UploadTooLarge(service.settings.max_scene_bytes)
    told = _metadata(upload_metadata or "")
    digest = told.get("sha256", "").lower() or None
    if digest is not None and not (len(digest) == 64 and set(digest) <= set("0123456789abcdef")):
        raise UploadHeaderInvalid(
            "sha256 in Upload-Metadata is the SHA-256 of the file as 64 hexadecimal digits, in base64"
        )
    await run_in_threadpool(resumable.need_room, service, upload_length)
    await run_in_threadpool(resumable.need_quota, service, caller.tenant_id, upload_length, digest)
    upload_id = await run_in_threadpool(
        lambda: uploads.create(
            service.engine, caller.tenant_id, name=plain_name(told.get("filename", "")), n_bytes=upload_length,
            digest=digest, lifetime_s=service.settings.upload_s, most=service.settings.open_uploads,
        )
    )  # fmt: skip
    row = await run_in_threadpool(uploads.get, service.engine, caller.tenant_id, upload_id)
    if content_type == PIECE:
        row = await resumable.append(request, service, row, 0)
    return Response(status_code=201, headers={**_headers(row), "location": f"/v1/uploads/{upload_id}"})


@router.get("", summary="The tenant's uploads; those with most bytes first")
def list_uploads(
    caller: Reader,
    service: Service,
    sha256: Annotated[str | None, Query(pattern=DIGEST, description="only those of the file with this digest")] = None,
    limit: Annotated[int, Query(ge=1, le=200)] = 50,
) -> UploadListReply:
    rows = uploads.page(service.engine, caller.tenant_id, digest=sha256, limit=limit)
    return UploadListReply(uploads=[_shown(row) for row in rows])


@router.get(
    "/{upload_id}", summary="How far an upload is, and the scene that it became or why it was refused", responses=_NONE
)
def show(upload_id: str, caller: Reader, service: Service) -> UploadReply:
    return _shown(uploads.get(service.engine, caller.tenant_id, upload_id))


@router.head(
    "/{upload_id}", dependencies=[Tus], response_class=Response,
    summary="How many bytes have arrived: Upload-Offset; 410 for a file that was refused",
    responses={200: {"description": "going on", "content": {}}, 410: {"description": "the file was refused", "content": {}},
               **refusals("UploadNotFound", "TusVersionUnknown")},
)  # fmt: skip
def head(upload_id: str, caller: Reader, service: Service) -> Response:
    row = uploads.get(service.engine, caller.tenant_id, upload_id)
    name = b64encode(row.name.encode()).decode()
    more = {"upload-length": str(row.n_bytes), "cache-control": "no-store", "upload-metadata": f"filename {name}"}
    return Response(status_code=200 if row.refusal is None else 410, headers={**_headers(row), **more})


@router.patch(
    "/{upload_id}", status_code=204, dependencies=[Tus], max_body_size=UNLIMITED, openapi_extra=_PIECE_BODY,
    response_class=Response, summary="Add the bytes from Upload-Offset on; with the last one the scene is read",
    responses=refusals(
        "UploadNotFound", "TusVersionUnknown", "UploadHeaderInvalid", "UploadTypeUnknown", "UploadOffsetWrong",
        "UploadTooLarge", "UploadBusy", "UploadStalled", "UploadChecksumWrong", "UploadAltered", "SceneUnreadable",
        "SceneOverLimit", "StoreFull", "QuotaExceeded",
    ),
)  # fmt: skip
async def add(
    upload_id: str,
    request: Request,
    caller: Submitter,
    service: Service,
    upload_offset: Annotated[int | None, Header(ge=0, description="what HEAD answered")] = None,
    upload_checksum: Annotated[
        str | None, Header(description="`sha256 BASE64` or `sha1 BASE64` of this body: kept only if it agrees")
    ] = None,
    content_type: Annotated[str | None, Header(include_in_schema=False)] = None,
) -> Response:
    if content_type != PIECE:
        raise UploadTypeUnknown
    if upload_offset is None:
        raise UploadHeaderInvalid("Upload-Offset is missing")
    row = await run_in_threadpool(uploads.get, service.engine, caller.tenant_id, upload_id)
    resumable.ended(row)
    row = await resumable.append(request, service, row, upload_offset)
    return Response(status_code=204, headers=_headers(row))


@router.delete(
    "/{upload_id}", status_code=204, dependencies=[Tus], summary="Give an upload up; its bytes are removed",
    responses=refusals("UploadNotFound", "TusVersionUnknown"),
)  # fmt: skip
def remove(upload_id: str, caller: Submitter, service: Service) -> None:
    resumable.forget(service, uploads.get(service.engine, caller.tenant_id, upload_id).id)


def _metadata(header: str) -> dict[str, str]:
    """Return the pairs of Upload-Metadata. Raises UploadHeaderInvalid."""
    found = {}
    for pair in filter(None, (p.strip() for p in header.split(","))):
        key, _, value = pair.partition(" ")
        try:
            found[key] = b64decode(value.strip(), validate=True).decode("utf-8", "replace")
        except (NotBase64, ValueError) as error:
            raise UploadHeaderInvalid(f"the value of {key[:40]} in Upload-Metadata is not base64") from error
    return found


def _headers(row: sa.Row[Any]) -> dict[str, str]:
    told = {"upload-offset": str(row.received), "upload-expires": formatdate(row.expires_at, usegmt=True)}
    if row.scene_digest is not None:
        told["content-location"] = f"/v1/scenes/{row.scene_digest}"
    return told


def _shown(row: sa.Row[Any]) -> UploadReply:
    waits: Literal["reading", "open"] = "reading" if row.received == row.n_bytes else "open"
    scene = f"/v1/scenes/{row.scene_digest}" if row.scene_digest is not None else None
    return UploadReply(
        id=row.id, name=row.name, state="refused" if row.refusal else "done" if row.scene_digest else waits,
        bytes=row.n_bytes, received=row.received, sha256=row.digest, scene=row.scene_digest,
        problem=UploadProblem(**row.refusal) if row.refusal else None, created_at=str(iso(row.created_at)),
        expires_at=str(iso(row.expires_at)), links=UploadLinks(self=f"/v1/uploads/{row.id}", scene=scene),
    )  # fmt: skip
