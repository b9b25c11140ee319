"""What is seen of every request: an id, a line in the log, and metrics by route; the outermost layer of the app.

Id       `X-Request-ID` of the caller where it is a plain word, else 16 random hex digits; in every answer, in every problem, and
         in every line that the request writes.
Labels   The route's template, never a path: what clients choose must not make series. Streams of events are counted, and
         not timed: they last as long as somebody watches.
"""

import logging
import re
import secrets
import time
from typing import Any

from farfield import logs
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram
from starlette.types import ASGIApp, Message, Receive, Scope, Send

log = logging.getLogger("farfield_api.access")

HEADER = b"x-request-id"
METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
QUIET = ("/livez", "/readyz", "/metrics")  # asked every few seconds: in the log only where they fail
BUCKETS_S = (0.005, 0.02, 0.1, 0.5, 2.0, 10.0, 60.0)


class HttpMetrics:
    """The counters of one API process."""

    def __init__(self, registry: CollectorRegistry) -> None:
        route = ("method", "route")
        self.requests = Counter(
            "farfield_http_requests", "Requests answered, by status.", (*route, "status"), registry=registry
        )
        self.seconds = Histogram(
            "farfield_http_request_seconds", "From the request's first byte to the answer's last, streams left out.",
            route, buckets=BUCKETS_S, registry=registry,
        )  # fmt: skip
        self.sent = Counter("farfield_http_sent_bytes", "Bytes of answers.", ("route",), registry=registry)
        self.received = Counter("farfield_http_received_bytes", "Bytes of requests.", ("route",), registry=registry)
        self.running = Gauge("farfield_http_requests_running", "Requests being answered.", registry=registry)
        self.streams = Gauge("farfield_open_streams", "Event streams that are open.", registry=registry)


class Observe:
    """Wraps the app: see the module."""

    def __init__(self, app: ASGIApp, metrics: HttpMetrics) -> None:
        self.app, self.metrics = app, metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        seen = _Seen(request_id(scope))
        logs.say(request=seen.id)
        with self.metrics.running.track_inprogress():
            try:
                await self.app(scope, seen.receiving(receive), seen.sending(send, self.metrics))
            except BaseException:
                seen.status = seen.status or 500
                raise
            finally:
                self._note(scope, seen)

    def _note(self, scope: Scope, seen: "_Seen") -> None:
        seconds = time.perf_counter() - seen.started
        method = scope["method"] if scope["method"] in METHODS else "OTHER"
        route = template(scope)
        status = seen.status or 499  # the client went away before an answer
        self.metrics.requests.labels(method, route, str(status)).inc()
        self.metrics.sent.labels(route).inc(seen.sent)
        self.metrics.received.labels(route).inc(seen.received)
        if seen.stream:
            self.metrics.streams.dec()
        else:
            self.metrics.seconds.labels(method, route).observe(seconds)
        if route in QUIET and status < 400:
            return
        path = scope.get("path_params", {})
        fields = {
            "method": method, "path": scope["path"], "status": status, "seconds": round(seconds, 4),
            "sent_bytes": seen.sent, "received_bytes": seen.received or None, "job": path.get("job_id"),
            "tenant": seen.tenant(scope),
        }  # fmt: skip
        log.log(logging.WARNING if status >= 500 else logging.INFO, "request", extra={"fields": fields})


class _Seen:
    """One request on its way."""

    def __init__(self, request: str) -> None:
        self.id, self.started = request, time.perf_counter()
        self.status, self.sent, self.received, self.stream = 0, 0, 0, False

    def receiving(self, receive: Receive) -> Receive:
        async def counted() -> Message:
            message = await receive()
            self.received += len(message.get("body", b""))
            return message

        return counted

    def sending(self, send: Send, metrics: HttpMetrics) -> Send:
        async def counted(message: Message) -> None:
            if message["type"] == "http.response.start":
                self.status = message["status"]
                headers = message.get("headers", [])
                self.stream = any(k == b"content-type" and v.startswith(b"text/event-stream") for k, v in headers)
                if self.stream:
                    metrics.streams.inc()
                kept = [pair for pair in headers if pair[0] != HEADER]
                message["headers"] = [*kept, (HEADER, self.id.encode())]
            elif message["type"] == "http.response.body":
                self.sent += len(message.get("body", b""))
            await send(message)

        return counted

    def tenant(self, scope: Scope) -> Any:
        return getattr(scope.get("state", {}).get("caller"), "tenant_id", None)


def request_id(scope: Scope) -> str:
    """Return the caller's id of the request, or a new one."""
    given = dict(scope["headers"]).get(HEADER, b"").decode("latin-1")
    return given if re.fullmatch(r"[\w.-]{1,64}", given, re.ASCII) else secrets.token_hex(8)


def template(scope: Scope) -> str:
    """Return the route's template, "none" where no route answered."""
    return getattr(scope.get("route"), "path", None) or "none"
