"""Devices of a tenant: the frames measured on them, and the profile fitted to these."""

from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa

from farfield.errors import DeviceExists, DeviceNotFound, SamplesInvalid
from farfield.rendertime.samples import MAX_SAMPLES
from farfield.store.engine import new_id, now, read, write
from farfield.store.tables import device_profile, device_sample


def create(engine: sa.Engine, tenant_id: str, *, name: str, model: dict[str, Any] | None) -> str:
    """Return the id of a new device, with a stated profile or none yet. Raises DeviceExists."""
    with write(engine) as tx:
        named = sa.select(device_profile.c.id).where(
            device_profile.c.tenant_id == tenant_id, device_profile.c.name == name
        )
        if tx.scalar(named) is not None:
            raise DeviceExists(name)
        device_id = new_id()
        tx.execute(
            sa.insert(device_profile).values(
                id=device_id, tenant_id=tenant_id, name=name, model=model, n_samples=0, n_fitted=0, created_at=now()
            )
        )
        return device_id


def get(engine: sa.Engine, tenant_id: str, device_id: str) -> sa.Row[Any]:
    """Return the device's row. Raises DeviceNotFound, also where it is another tenant's."""
    with read(engine) as tx:
        return _row(tx, tenant_id, device_id)


def find(engine: sa.Engine, tenant_id: str, name: str) -> sa.Row[Any] | None:
    """Return the tenant's device of this name, or None."""
    with read(engine) as tx:
        return tx.execute(
            sa.select(device_profile).where(device_profile.c.tenant_id == tenant_id, device_profile.c.name == name)
        ).one_or_none()


def page(engine: sa.Engine, tenant_id: str, *, limit: int) -> list[sa.Row[Any]]:
    """Return the tenant's newest devices."""
    with read(engine) as tx:
        order = (device_profile.c.created_at.desc(), device_profile.c.id)
        query = sa.select(device_profile).where(device_profile.c.tenant_id == tenant_id)
        return list(tx.execute(query.order_by(*order).limit(limit)))


def add_samples(
    engine: sa.Engine, tenant_id: str, device_id: str, frames: Sequence[Sequence[float]]
) -> list[list[float]]:
    """Keep the frames and return all that the device has, in the order in which they came.

    Raises DeviceNotFound, and SamplesInvalid where they would be too many.
    """
    with write(engine) as tx:
        counted = tx.scalar(
            sa.update(device_profile)
            .where(
                device_profile.c.id == device_id, device_profile.c.tenant_id == tenant_id,
                device_profile.c.n_samples <= MAX_SAMPLES - len(frames),
            )
            .values(n_samples=device_profile.c.n_samples + len(frames)).returning(device_profile.c.n_samples)
        )  # fmt: skip
        if counted is None:
            there = _row(tx, tenant_id, device_id).n_samples
            raise SamplesInvalid(f"{there} samples are there; {len(frames)} more would be over {MAX_SAMPLES}")
        if frames:
            tx.execute(
                sa.insert(device_sample).values(
                    tenant_id=tenant_id, device_profile_id=device_id, first=counted - len(frames),
                    frames=[list(f) for f in frames], created_at=now(),
                )
            )  # fmt: skip
        batches = tx.scalars(
            sa.select(device_sample.c.frames).where(device_sample.c.device_profile_id == device_id)
            .order_by(device_sample.c.first)
        )  # fmt: skip
        return [frame for batch in batches for frame in batch]


def keep_fit(
    engine: sa.Engine, device_id: str, *, n_fitted: int, model: dict[str, Any] | None, refusal: dict[str, str] | None
) -> None:
    """Keep what a fit to the first `n_fitted` samples gave, unless one to more of them has come before it.

    A refusal leaves the model that there is: samples are only ever added.
    """
    values: dict[str, Any] = {"n_fitted": n_fitted, "refusal": refusal}
    if model is not None:
        values["model"] = model
    with write(engine) as tx:
        tx.execute(
            sa.update(device_profile)
            .where(device_profile.c.id == device_id, device_profile.c.n_fitted <= n_fitted)
            .values(**values)
        )


def _row(tx: sa.Connection, tenant_id: str, device_id: str) -> sa.Row[Any]:
    row = tx.execute(
        sa.select(device_profile).where(device_profile.c.id == device_id, device_profile.c.tenant_id == tenant_id)
    ).one_or_none()
    if row is None:
        raise DeviceNotFound(device_id)
    return row
