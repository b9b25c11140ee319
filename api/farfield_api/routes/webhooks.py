"""Webhooks of the tenant: who is told when jobs begin and end. Deliveries are the reconciler's (farfield_workers)."""

from typing import Annotated, Any, Literal

from farfield import webhooks as addresses
from farfield.store import webhooks
from farfield.store.tenants import Caller
from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from farfield_api.auth import Reader, Submitter
from farfield_api.conditions import etag_of_shown, expect_match
from farfield_api.documented import refusals
from farfield_api.errors import PreconditionFailed, ScopeMissing
from farfield_api.paging import CursorText, Limit, cut, read_cursor
from farfield_api.replies.common import PLAIN, Id
from farfield_api.replies.webhooks import (
    DeliveryPage,
    DeliveryReply,
    DeliveryStarted,
    Event,
    NewWebhookReply,
    WebhookPage,
    WebhookReply,
)
from farfield_api.state import Service
from farfield_api.times import iso

router = APIRouter(prefix="/v1/webhooks", tags=["webhooks"])

_Name = Annotated[str, Field(min_length=1, max_length=100, pattern=PLAIN)]
_Url = Annotated[str, Field(min_length=8, max_length=addresses.MAX_URL, description="https, of a public host")]
_Events = Annotated[set[Event], Field(min_length=1)]


class WebhookRequest(BaseModel):
    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"examples": [{"name": "asset pipeline", "url": "https://93.184.215.14/farfield"}]},
    )
    name: _Name
    url: _Url
    events: _Events = Field({"done", "failed", "cancelled"}, description="the states of a job that it is told of")
    every_job: bool = Field(False, description="told of all jobs of the tenant (scope admin), or of those that name it")


