"""Makes the app: state, routes, errors, pages."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

from farfield.store.artifacts import open_artifacts
from farfield.store.engine import open_engine
from fastapi import FastAPI
from prometheus_client import CollectorRegistry, start_http_server
from starlette.middleware.trustedhost import TrustedHostMiddleware

from farfield_api.answers import Conditional, Gzip
from farfield_api.cluster_metrics import ClusterMetrics
from farfield_api.documented import describe
from farfield_api.errors import add_handlers
from farfield_api.headers import SecurityHeaders
from farfield_api.key_use import KeyUse
from farfield_api.observe import HttpMetrics, Observe
from farfield_api.pages import add_pages
from farfield_api.queue import Queue
from farfield_api.rates import RateLimits
from farfield_api.readiness import Readiness
from farfield_api.resumable import keep_swept
from farfield_api.routes import (
    audit,
    devices,
    events,
    health,
    jobs,
    keys,
    operations,
    placements,
    scenes,
    session,
    tenants,
    uploads,
    webhooks,
)
from farfield_api.settings import ApiSettings
from farfield_api.state import State
from farfield_api.streams import EventPoller
from farfield_api.trail import Trail

MAX_JSON_BYTES = 1 << 20
OPEN = {("GET", "/livez"), ("GET", "/readyz"), ("POST", "/v1/session")}  # need no key


def make_app(settings: ApiSettings) -> FastAPI:
    """Return the app. It opens the database, and neither makes nor migrates it."""
    engine = open_engine(settings.database_url)
    artifacts = open_artifacts(settings.artifacts, cache=settings.cache, cache_bytes=settings.cache_bytes)
    queue = Queue(settings.broker_url, engine)
    state = State(
        settings=settings, engine=engine, artifacts=artifacts, queue=queue,
        poller=EventPoller(engine, settings.poll_s),
        readiness=Readiness(engine, artifacts, queue.check, settings.migrations),
        rates=RateLimits(read=settings.rate_read, write=settings.rate_write, store=settings.rate_store),
        key_use=KeyUse(engine),
    )  # fmt: skip
    registry = CollectorRegistry()
    cluster = ClusterMetrics(engine, artifacts, state.readiness)
    registry.register(cluster)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        running = [asyncio.create_task(task) for task in (state.poller.run(), keep_swept(state), state.key_use.run())]
        server = None
        if settings.metrics_port is not None:
            server, _ = start_http_server(settings.metrics_port, settings.metrics_host, registry)
        yield
        if server is not None:
            server.shutdown()
        state.readiness.close()
        state.key_use.write()
        for task in running:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
        engine.dispose()

    app = FastAPI(
        title="farfield", version="1", lifespan=lifespan, docs_url=None, redoc_url=None,
        openapi_url="/v1/openapi.json", max_body_size=MAX_JSON_BYTES,
    )  # fmt: skip
    app.state.farfield, app.state.registry, app.state.cluster = state, registry, cluster
    app.add_middleware(Trail, engine=engine)
    app.add_middleware(Conditional)
    app.add_middleware(Gzip)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=list(settings.hosts))
    app.add_middleware(SecurityHeaders)  # the outer one: what the other refuses has the headers, too
    app.add_middleware(Observe, metrics=HttpMetrics(registry))
    add_handlers(app)
    for routes in (
        health,
        operations,
        session,
        scenes,
        uploads,
        jobs,
        events,
        placements,
        devices,
        tenants,
        keys,
        webhooks,
        audit,
    ):
        app.include_router(routes.router)
    add_pages(app, settings.web)
    _describe(app)
    return app


def _describe(app: FastAPI) -> None:
    plain = app.openapi

    def described() -> dict[str, Any]:
        if app.openapi_schema is None:
            describe(plain(), OPEN)
        assert app.openapi_schema is not None
        return app.openapi_schema

    app.openapi = described  # type: ignore[method-assign]
