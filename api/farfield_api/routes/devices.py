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
from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, ConfigDict, Field, WrapValidator
from starlette.concurrency import run_in_threadpool

from farfield_api.apart import SAMPLES, read_apart
from farfield_api.auth import Reader, Submitter
from farfield_api.errors import RESPONSES, InputRefused
from farfield_api.state import Service, State
from farfield_api.times import iso

router = APIRouter(prefix="/v1/devices", tags=["devices"], responses=RESPONSES)

NOT_YET = ("SamplesTooFew", "SamplesDegenerate")  # more samples mend these
CheckedProfile = Annotated[
    DeviceProfile,
    WrapValidator(lambda value, inner: from_mapping({"device_profile": value}).device_profile),
]


class DeviceRequest(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str = Field(min_length=1, max_length=100, description="what jobs call it in settings.device")
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
CheckedSamples = Annotated[list[Sample], WrapValidator(lambda value, inner: samples_of(value).tolist())]


class SamplesRequest(BaseModel):
    model_config = ConfigDict(extra="forbid")
    samples: CheckedSamples = Field(description="added to those that the device has")


@router.post("", status_code=201, summary="Make a device: with its profile, or to send samples to")
def create(wanted: DeviceRequest, response: Response, caller: Submitter, service: Service) -> dict[str, Any]:
    if wanted.name in PROFILES:
        raise DeviceExists(wanted.name)
    model = dataclasses.asdict(wanted.profile) if wanted.profile is not None else None
    device_id = devices.create(service.engine, caller.tenant_id, name=wanted.name, model=model)
    response.headers["location"] = f"/v1/devices/{device_id}"
    return _shown(devices.get(service.engine, caller.tenant_id, device_id))


@router.get("", summary="The presets, and the newest devices of the tenant")
def list_devices(
    caller: Reader, service: Service, limit: Annotated[int, Query(ge=1, le=200)] = 50
) -> dict[str, Any]:  # fmt: skip
    presets = [{"name": name, "profile": dataclasses.asdict(profile)} for name, profile in PROFILES.items()]
    rows = devices.page(service.engine, caller.tenant_id, limit=limit)
    return {"presets": presets, "devices": [_shown(row) for row in rows]}


@router.get("/{device_id}", summary="The profile with its residuals, or what is still missing")
def show(device_id: str, caller: Reader, service: Service) -> dict[str, Any]:
    return _shown(devices.get(service.engine, caller.tenant_id, device_id))


@router.post("/{device_id}/samples", summary="Add measured frames and fit the profile to all there are")
async def add_samples(device_id: str, sent: SamplesRequest, caller: Submitter, service: Service) -> dict[str, Any]:
    rows = cast(list[list[float]], sent.samples)
    frames = await run_in_threadpool(devices.add_samples, service.engine, caller.tenant_id, device_id, rows)
    model, refusal = await _fit(service, frames)
    await run_in_threadpool(
        devices.keep_fit, service.engine, device_id, n_fitted=len(frames), model=model, refusal=refusal
    )
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
            found = await read_apart(service.settings.calibrate_command, file, "samples", service.settings, SAMPLES)
        except InputRefused as refused:
            if refused.code not in NOT_YET:
                raise
            return None, _why(refused)
    return found["device_profile"], None


def _why(error: FarfieldError) -> dict[str, str]:
    return {"code": error.code, "detail": str(error), "advice": error.advice}


def _shown(row: Any) -> dict[str, Any]:
    return {
        "id": row.id, "name": row.name, "samples": row.n_samples, "profile": row.model, "missing": row.refusal,
        "created_at": iso(row.created_at), "links": {"self": f"/v1/devices/{row.id}"},
    }  # fmt: skip
