"""Answers about tenants, their quotas, keys, and the audit log."""

from typing import Literal

from pydantic import Field

from farfield_api.replies.common import AT, JOB, KEY, TENANT, Next, Reply, Time, example

Scope = Literal["read", "submit", "admin"]

_QUOTA = {"max_bytes": 500_000_000_000, "max_jobs": 10_000, "max_running": 8}
_TENANT = {"id": TENANT, "name": "harbour", "operator": False, "created_at": AT}
_KEY = {"id": KEY, "tenant": TENANT, "name": "nightly build", "scopes": ["read", "submit"], "created_at": AT,
        "expires_at": "2026-07-31T09:15:00.000Z", "last_used_at": AT, "revoked_at": None}  # fmt: skip
_ENTRY = {"id": 17, "at": AT, "tenant": TENANT, "key": KEY, "key_name": "nightly build", "address": "203.0.113.7",
          "action": "POST /v1/jobs/{job_id}/cancel", "target": f"/v1/jobs/{JOB}/cancel", "status": 200}  # fmt: skip


class QuotaReply(Reply):
    """Limits; null: none."""

    model_config = example(**_QUOTA)
    max_bytes: int | None
    max_jobs: int | None
    max_running: int | None


class TenantReply(Reply):
    model_config = example(**_TENANT)
    id: str
    name: str
    operator: bool = Field(description="its admins may act in all tenants")
    created_at: Time


class TenantPage(Reply):
    model_config = example(tenants=[_TENANT], next=None)
    tenants: list[TenantReply]
    next: Next


class UsageReply(Reply):
    """What a tenant has, and how much it may have."""

    model_config = example(tenant=TENANT, bytes=73_400_320, jobs=12, running=1, quota=_QUOTA)
    tenant: str
    bytes: int = Field(description="of its scenes, results and intermediate results, each once")
    jobs: int
    running: int = Field(description="jobs that are queued or running")
    quota: QuotaReply


class KeyReply(Reply):
    """A key, without its secret."""

    model_config = example(**_KEY)
    id: str
    tenant: str
    name: str
    scopes: list[Scope]
    created_at: Time
    expires_at: Time | None
    last_used_at: Time | None = Field(description="to about half a minute")
    revoked_at: Time | None


class NewKeyReply(KeyReply):
    """A key, with its secret: this once."""

    model_config = example(**_KEY, key=f"ff_{KEY}_" + "x" * 43)
    key: str = Field(description="what to send as Authorization: Bearer; it is shown once")


class KeyPage(Reply):
    model_config = example(keys=[_KEY], next=None)
    keys: list[KeyReply]
    next: Next


class AuditEntry(Reply):
    """Who did what, when, from where."""

    model_config = example(**_ENTRY)
    id: int
    at: Time
    tenant: str
    key: str | None = Field(description="id of the key; null: the operator, at the machine")
    key_name: str
    address: str
    action: str
    target: str
    status: int


class AuditPage(Reply):
    model_config = example(entries=[_ENTRY], next=None)
    entries: list[AuditEntry]
    next: Next
