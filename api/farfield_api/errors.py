"""One table from error to HTTP status; every refusal is an RFC 9457 problem with a code and what to do.

{"type": "urn:farfield:error:SceneEmpty", "title": "SceneEmpty", "status": 422, "code": "SceneEmpty",
 "detail": "what is wrong, and where", "advice": "what to do"}
"""

import errno
import logging
from collections.abc import Mapping
from typing import Any, ClassVar

from farfield import errors, logs
from farfield.errors import FailedElsewhere, FarfieldError
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from farfield_api.headers import HEADERS

log = logging.getLogger(__name__)
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class AccessError(FarfieldError):
    """The request may not do what it asks."""


class KeyMissing(AccessError):
    advice = "Send Authorization: Bearer KEY, or open the pages with a login link."

    def __init__(self) -> None:
        super().__init__("this needs an API key or a session")


class KeyUnknown(AccessError):
    advice = "Check the key; it may have been revoked, or the session may have ended."

    def __init__(self) -> None:
        super().__init__("the key, session or login link is not valid")


class ScopeMissing(AccessError):
    advice = "Use a key that has the scope."

    def __init__(self, scope: str) -> None:
        super().__init__(f"this needs the scope {scope}")


class CsrfMissing(AccessError):
    advice = "Send the csrf_token of GET /v1/session as X-CSRF-Token."

    def __init__(self) -> None:
        super().__init__("a change made with a session needs its CSRF token")


class UploadTooLarge(FarfieldError):
    advice = "Split the level, or ask the operator to raise the limit."

    def __init__(self, limit: int) -> None:
        super().__init__(f"the upload is larger than {limit} bytes")


class UploadAltered(FarfieldError):
    advice = "Send the file again."


class UploadCut(FarfieldError):
    """The line ended before the body did: nobody reads this answer."""

    advice = "Ask with HEAD how many bytes have arrived, and go on from there."

    def __init__(self) -> None:
        super().__init__("the connection ended before the file did")


class UploadStalled(FarfieldError):
    advice = "Ask with HEAD how many bytes have arrived, and go on from there."

    def __init__(self, seconds: float) -> None:
        super().__init__(f"hardly a byte has come for {seconds:g} s")


class UploadHeaderInvalid(FarfieldError):
    advice = "See https://tus.io/protocols/resumable-upload, version 1.0.0, and docs/recipes.md."


class TusVersionUnknown(FarfieldError):
    advice = "Send Tus-Resumable: 1.0.0."

    def __init__(self) -> None:
        super().__init__("the version of the tus protocol is 1.0.0")


class UploadTypeUnknown(FarfieldError):
    advice = "Send Content-Type: application/offset+octet-stream."

    def __init__(self) -> None:
        super().__init__("pieces of an upload come as application/offset+octet-stream")


class UploadOffsetWrong(FarfieldError):
    advice = "Ask with HEAD how many bytes have arrived, and go on from there."

    def __init__(self, offset: int, received: int) -> None:
        super().__init__(f"the bytes from {offset} on were sent, but {received} have arrived")


class UploadBusy(FarfieldError):
    advice = "Wait a second and ask again."

    def __init__(self) -> None:
        super().__init__("another request works on this upload")


class UploadChecksumWrong(FarfieldError):
    advice = "Send the piece again, from the same offset."

    def __init__(self) -> None:
        super().__init__("the bytes do not have the checksum of Upload-Checksum; none of them was kept")


class StoreFull(FarfieldError):
    advice = "Ask the operator to make room, then try again."

    def __init__(self) -> None:
        super().__init__("the service has no room left")


class TenantRefused(AccessError):
    advice = "Leave Farfield-Tenant out, or use an admin key of the operator."

    def __init__(self) -> None:
        super().__init__("this key acts in its own tenant only")


class TenantNeeded(FarfieldError):
    advice = "Name one tenant in Farfield-Tenant; * is for reading."

    def __init__(self) -> None:
        super().__init__("a change happens in one tenant")


class RateLimited(FarfieldError):
    advice = "Wait as long as Retry-After says, then go on; RateLimit-Policy says how much is allowed."

    def __init__(self, headers: Mapping[str, str], wait_s: int) -> None:
        super().__init__(f"too many requests with this key; go on in {wait_s} s")
        self.headers = {**headers, "retry-after": str(wait_s)}


class StreamsTooMany(FarfieldError):
    advice = "Close a stream, or read the events as JSON pages (Accept: application/json)."
    headers: ClassVar = {"retry-after": "15"}

    def __init__(self, most: int) -> None:
        super().__init__(f"{most} event streams of this key are open")


class PreconditionFailed(FarfieldError):
    advice = "Read it again, look at what has changed, and send If-Match with its new ETag."

    def __init__(self) -> None:
        super().__init__("it has changed since the ETag in If-Match was sent")


class DeviceBusy(FarfieldError):
    advice = "Nothing was kept: send the samples again in a few seconds, best all of them at once."
    headers: ClassVar = {"retry-after": "5"}

    def __init__(self) -> None:
        super().__init__("too many samples are being fitted")


class CursorInvalid(FarfieldError):
    advice = "Use the `next` of the page before, unchanged."

    def __init__(self) -> None:
        super().__init__("the cursor is not one of ours")


class InputRefused(FailedElsewhere):
    """What was sent was refused by the process that read it, under the name that this gave."""


