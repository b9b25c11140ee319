"""Answers about webhooks and their deliveries."""

from typing import Literal

from pydantic import Field

from farfield_api.replies.common import AT, JOB, KEY, Next, Reply, Time, example

Event = Literal["queued", "running", "done", "failed", "cancelled"]

_HOOK = {"id": KEY, "name": "asset pipeline", "url": "https://hooks.studio.example/farfield",
         "events": ["done", "failed", "cancelled"], "every_job": True, "active": True, "created_at": AT}  # fmt: skip
_DELIVERY = {"id": KEY, "webhook": KEY, "job": JOB, "event": "job.done", "state": "delivered", "attempt": 1,
             "status": 204, "error": None, "next_at": None, "created_at": AT, "ended_at": AT}  # fmt: skip


class WebhookReply(Reply):
    """A webhook, without its secret."""

    model_config = example(**_HOOK)
    id: str
    name: str
    url: str
    events: list[Event]
    every_job: bool = Field(description="false: told only of jobs that name it")
    active: bool = Field(description="false: what happens meanwhile is not told, what waits is kept")
    created_at: Time


class NewWebhookReply(WebhookReply):
    """A webhook, with its secret: this once."""

    model_config = example(**_HOOK, secret="whsec_" + "x" * 43 + "=")
    secret: str = Field(description="with which deliveries are signed; it is shown once")


class WebhookPage(Reply):
    model_config = example(webhooks=[_HOOK], next=None)
    webhooks: list[WebhookReply]
    next: Next


class DeliveryReply(Reply):
    model_config = example(**_DELIVERY)
    id: str = Field(description="the webhook-id of its requests: the same at every attempt")
    webhook: str
    job: str | None = Field(description="null: a test")
    event: str
    state: Literal["pending", "delivered", "failed"]
    attempt: int
    status: int | None = Field(description="the receiver's last answer")
    error: str | None = Field(description="why there was none")
    next_at: Time | None
    created_at: Time
    ended_at: Time | None


class DeliveryPage(Reply):
    model_config = example(deliveries=[_DELIVERY], next=None)
    deliveries: list[DeliveryReply]
    next: Next


class DeliveryStarted(Reply):
    model_config = example(delivery=KEY)
    delivery: str
