"""Devices: measured frames in, a profile out; a job takes the figures that a device has when it is created."""

import dataclasses
import json
import tempfile
from pathlib import Path
from typing import Annotated, Any, cast

import sqlalchemy as sa
from farfield.errors import DeviceExists, DeviceNotCalibrated, FarfieldError, SettingsInvalid
from farfield.rendertime.profiles import PROFILES, find_profile
from farfield.rendertime.samples import COLUMNS, samples_of
from farfield.settings import DeviceProfile, Settings, from_mapping
from farfield.store import devices
from fastapi import APIRouter, Header, Response
from pydantic import BaseModel, ConfigDict, Field, WrapValidator
from starlette.concurrency import run_in_threadpool

from farfield_api.apart import SAMPLES, read_apart
from farfield_api.auth import Reader, Submitter
from farfield_api.documented import refusals
from farfield_api.errors import DeviceBusy, InputRefused
from farfield_api.paging import CursorText, Limit, Part, cut, read_cursor
from farfield_api.replies.common import PLAIN, Id
from farfield_api.replies.devices import DeviceLinks, DevicePageReply, DeviceReply, Preset
from farfield_api.state import Service, State
from farfield_api.times import iso

router = APIRouter(prefix="/v1/devices", tags=["devices"])
_NOT_FOUND = refusals("DeviceNotFound")

MAX_WAITING = 8  # requests with samples, in this process
_waiting = 0

NOT_YET = ("SamplesTooFew", "SamplesDegenerate")  # more samples mend these
CheckedProfile = Annotated[
    DeviceProfile,
    WrapValidator(lambda value, inner: from_mapping({"device_profile": value}).device_profile),
]


class DeviceRequest(BaseModel):
    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"name": "office"}]})
    name: str = Field(min_length=1, max_length=100, pattern=PLAIN, description="what jobs call it in settings.device")
    profile: CheckedProfile | None = Field(None, description="its figures where they are known; else send samples")


class Sample(BaseModel):
    """One measured frame: what it drew, and how long that took."""

    calls: float
    triangles: float
    pixels: float
    impostors: float
    impostor_triangles: float
    impostor_pixels: float
    ms: float


# The schema is the model's; the check is the domain's own: a row of numbers a sample.
CheckedSamples = Annotated[list[Sample], WrapValidator(lambda value, inner: samples_of(value))]
_SAMPLE: dict[str, Any] = {"calls": 310, "triangles": 812_000, "pixels": 2_000_000, "impostors": 12, "impostor_triangles": 96,
           "impostor_pixels": 180_000, "ms": 7.4}  # fmt: skip


class SamplesRequest(BaseModel):
    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"samples": [_SAMPLE]}]})
    samples: CheckedSamples = Field(description="added to those that the device has")


@router.post(
    "", status_code=201, summary="Make a device: with its profile, or to send samples to",
    responses=refusals(DeviceExists, "QuotaExceeded", SettingsInvalid),
)  # fmt: skip
def create(wanted: DeviceRequest, response: Response, caller: Submitter, service: Service) -> DeviceReply:
    if wanted.name in PROFILES:
        raise DeviceExists(wanted.name)
    model = dataclasses.asdict(wanted.profile) if wanted.profile is not None else None
    device_id = devices.create(service.engine, caller.tenant_id, name=wanted.name, model=model)
    response.headers["location"] = f"/v1/devices/{device_id}"
    return _shown(devices.get(service.engine, caller.tenant_id, device_id))


@router.get("", summary="The presets, and the devices of the tenant, newest first", responses=refusals("CursorInvalid"))
def list_devices(
    caller: Reader, service: Service, name: Part = None, cursor: CursorText = None, limit: Limit = 50
) -> DevicePageReply:
    presets = [Preset(name=name, profile=dataclasses.asdict(profile)) for name, profile in PROFILES.items()]
    rows = devices.page(service.engine, caller.tenant_id, before=read_cursor(cursor), limit=limit + 1, name=name)
    rows, following = cut(rows, limit)
    return DevicePageReply(presets=presets, devices=[_shown(row) for row in rows], next=following)


