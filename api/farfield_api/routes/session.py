"""Sessions of the pages: a cookie from a key or a one-time login link.

A link reads /open#login=TOKEN&to=/viewer/NAME. A fragment never leaves the browser by itself, so the token stands in no
log and no Referer; the page at /open posts it here, once, and goes on to its target.
"""

from typing import Annotated, Any

from farfield.store import tenants
from farfield.store.tenants import Caller
from fastapi import APIRouter, Depends, Request, Response
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from farfield_api.auth import COOKIE, Reader, authenticate, csrf_token, expiry_of_session, make_session
from farfield_api.documented import refusals
from farfield_api.errors import RESPONSES, KeyMissing, KeyUnknown
from farfield_api.state import Service, State


def authenticated(request: Request, service: Service) -> Caller:
    return authenticate(request, service)


router = APIRouter(prefix="/v1", tags=["session"], responses=RESPONSES)


class Opening(BaseModel):
    """One of the two."""

    key: str | None = Field(None, max_length=200, description="an API key")
    login: str | None = Field(None, max_length=200, description="the token of a login link")


class Target(BaseModel):
    to: str = Field(
        "/jobs", pattern=r"^/([A-Za-z0-9._~-][A-Za-z0-9._~/-]*)?$", max_length=500, description="the page to open"
    )


@router.post("/session", summary="Start a session: sets the cookie", responses=refusals("KeyMissing", "KeyUnknown"))
async def start(opening: Opening, request: Request, response: Response, service: Service) -> dict[str, Any]:
    if opening.key is not None:
        caller = await run_in_threadpool(tenants.caller_of_key, service.engine, opening.key)
    elif opening.login is not None:
        caller = await run_in_threadpool(tenants.redeem_login, service.engine, opening.login)
    else:
        raise KeyMissing
    if caller is None:
        raise KeyUnknown
    request.state.caller = caller  # for the audit log
    session = make_session(service.settings.secret, caller.key_id, service.settings.session_s)
    response.set_cookie(
        COOKIE, session, max_age=service.settings.session_s, httponly=True, samesite="strict",
        secure=request.url.scheme == "https", path="/",
    )  # fmt: skip
    return _told(service, caller, session)


@router.get("/session", summary="Who am I, and the CSRF token of this session")
def show(caller: Reader, request: Request, service: Service) -> dict[str, Any]:
    return _told(service, caller, request.cookies.get(COOKIE))


@router.delete("/session", status_code=204, summary="End the session, wherever its cookie is")
def end(caller: Annotated[Caller, Depends(authenticated)], request: Request, service: Service) -> Response:
    cookie = request.cookies.get(COOKIE)
    if caller.session is not None and cookie is not None:
        tenants.end_session(service.engine, caller.session, expires_at=expiry_of_session(cookie))
    response = Response(status_code=204)
    response.delete_cookie(COOKIE, path="/", httponly=True, samesite="strict")
    return response


@router.post("/logins", status_code=201, summary="Make a link that opens a page once without typing a key")
def make_login(target: Target, caller: Reader, request: Request, service: Service) -> dict[str, str]:
    token = tenants.create_login(service.engine, caller.key_id)
    return {"url": f"{str(request.base_url).rstrip('/')}/open#login={token}&to={target.to}"}


def _told(service: State, caller: Caller, session: str | None) -> dict[str, Any]:
    token = csrf_token(service.settings.secret, session) if session is not None else None
    return {"tenant": caller.tenant_id, "scopes": sorted(caller.scopes), "csrf_token": token}
