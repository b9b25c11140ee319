"""Answers about devices."""

from typing import Any

from pydantic import Field

from farfield_api.replies.common import AT, KEY, TENANT, Next, Reply, Time, example

_DEVICE = {
    "id": KEY, "tenant": TENANT, "name": "office", "samples": 60, "profile": None,
    "missing": {"code": "SamplesTooFew", "detail": "60 samples are too few", "advice": "Measure more frames."},
    "created_at": AT, "links": {"self": f"/v1/devices/{KEY}"},
}  # fmt: skip


class Missing(Reply):
    """Why there is no profile yet."""

    code: str
    detail: str
    advice: str = ""


class DeviceLinks(Reply):
    self: str


class DeviceReply(Reply):
    model_config = example(**_DEVICE)
    id: str
    tenant: str
    name: str
    samples: int
    profile: dict[str, Any] | None = Field(description="see the schema DeviceProfile")
    missing: Missing | None
    created_at: Time
    links: DeviceLinks


class Preset(Reply):
    name: str
    profile: dict[str, Any]


class DevicePageReply(Reply):
    model_config = example(
        presets=[{"name": "laptop", "profile": {"per_call_ns": 5000.0}}], devices=[_DEVICE], next=None
    )
    presets: list[Preset] = Field(description="what every service knows")
    devices: list[DeviceReply]
    next: Next