@router.get("/{device_id}", summary="The profile with its residuals, or what is still missing", responses=_NOT_FOUND)
def show(device_id: Id, caller: Reader, service: Service) -> DeviceReply:
    return _shown(devices.get(service.engine, caller.tenant_id, device_id))


@router.delete(
    "/{device_id}", status_code=204, summary="Delete a device and its samples; jobs keep the figures they were made with",
    responses=_NOT_FOUND,
)  # fmt: skip
def delete(device_id: Id, caller: Submitter, service: Service) -> None:
    devices.delete(service.engine, caller.tenant_id, device_id)


@router.post(
    "/{device_id}/samples", summary="Add measured frames and fit the profile to all there are",
    responses=refusals("DeviceNotFound", "SamplesInvalid", "IdempotencyConflict", DeviceBusy),
)  # fmt: skip
async def add_samples(
    device_id: Id, sent: SamplesRequest, caller: Submitter, service: Service,
    idempotency_key: Annotated[
        str | None, Header(min_length=1, max_length=255, description="the same key again adds nothing")
    ] = None,
) -> DeviceReply:  # fmt: skip
    """Frames are kept together with the fit to them, or not at all: whoever gets no answer sends them again.

    A fit costs a few seconds at most (rendertime.samples.MAX_SAMPLES); one runs at a time, and few wait for it.
    """
    global _waiting
    rows = cast(list[list[float]], sent.samples)
    if _waiting >= MAX_WAITING:
        raise DeviceBusy
    _waiting += 1
    try:
        for _ in range(MAX_WAITING):
            found = await run_in_threadpool(
                devices.frames_with, service.engine, caller.tenant_id, device_id, rows, idempotency_key=idempotency_key
            )
            if found is None:
                break
            n_before, frames = found
            model, refusal = await _fit(service, frames)
            if await run_in_threadpool(
                devices.keep, service.engine, caller.tenant_id, device_id, rows, n_before=n_before, model=model,
                refusal=refusal, idempotency_key=idempotency_key,
            ):  # fmt: skip
                break
        else:
            raise DeviceBusy
    finally:
        _waiting -= 1
    return _shown(await run_in_threadpool(devices.get, service.engine, caller.tenant_id, device_id))


def with_device(engine: sa.Engine, tenant_id: str, settings: Settings) -> tuple[Settings, str | None]:
    """Return settings that hold the figures of the device they name, and the id of that device where it is a row.

    Raises SettingsInvalid for a name that is no device, DeviceNotCalibrated.
    """
    if settings.device_profile is not None or settings.device in PROFILES:
        return settings, None
    row = devices.find(engine, tenant_id, settings.device)
    if row is None:
        find_profile(settings)  # refuses
        raise SettingsInvalid("device", f"{settings.device!r} is not a device profile")
    if row.model is None:
        raise DeviceNotCalibrated(row.name, (row.refusal or {"detail": "no samples were sent"})["detail"])
    profile = from_mapping({"device_profile": row.model}).device_profile
    return dataclasses.replace(settings, device_profile=profile), row.id


async def _fit(service: State, frames: list[list[float]]) -> tuple[dict[str, Any] | None, dict[str, str] | None]:
    """Return the profile, or why there is none yet. The fit runs in a process of its own: it needs no part of the API."""
    rows = [dict(zip((*COLUMNS, "ms"), frame, strict=True)) for frame in frames]
    with tempfile.TemporaryDirectory(dir=service.artifacts.temporary, prefix="read-") as folder:
        file = Path(folder) / "samples.json"
        await run_in_threadpool(file.write_text, json.dumps(rows))
        try:
            async with SAMPLES:
                found = await read_apart(service.settings.calibrate_command, file, "samples", service.settings)
        except InputRefused as refused:
            if refused.code not in NOT_YET:
                raise
            return None, _why(refused)
    return found["device_profile"], None


def _why(error: FarfieldError) -> dict[str, str]:
    return {"code": error.code, "detail": str(error), "advice": error.advice}


def _shown(row: Any) -> DeviceReply:
    return DeviceReply(
        id=row.id, tenant=row.tenant_id, name=row.name, samples=row.n_samples, profile=row.model, missing=row.refusal,
        created_at=str(iso(row.created_at)), links=DeviceLinks(self=f"/v1/devices/{row.id}"),
    )  # fmt: skip