class WebhookChange(BaseModel):
    """What is left out stays."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"active": False}]})
    name: _Name | None = None
    url: _Url | None = None
    events: _Events | None = None
    every_job: bool | None = None
    active: bool | None = None


@router.post(
    "", status_code=201, summary="Register a webhook; its secret is in this answer only",
    responses=refusals("WebhookAddressRefused", "QuotaExceeded"),
)  # fmt: skip
def create(wanted: WebhookRequest, response: Response, caller: Submitter, service: Service) -> NewWebhookReply:
    _may_have(caller, wanted.every_job)
    addresses.resolve(wanted.url, service.settings.webhook_networks)
    webhook_id, secret = webhooks.create(
        service.engine, caller.tenant_id, name=wanted.name, url=wanted.url, events=wanted.events,
        every_job=wanted.every_job, key=service.settings.webhook_key,
    )  # fmt: skip
    response.headers.update({"location": f"/v1/webhooks/{webhook_id}", "cache-control": "no-store"})
    return NewWebhookReply(**_shown(webhooks.get(service.engine, caller.tenant_id, webhook_id)), secret=secret)


@router.get("", summary="The tenant's webhooks, newest first", responses=refusals("CursorInvalid"))
def list_webhooks(caller: Reader, service: Service, cursor: CursorText = None, limit: Limit = 50) -> WebhookPage:
    rows = webhooks.page(service.engine, caller.tenant_id, before=read_cursor(cursor), limit=limit + 1)
    rows, following = cut(rows, limit)
    return WebhookPage(webhooks=[WebhookReply(**_shown(row)) for row in rows], next=following)


@router.get("/{webhook_id}", summary="A webhook", responses=refusals("WebhookNotFound"))
def show(webhook_id: Id, response: Response, caller: Reader, service: Service) -> WebhookReply:
    reply = WebhookReply(**_shown(webhooks.get(service.engine, caller.tenant_id, webhook_id)))
    response.headers["etag"] = etag_of_shown(reply)
    return reply


@router.patch(
    "/{webhook_id}", summary="Change a webhook, pause it, or let it go on. If-Match guards others' changes",
    responses=refusals("WebhookNotFound", "WebhookAddressRefused", PreconditionFailed),
)  # fmt: skip
def change(
    webhook_id: Id, wanted: WebhookChange, request: Request, response: Response, caller: Submitter, service: Service
) -> WebhookReply:
    told = {key: value for key, value in wanted.model_dump().items() if value is not None}

    def expect(row: Any) -> None:
        _may_have(caller, row.every_job or wanted.every_job)
        expect_match(request, WebhookReply(**_shown(row)))

    if wanted.url is not None:
        addresses.resolve(wanted.url, service.settings.webhook_networks)
    webhooks.change(service.engine, caller.tenant_id, webhook_id, told, expect=expect)
    return show(webhook_id, response, caller, service)


@router.delete(
    "/{webhook_id}", status_code=204, summary="Delete a webhook and what waits for it",
    responses=refusals("WebhookNotFound", PreconditionFailed),
)  # fmt: skip
def delete(webhook_id: Id, request: Request, caller: Submitter, service: Service) -> None:
    def expect(row: Any) -> None:
        _may_have(caller, row.every_job)
        expect_match(request, WebhookReply(**_shown(row)))

    webhooks.delete(service.engine, caller.tenant_id, webhook_id, expect=expect)


@router.post(
    "/{webhook_id}/rotate", summary="A new secret; for a day deliveries carry a signature with the old one, too",
    responses=refusals("WebhookNotFound"),
)  # fmt: skip
def rotate(webhook_id: Id, response: Response, caller: Submitter, service: Service) -> NewWebhookReply:
    _may_have(caller, webhooks.get(service.engine, caller.tenant_id, webhook_id).every_job)
    secret = webhooks.rotate(service.engine, caller.tenant_id, webhook_id, key=service.settings.webhook_key)
    response.headers["cache-control"] = "no-store"
    return NewWebhookReply(**_shown(webhooks.get(service.engine, caller.tenant_id, webhook_id)), secret=secret)


@router.post(
    "/{webhook_id}/test", status_code=202, summary="Send a delivery that tells of nothing",
    responses=refusals("WebhookNotFound"),
)  # fmt: skip
def test(webhook_id: Id, caller: Submitter, service: Service) -> DeliveryStarted:
    return DeliveryStarted(delivery=webhooks.test(service.engine, caller.tenant_id, webhook_id))


@router.get(
    "/{webhook_id}/deliveries", summary="What was sent, newest first, and how it was taken; for 30 days",
    responses=refusals("WebhookNotFound", "CursorInvalid"),
)  # fmt: skip
def deliveries(
    webhook_id: Id, caller: Reader, service: Service, cursor: CursorText = None, limit: Limit = 50,
    state: Annotated[Literal["pending", "delivered", "failed"] | None, Query()] = None,
) -> DeliveryPage:  # fmt: skip
    rows = webhooks.page_of_deliveries(
        service.engine, caller.tenant_id, webhook_id, state=state, before=read_cursor(cursor), limit=limit + 1
    )
    rows, following = cut(rows, limit)
    return DeliveryPage(deliveries=[_delivery(row) for row in rows], next=following)


@router.post(
    "/{webhook_id}/deliveries/{delivery_id}/redeliver", status_code=202, summary="Try a delivery again, now",
    responses=refusals("WebhookNotFound", "DeliveryNotFound"),
)  # fmt: skip
def redeliver(webhook_id: Id, delivery_id: Id, caller: Submitter, service: Service) -> DeliveryStarted:
    webhooks.redeliver(service.engine, caller.tenant_id, webhook_id, delivery_id)
    return DeliveryStarted(delivery=delivery_id)


def _may_have(caller: Caller, every_job: bool | None) -> None:
    if every_job and "admin" not in caller.scopes:
        raise ScopeMissing("admin")


def _shown(row: Any) -> dict[str, Any]:
    return {
        "id": row.id, "name": row.name, "url": row.url, "events": row.events.split(), "every_job": row.every_job,
        "active": row.active, "created_at": iso(row.created_at),
    }  # fmt: skip


def _delivery(row: Any) -> DeliveryReply:
    return DeliveryReply(
        id=row.id, webhook=row.webhook_id, job=row.job_id, event=row.event, state=row.state, attempt=row.attempt,
        status=row.status, error=row.error, next_at=iso(row.next_at), created_at=str(iso(row.created_at)),
        ended_at=iso(row.ended_at),
    )  # fmt: skip
