"""API keys of the tenant: made, listed, rotated, revoked. A key can make none that may more than it may itself."""

from typing import Annotated, Any

from farfield.store import tenants
from farfield.store.tenants import Caller
from fastapi import APIRouter, Response
from pydantic import BaseModel, ConfigDict, Field

from farfield_api.auth import Admin
from farfield_api.documented import refusals
from farfield_api.errors import ScopeMissing
from farfield_api.paging import CursorText, Limit, cut, read_cursor
from farfield_api.replies.common import PLAIN, Id
from farfield_api.replies.tenants import KeyPage, KeyReply, NewKeyReply, Scope
from farfield_api.state import Service, State
from farfield_api.times import iso

router = APIRouter(prefix="/v1/keys", tags=["keys"])

YEARS_S = 10 * 366 * 86400
MOST = 200  # valid keys of a tenant: each has rate limits of its own
_Seconds = Annotated[int | None, Field(ge=1, le=YEARS_S)]


class KeyRequest(BaseModel):
    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [{"name": "nightly build", "scopes": ["read", "submit"], "expires_in_s": 15_552_000}]
        },
    )
    name: str = Field(min_length=1, max_length=100, pattern=PLAIN, description="what it is for")
    scopes: set[Scope] = Field(
        min_length=1, description="read: see; submit: change; admin: keys, webhooks of all, audit"
    )
    expires_in_s: _Seconds = Field(None, description="seconds until it ends; null: never")


class RotateRequest(BaseModel):
    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"grace_s": 3600}]})
    grace_s: int = Field(0, ge=0, le=30 * 86400, description="how long the old key still works")
    expires_in_s: _Seconds = Field(None, description="of the new key; null: as long as the old one was made for")


@router.post(
    "", status_code=201, summary="Make a key; its secret is in this answer only", responses=refusals("QuotaExceeded")
)
def create(wanted: KeyRequest, response: Response, caller: Admin, service: Service) -> NewKeyReply:
    _may_give(caller, wanted.scopes)
    key = tenants.create_key(
        service.engine, caller.tenant_id, wanted.name, wanted.scopes, lifetime_s=wanted.expires_in_s, most=MOST
    )
    return _made(service, caller, key, response)


@router.get(
    "", summary="The tenant's keys, newest first, expired and revoked ones too", responses=refusals("CursorInvalid")
)
def list_keys(caller: Admin, service: Service, cursor: CursorText = None, limit: Limit = 50) -> KeyPage:
    rows = tenants.page_of_keys(service.engine, caller.tenant_id, before=read_cursor(cursor), limit=limit + 1)
    rows, following = cut(rows, limit)
    return KeyPage(keys=[KeyReply(**_shown(row)) for row in rows], next=following)


@router.get("/{key_id}", summary="A key: scopes, when it ends, when it was used", responses=refusals("KeyNotFound"))
def show(key_id: Id, caller: Admin, service: Service) -> KeyReply:
    return KeyReply(**_shown(tenants.get_key(service.engine, caller.tenant_id, key_id)))


@router.post(
    "/{key_id}/rotate", status_code=201, summary="Make a key of the same name and scopes; the old one ends",
    responses=refusals("KeyNotFound", "QuotaExceeded"),
)  # fmt: skip
def rotate(key_id: Id, response: Response, caller: Admin, service: Service, wanted: RotateRequest) -> NewKeyReply:
    _may_give(caller, set(tenants.get_key(service.engine, caller.tenant_id, key_id).scopes.split()))
    key = tenants.rotate_key(
        service.engine, caller.tenant_id, key_id, grace_s=wanted.grace_s, lifetime_s=wanted.expires_in_s, most=MOST
    )
    return _made(service, caller, key, response)


@router.delete("/{key_id}", summary="Revoke a key, and end its sessions", responses=refusals("KeyNotFound"))
def revoke(key_id: Id, caller: Admin, service: Service) -> KeyReply:
    tenants.get_key(service.engine, caller.tenant_id, key_id)
    tenants.revoke_key(service.engine, key_id)
    return KeyReply(**_shown(tenants.get_key(service.engine, caller.tenant_id, key_id)))


def _may_give(caller: Caller, scopes: set[Any]) -> None:
    for scope in sorted(scopes - caller.scopes):
        raise ScopeMissing(scope)


def _made(service: State, caller: Caller, key: str, response: Response) -> NewKeyReply:
    key_id = key.split("_")[1]
    response.headers["location"] = f"/v1/keys/{key_id}"
    response.headers["cache-control"] = "no-store"
    return NewKeyReply(**_shown(tenants.get_key(service.engine, caller.tenant_id, key_id)), key=key)


def _shown(row: Any) -> dict[str, Any]:
    times = ("created_at", "expires_at", "last_used_at", "revoked_at")
    return {
        "id": row.id, "tenant": row.tenant_id, "name": row.name, "scopes": row.scopes.split(),
        **{name: iso(getattr(row, name)) for name in times},
    }  # fmt: skip