STATUS: dict[type[FarfieldError], int] = {
    KeyMissing: 401,
    KeyUnknown: 401,
    AccessError: 403,
    UploadTooLarge: 413,
    UploadAltered: 422,
    UploadCut: 400,
    UploadStalled: 408,
    UploadHeaderInvalid: 400,
    TusVersionUnknown: 412,
    UploadTypeUnknown: 415,
    UploadOffsetWrong: 409,
    UploadBusy: 423,
    UploadChecksumWrong: 460,
    StoreFull: 507,
    CursorInvalid: 422,
    TenantNeeded: 422,
    DeviceBusy: 429,
    RateLimited: 429,
    StreamsTooMany: 429,
    PreconditionFailed: 412,
    errors.QuotaExceeded: 403,
    errors.RunningQuotaExceeded: 429,
    errors.WebhookError: 422,
    errors.TenantNotFound: 404,
    errors.KeyNotFound: 404,
    errors.WebhookNotFound: 404,
    errors.DeliveryNotFound: 404,
    errors.TenantExists: 409,
    errors.SceneInUse: 409,
    InputRefused: 422,
    errors.SceneError: 422,
    errors.SettingsInvalid: 422,
    errors.ImpostorError: 422,
    errors.PlacementFileError: 422,
    errors.CalibrationError: 422,
    errors.BaseUnfit: 422,
    errors.OutsideViewSpace: 422,
    errors.DirectionInvalid: 422,
    errors.ExportError: 422,
    errors.SceneNotFound: 404,
    errors.UploadNotFound: 404,
    errors.UploadsTooMany: 429,
    errors.JobNotFound: 404,
    errors.DeviceNotFound: 404,
    errors.PlacementNotFound: 404,
    errors.JobNotFinished: 409,
    errors.JobStillRunning: 409,
    errors.JobNotStopped: 409,
    errors.IdempotencyConflict: 409,
    errors.DeviceExists: 409,
    errors.ServiceError: 503,
    FarfieldError: 500,
}

MEDIA_TYPE = "application/problem+json"
RESPONSES: dict[int | str, dict[str, Any]] = {
    "default": {
        "description": "A problem (RFC 9457)",
        "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
    }
}
PROBLEM_SCHEMA = {
    "type": "object",
    "required": ["type", "title", "status", "code", "detail"],
    "properties": {
        "type": {"type": "string"}, "title": {"type": "string"}, "status": {"type": "integer"},
        "code": {"type": "string", "description": "the error's stable name"},
        "detail": {"type": "string", "description": "what is wrong, and where"},
        "advice": {"type": "string", "description": "what to do"},
        "request_id": {"type": ["string", "null"], "description": "what the operator finds it by in the logs"},
        "key": {"type": "string", "description": "the setting's dotted name, for SettingsInvalid"},
        "errors": {"type": "array", "items": {"type": "object"}, "description": "for RequestInvalid: where and what"},
    },
}  # fmt: skip


def status_of(error: FarfieldError) -> int:
    """Return the status of the nearest ancestor in the table."""
    return next(STATUS[cls] for cls in type(error).__mro__ if cls in STATUS)


def problem(status: int, code: str, detail: str, advice: str = "", **more: Any) -> JSONResponse:
    """Return a problem as a response."""
    body: dict[str, Any] = {
        "type": f"urn:farfield:error:{code}",
        "title": code,
        "status": status,
        "code": code,
        "detail": detail,
    }
    headers = {"WWW-Authenticate": "Bearer"} if status == 401 else {}
    body |= {"advice": advice, "request_id": logs.known("request")}
    return JSONResponse({**body, **more}, status, headers, media_type=MEDIA_TYPE)


def add_handlers(app: FastAPI) -> None:
    """Make every error that leaves a route a problem."""

    @app.exception_handler(FarfieldError)
    async def named(request: Request, error: FarfieldError) -> JSONResponse:
        status = status_of(error)
        more = {"key": error.key} if isinstance(error, errors.SettingsInvalid) else {}
        if status == 500:
            log.error("%s %s: %s: %s", request.method, request.url.path, error.code, error)
        answer = problem(status, error.code, str(error), error.advice, **more)
        answer.headers.update(getattr(error, "headers", {}))
        if isinstance(error, errors.RunningQuotaExceeded):
            answer.headers["retry-after"] = "30"
        return answer

    @app.exception_handler(OSError)
    async def full(request: Request, error: OSError) -> JSONResponse:
        if error.errno not in NO_ROOM:
            raise error
        log.error("%s %s: %s", request.method, request.url.path, error)
        return await named(request, StoreFull())

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        found = [{"where": ".".join(map(str, e["loc"])), "what": e["msg"]} for e in error.errors()]
        text = "; ".join(f"{e['where']}: {e['what']}" for e in found)
        if all(e["loc"][0] == "path" for e in error.errors()):  # what nothing can be called is not there
            return problem(404, "NotFound", f"there is nothing at {request.url.path}", errors=found)
        return problem(422, "RequestInvalid", text, "See /v1/openapi.json for the form of the request.", errors=found)

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> JSONResponse:
        codes = {404: "NotFound", 405: "MethodNotAllowed", 413: "RequestTooLarge"}
        answer = problem(error.status_code, codes.get(error.status_code, "RequestRefused"), str(error.detail))
        answer.headers.update(error.headers or {})
        return answer

    @app.exception_handler(Exception)
    async def unexpected(request: Request, error: Exception) -> JSONResponse:
        log.exception("%s %s", request.method, request.url.path, exc_info=error)
        answer = problem(500, "Unexpected", "the service failed", "Try again; tell the operator when it happened.")
        # This answer is made outside of all middleware.
        answer.headers.update({**HEADERS, "x-request-id": str(logs.known("request"))})
        return answer
