"""Devices of a tenant: the frames measured on them, and the profile fitted to these."""

import hashlib
import json
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa

from farfield.errors import DeviceExists, DeviceNotFound, IdempotencyConflict, QuotaExceeded, SamplesInvalid
from farfield.rendertime.samples import MAX_SAMPLES
from farfield.store.engine import insert, new_id, now, read, write
from farfield.store.pages import Cursor, holding, newest_first, owned
from farfield.store.tables import device_profile, device_sample, job

MAX_DEVICES = 200  # of a tenant


def create(engine: sa.Engine, tenant_id: str, *, name: str, model: dict[str, Any] | None) -> str:
    """Return the id of a new device, with a stated profile or none yet. Raises DeviceExists, QuotaExceeded."""
    with write(engine) as tx:
        mine = device_profile.c.tenant_id == tenant_id
        if tx.scalar(sa.select(device_profile.c.id).where(mine, device_profile.c.name == name)) is not None:
            raise DeviceExists(name)
        there = tx.scalar(sa.select(sa.func.count()).select_from(device_profile).where(mine)) or 0
        if there >= MAX_DEVICES:
            raise QuotaExceeded("devices", there, MAX_DEVICES)
        device_id = new_id()
        values = {"id": device_id, "tenant_id": tenant_id, "name": name, "model": model, "n_samples": 0, "n_fitted": 0}
        made = tx.execute(insert(tx, device_profile).values(**values, created_at=now()).on_conflict_do_nothing())
        if not made.rowcount:  # on PostgreSQL, two at once
            raise DeviceExists(name)
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


def page(
    engine: sa.Engine, tenant_id: str, *, before: Cursor | None = None, limit: int, name: str | None = None
) -> list[sa.Row[Any]]:
    """Return the tenant's newest devices after the cursor; `name`: with this in their name."""
    query = sa.select(device_profile).where(owned(device_profile.c.tenant_id, tenant_id))
    if name is not None:
        query = query.where(holding(device_profile.c.name, name))
    at, last = device_profile.c.created_at, device_profile.c.id
    with read(engine) as tx:
        return list(tx.execute(newest_first(query, at, last, before=before, limit=limit)))


def delete(engine: sa.Engine, tenant_id: str, device_id: str) -> None:
    """Delete a device with its samples; jobs keep the figures that they were made with. Raises DeviceNotFound."""
    with write(engine) as tx:
        _row(tx, tenant_id, device_id, lock=True)
        tx.execute(sa.update(job).where(job.c.device_profile_id == device_id).values(device_profile_id=None))
        tx.execute(sa.delete(device_sample).where(device_sample.c.device_profile_id == device_id))
        tx.execute(sa.delete(device_profile).where(device_profile.c.id == device_id))


def frames_with(
    engine: sa.Engine, tenant_id: str, device_id: str, more: Sequence[Sequence[float]], *, idempotency_key: str | None
) -> tuple[int, list[list[float]]] | None:
    """Return (number of frames that the device has, these and `more`, in the order in which they came).

    None where a request with this key has brought its frames already. Raises DeviceNotFound, SamplesInvalid where they
    would be too many, and IdempotencyConflict where the key came with other frames.
    """
    with read(engine) as tx:
        row = _row(tx, tenant_id, device_id)
        if idempotency_key is not None and _known(tx, device_id, idempotency_key, more):
            return None
        if row.n_samples + len(more) > MAX_SAMPLES:
            raise SamplesInvalid(f"{row.n_samples} samples are there; {len(more)} more would be over {MAX_SAMPLES}")
        batches = tx.scalars(
            sa.select(device_sample.c.frames).where(device_sample.c.device_profile_id == device_id)
            .order_by(device_sample.c.first)
        )  # fmt: skip
        there = [frame for batch in batches for frame in batch][: row.n_samples]
    return row.n_samples, [*there, *map(list, more)]


def keep(
    engine: sa.Engine, tenant_id: str, device_id: str, more: Sequence[Sequence[float]], *, n_before: int,
    model: dict[str, Any] | None, refusal: dict[str, str] | None, idempotency_key: str | None = None,
) -> bool:  # fmt: skip
    """Keep frames together with the fit to them and the `n_before` before them, or nothing.

    False where others have come meanwhile: read again, fit again. A refusal leaves the model that there is: samples are
    only ever added. Raises DeviceNotFound.
    """
    values: dict[str, Any] = {"n_samples": n_before + len(more), "n_fitted": n_before + len(more), "refusal": refusal}
    if model is not None:
        values["model"] = model
    with write(engine) as tx:
        row = _row(tx, tenant_id, device_id, lock=True)
        if row.n_samples != n_before:
            return False
        if more:
            tx.execute(
                sa.insert(device_sample).values(
                    tenant_id=row.tenant_id, device_profile_id=device_id, first=n_before, frames=[list(f) for f in more],
                    idempotency_key=idempotency_key, created_at=now(),
                    request_digest=_digest(more) if idempotency_key is not None else None,
                )
            )  # fmt: skip
        tx.execute(sa.update(device_profile).where(device_profile.c.id == device_id).values(**values))
    return True


def _known(tx: sa.Connection, device_id: str, key: str, more: Sequence[Sequence[float]]) -> bool:
    digest = tx.scalar(
        sa.select(device_sample.c.request_digest)
        .where(device_sample.c.device_profile_id == device_id, device_sample.c.idempotency_key == key)
    )  # fmt: skip
    if digest is not None and digest != _digest(more):
        raise IdempotencyConflict(key)
    return digest is not None


def _digest(frames: Sequence[Sequence[float]]) -> str:
    return hashlib.sha256(json.dumps([list(f) for f in frames]).encode()).hexdigest()


def _row(tx: sa.Connection, tenant_id: str, device_id: str, *, lock: bool = False) -> sa.Row[Any]:
    query = sa.select(device_profile).where(
        device_profile.c.id == device_id, owned(device_profile.c.tenant_id, tenant_id)
    )
    row = tx.execute(query.with_for_update() if lock else query).one_or_none()
    if row is None:
        raise DeviceNotFound(device_id)
    return row
