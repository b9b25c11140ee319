"""Tenants, what they have and may have: the operator's; everybody sees the own usage."""

from typing import Annotated, Any

from farfield.store import quotas, tenants
from farfield.store.pages import ALL
from farfield.store.quotas import Quota
from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from farfield_api.auth import Operator, Reader
from farfield_api.conditions import etag_of_shown, expect_match
from farfield_api.documented import refusals
from farfield_api.errors import PreconditionFailed, TenantNeeded
from farfield_api.paging import CursorText, Limit, cut, read_cursor
from farfield_api.replies.common import PLAIN, Id
from farfield_api.replies.tenants import QuotaReply, TenantPage, TenantReply, UsageReply
from farfield_api.state import Service
from farfield_api.times import iso

router = APIRouter(prefix="/v1", tags=["tenants"])

_Limit = Annotated[int | None, Field(ge=0, le=1 << 62)]
_Count = Annotated[int | None, Field(ge=0, le=(1 << 31) - 1)]


class TenantRequest(BaseModel):
    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"name": "harbour"}]})
    name: str = Field(min_length=1, max_length=100, pattern=PLAIN)


class QuotaRequest(BaseModel):
    """Limits of a tenant; null: what the service gives everybody."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"examples": [{"max_bytes": 500_000_000_000, "max_jobs": None, "max_running": 8}]},
    )
    max_bytes: _Limit = Field(None, description="bytes stored")
    max_jobs: _Count = Field(None, description="jobs stored")
    max_running: _Count = Field(None, description="jobs queued or running")


@router.post("/tenants", status_code=201, summary="Make a tenant; for the operator", responses=refusals("TenantExists"))
def create(wanted: TenantRequest, response: Response, caller: Operator, service: Service) -> TenantReply:
    tenant_id = tenants.add_tenant(service.engine, wanted.name)
    response.headers["location"] = f"/v1/tenants/{tenant_id}"
    return _shown(tenants.get_tenant(service.engine, tenant_id))


@router.get("/tenants", summary="All tenants; for the operator", responses=refusals("CursorInvalid"))
def list_tenants(caller: Operator, service: Service, cursor: CursorText = None, limit: Limit = 50) -> TenantPage:
    rows = tenants.page_of_tenants(service.engine, before=read_cursor(cursor), limit=limit + 1)
    rows, following = cut(rows, limit)
    return TenantPage(tenants=[_shown(row) for row in rows], next=following)


@router.get("/tenants/{tenant_id}", summary="A tenant; for the operator", responses=refusals("TenantNotFound"))
def show(tenant_id: Id, caller: Operator, service: Service) -> TenantReply:
    return _shown(tenants.get_tenant(service.engine, tenant_id))


@router.get(
    "/tenants/{tenant_id}/quota", summary="The limits of a tenant that are its own; for the operator",
    responses=refusals("TenantNotFound"),
)  # fmt: skip
def show_quota(tenant_id: Id, response: Response, caller: Operator, service: Service) -> QuotaReply:
    reply = _quota_of(tenants.get_tenant(service.engine, tenant_id))
    response.headers["etag"] = etag_of_shown(reply)
    return reply


@router.put(
    "/tenants/{tenant_id}/quota", summary="Set the limits of a tenant; for the operator. If-Match guards others' changes",
    responses=refusals("TenantNotFound", PreconditionFailed),
)  # fmt: skip
def set_quota(
    tenant_id: Id, wanted: QuotaRequest, request: Request, response: Response, caller: Operator, service: Service
) -> QuotaReply:
    def expect(row: Any) -> None:
        expect_match(request, _quota_of(row))

    quotas.set_quota(service.engine, tenant_id, Quota(**wanted.model_dump()), expect=expect)
    return show_quota(tenant_id, response, caller, service)


@router.get("/usage", summary="What the tenant has, and how much it may have")
def usage(caller: Reader, service: Service) -> UsageReply:
    if caller.tenant_id == ALL:
        raise TenantNeeded
    used = quotas.usage(service.engine, caller.tenant_id)
    quota = quotas.quota_of(service.engine, caller.tenant_id, service.settings.quota)
    return UsageReply(
        tenant=caller.tenant_id, bytes=used.bytes, jobs=used.jobs, running=used.running, quota=_quota_of(quota)
    )


def _quota_of(row: Any) -> QuotaReply:
    return QuotaReply(max_bytes=row.max_bytes, max_jobs=row.max_jobs, max_running=row.max_running)


def _shown(row: Any) -> TenantReply:
    return TenantReply(id=row.id, name=row.name, operator=row.is_operator, created_at=str(iso(row.created_at)))
