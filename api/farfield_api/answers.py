"""What every answer under /v1 gets: a strong ETag and 304, Cache-Control and Vary, what is left of the rate limit; and gzip.

ETag      Of JSON that is sent whole: a digest of its bytes. Files have theirs already. A compressed answer is another
          representation and has another ETag, `"...-gzip"`; what a client sends back is understood either way.
gzip      For text of a kilobyte and more, where it is asked for. Never for a range or what answers one, for event streams,
          for what is encoded already (WebP, PNG, GLB, the binary files of a placement), or for answers that hold secrets.
"""

import hashlib
import re
import zlib

from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from farfield_api.rates import Rate

TEXT = re.compile(r"application/(json|problem\+json|javascript|manifest\+json)\b|text/(?!event-stream)|image/svg\+xml")
LEAST_BYTES = 1024
INLINE_BYTES = 32 << 10  # more is compressed in a thread
LEVEL = 5
WHO = "Authorization, Cookie, Farfield-Tenant"
SUFFIX = "-gzip"


def etag_of(body: bytes) -> str:
    """Return a strong ETag of these bytes."""
    return f'"{hashlib.sha256(body).hexdigest()[:32]}"'


def matches(header: str, etag: str) -> bool:
    """Say whether an If-None-Match or If-Match names the ETag; a weak one counts, ours are all strong."""
    named = [part.strip().removeprefix("W/") for part in header.split(",")]
    return "*" in named or etag in named


class Conditional:
    """Wraps the app: ETags, 304, default caching, rate limit headers."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or not scope["path"].startswith("/v1/"):
            await self.app(scope, receive, send)
            return
        state = scope.setdefault("state", {})
        held: Message | None = None

        async def telling(message: Message) -> None:
            nonlocal held
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=list(message.get("headers", ())))
                headers.setdefault("cache-control", "private, no-cache")
                headers["vary"] = _joined(headers.get("vary", ""), WHO)
                rate = state.get("rate")
                if isinstance(rate, Rate):
                    headers.update(rate.headers)
                message = {**message, "headers": headers.raw}
                if _tagged(scope["method"], message["status"], headers):
                    held = message
                    return
            elif held is not None:
                start, held = held, None
                if not message.get("more_body", False):
                    start, message = _conditional(scope, start, message)
                await send(start)
            await send(message)

        await self.app(scope, receive, telling)


def _tagged(method: str, status: int, headers: Headers) -> bool:
    plain = headers.get("content-type", "").startswith("application/json")
    return method in ("GET", "HEAD") and status == 200 and plain and "no-store" not in headers["cache-control"]


def _conditional(scope: Scope, start: Message, message: Message) -> tuple[Message, Message]:
    headers = MutableHeaders(raw=start["headers"])
    if not message.get("body"):  # HEAD, where the route leaves the body out
        return start, message
    if "etag" not in headers:
        headers["etag"] = etag_of(message["body"])
    if matches(Headers(scope=scope).get("if-none-match", ""), headers["etag"]):
        for name in ("content-length", "content-type"):
            del headers[name]
        return {**start, "status": 304, "headers": headers.raw}, {**message, "body": b""}
    return {**start, "headers": headers.raw}, message


class Gzip:
    """Wraps the app: see the module."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        asked = Headers(scope=scope)
        wanted = accepts_gzip(asked.get("accept-encoding", "")) and scope["method"] != "HEAD" and "range" not in asked
        named = _take_suffix(scope)
        packing = None

        async def packed(message: Message) -> None:
            nonlocal packing
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=list(message.get("headers", ())))
                if wanted and _worth(message["status"], headers):
                    packing = zlib.compressobj(LEVEL, zlib.DEFLATED, 31)
                    headers["content-encoding"] = "gzip"
                    del headers["content-length"]
                    del headers["accept-ranges"]
                if packing is not None or (message["status"] == 304 and named):
                    _suffix(headers)
                if TEXT.match(headers.get("content-type", "")) or message["status"] == 304:
                    headers["vary"] = _joined(headers.get("vary", ""), "Accept-Encoding")
                message = {**message, "headers": headers.raw}
            elif message["type"] == "http.response.body" and packing is not None:
                data, more = message.get("body", b""), message.get("more_body", False)
                if len(data) > INLINE_BYTES:
                    data = await run_in_threadpool(packing.compress, data)
                else:
                    data = packing.compress(data)
                message = {**message, "body": data if more else data + packing.flush()}
            await send(message)

        await self.app(scope, receive, packed)


def accepts_gzip(header: str) -> bool:
    """Say whether an Accept-Encoding takes gzip."""
    weights: dict[str, float] = {}
    for part in header.lower().split(","):
        name, *parameters = (piece.strip() for piece in part.split(";"))
        weight = next((p[2:] for p in parameters if p.startswith("q=")), "1")
        weights[name] = float(weight) if re.fullmatch(r"[01](\.[0-9]{0,3})?", weight) else 0.0
    return weights.get("gzip", weights.get("*", 0.0)) > 0.0


def _worth(status: int, headers: Headers) -> bool:
    length = headers.get("content-length", "")
    return (
        status not in (204, 206, 304)
        and TEXT.match(headers.get("content-type", "")) is not None
        and "content-encoding" not in headers
        and "no-store" not in headers.get("cache-control", "")
        and not (length.isdigit() and int(length) < LEAST_BYTES)
    )


def _suffix(headers: MutableHeaders) -> None:
    etag = headers.get("etag", "")
    if etag.endswith('"') and not etag.endswith(f'{SUFFIX}"'):
        headers["etag"] = f'{etag[:-1]}{SUFFIX}"'


def _take_suffix(scope: Scope) -> bool:
    """Take our suffix from the ETags that the request names, and say whether there was one.

    If-Range keeps it: a range of the plain bytes is none of the compressed ones.
    """
    found, headers = False, []
    for name, value in scope["headers"]:
        if name in (b"if-none-match", b"if-match") and f'{SUFFIX}"'.encode() in value:
            value, found = value.replace(f'{SUFFIX}"'.encode(), b'"'), True
        headers.append((name, value))
    scope["headers"] = headers
    return found


def _joined(vary: str, more: str) -> str:
    names = {name.strip().lower(): name.strip() for name in f"{vary},{more}".split(",") if name.strip()}
    return ", ".join(names.values())
