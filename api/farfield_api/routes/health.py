"""Is it alive, is it ready, what does it do: /livez, /readyz, /metrics."""

import logging
from typing import Any

from fastapi import APIRouter, Request, Response
from fastapi.responses import JSONResponse
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest

from farfield_api.auth import Operator
from farfield_api.errors import RESPONSES
from farfield_api.readiness import shown
from farfield_api.state import Service

router = APIRouter(tags=["health"], responses=RESPONSES)
log = logging.getLogger(__name__)

_READY: dict[int | str, dict[str, Any]] = {
    200: {"description": "`ready`, or `degraded`: requests are answered, jobs may wait; `checks` says why"},
    503: {"description": "`not ready`; `checks` says why"},
}


@router.get("/livez", summary="The process answers")
async def livez() -> dict[str, str]:
    return {"status": "alive"}


@router.get("/readyz", responses=_READY, summary="Database, migrations, store, broker and workers, each checked now")
def readyz(service: Service, strict: bool = False) -> JSONResponse:
    answer = service.readiness.ask()
    if answer.status != "ready":
        log.warning("%s: %s", answer.status, {name: text for name, text in answer.checks.items() if text != "ok"})
    bad = answer.status == "not ready" or (strict and answer.status == "degraded")
    return JSONResponse(shown(answer), 503 if bad else 200, headers={"cache-control": "no-store"})


@router.get("/metrics", response_class=Response, summary="Prometheus metrics; for admins of the operator's tenant")
def metrics(caller: Operator, request: Request) -> Response:
    return Response(generate_latest(request.app.state.registry), media_type=CONTENT_TYPE_LATEST)
