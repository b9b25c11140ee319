"""The audit log of the tenant: who did what, when, from which address."""

from typing import Annotated

from farfield.store import audit
from fastapi import APIRouter, Query

from farfield_api.auth import Admin
from farfield_api.documented import refusals
from farfield_api.errors import CursorInvalid
from farfield_api.paging import CursorText, Limit, Since, seconds
from farfield_api.replies.common import ID, PLAIN
from farfield_api.replies.tenants import AuditEntry, AuditPage
from farfield_api.state import Service
from farfield_api.times import iso

router = APIRouter(prefix="/v1/audit", tags=["audit"])


@router.get("", summary="Every change that was asked for with a key, newest first", responses=refusals("CursorInvalid"))
def list_entries(
    caller: Admin, service: Service, cursor: CursorText = None, limit: Limit = 50,
    key: Annotated[str | None, Query(pattern=ID, description="id of the key that asked")] = None,
    action: Annotated[
        str | None, Query(max_length=200, pattern=PLAIN, examples=["DELETE /v1/jobs/{job_id}"])
    ] = None,
    created_after: Since = None,
) -> AuditPage:  # fmt: skip
    if cursor is not None and not (cursor.isascii() and cursor.isdigit() and len(cursor) < 18):
        raise CursorInvalid
    rows = audit.page(
        service.engine, caller.tenant_id, before=int(cursor) if cursor is not None else None, limit=limit + 1,
        key_id=key, action=action, since=seconds(created_after),
    )  # fmt: skip
    listed = [
        AuditEntry(
            id=row.id, at=str(iso(row.created_at)), tenant=row.tenant_id, key=row.key_id, key_name=row.key_name,
            address=row.address, action=row.action, target=row.target, status=row.status,
        )
        for row in rows[:limit]
    ]  # fmt: skip
    return AuditPage(entries=listed, next=str(listed[-1].id) if len(rows) > limit else None)
