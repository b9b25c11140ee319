"""Who asks: an API key in a header, or a session cookie made from a key or a login link.

Session  "KEYID.EXPIRES.NONCE.MAC": signed, HttpOnly, same-site; it ends when its key is revoked, or when its owner logs out:
         then its digest is in a table that every session is looked up in. A request that changes something and comes with a
         cookie also needs X-CSRF-Token, which only our own pages can read.
"""

import hashlib
import hmac
import secrets
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated

from farfield.store import tenants
from farfield.store.pages import ALL
from farfield.store.tenants import Caller
from fastapi import Depends, Request

from farfield_api.errors import CsrfMissing, KeyMissing, KeyUnknown, ScopeMissing, TenantNeeded, TenantRefused
from farfield_api.state import Service, State

COOKIE = "farfield_session"
SAFE = ("GET", "HEAD", "OPTIONS")


def _mac(secret: str, purpose: str, text: str) -> str:
    return hmac.new(bytes.fromhex(secret), f"{purpose}:{text}".encode(), hashlib.sha256).hexdigest()


def make_session(secret: str, key_id: str, lifetime_s: int) -> str:
    """Return the cookie of a new session."""
    text = f"{key_id}.{int(time.time()) + lifetime_s}.{secrets.token_hex(8)}"
    return f"{text}.{_mac(secret, 'session', text)}"


def csrf_token(secret: str, session: str) -> str:
    """Return the token that goes with this session."""
    return _mac(secret, "csrf", session)


def key_of_session(secret: str, session: str) -> str | None:
    """Return the id of the key that the session was made from; None where it is forged or over."""
    text, _, mac = session.rpartition(".")
    key_id, expires, *_ = f"{text}.".split(".")
    genuine = hmac.compare_digest(mac.encode(), _mac(secret, "session", text).encode())
    return key_id if genuine and expires.isdigit() and int(expires) > time.time() else None


def expiry_of_session(session: str) -> float:
    """Return when a genuine session ends by itself, in seconds since 1970 UTC."""
    return float(session.split(".")[1])


def authenticate(request: Request, service: State) -> Caller:
    """Return who asks, counted against the limits of the key, and in which tenant.

    An admin of the operator's tenant acts in the tenant that the header Farfield-Tenant names; with * it reads what
    all of them have. Raises KeyMissing, KeyUnknown, CsrfMissing, RateLimited, TenantRefused, TenantNotFound, TenantNeeded.
    """
    caller = _holder(request, service)
    request.state.caller = caller
    service.key_use.note(caller.key_id)
    safe = request.method in SAFE
    request.state.rate = service.rates.spend(caller.key_id, name="read" if safe else "write")
    named = request.headers.get("farfield-tenant", caller.tenant_id)
    if named != caller.tenant_id:
        if not (caller.operator and "admin" in caller.scopes):
            raise TenantRefused
        if named != ALL:
            tenants.get_tenant(service.engine, named)
        elif not safe:
            raise TenantNeeded
        caller = replace(caller, tenant_id=named)
        request.state.caller = caller
    return caller


def _holder(request: Request, service: State) -> Caller:
    header = request.headers.get("authorization")
    if header is not None:
        scheme, _, key = header.partition(" ")
        caller = tenants.caller_of_key(service.engine, key.strip()) if scheme.lower() == "bearer" else None
        if caller is None:
            raise KeyUnknown
        return caller
    session = request.cookies.get(COOKIE)
    if session is None:
        raise KeyMissing
    key_id = key_of_session(service.settings.secret, session)
    known = tenants.digest_of(session)
    caller = tenants.caller_of_id(service.engine, key_id, known) if key_id is not None else None
    if caller is None:
        raise KeyUnknown
    if request.method not in SAFE:
        token = request.headers.get("x-csrf-token", "")
        if not hmac.compare_digest(token.encode(), csrf_token(service.settings.secret, session).encode()):
            raise CsrfMissing
    return caller


def require(scope: str) -> Callable[[Request, State], Caller]:
    """Return a dependency that lets callers with this scope through."""

    def check(request: Request, service: Service) -> Caller:
        caller = authenticate(request, service)
        if scope not in caller.scopes:
            raise ScopeMissing(scope)
        return caller

    return check


Reader = Annotated[Caller, Depends(require("read"))]
Submitter = Annotated[Caller, Depends(require("submit"))]
Admin = Annotated[Caller, Depends(require("admin"))]


def operator(caller: Admin) -> Caller:
    """Return the caller where it may see the whole service. Raises ScopeMissing."""
    if not caller.operator:
        raise ScopeMissing("admin, with a key of the operator's tenant")
    return caller


Operator = Annotated[Caller, Depends(operator)]
