"""Webhooks of a tenant, and the table of what is to be delivered to them.

A delivery is written in the transaction of the event that it tells of: no event without its deliveries, whatever dies.
Sending is at least once. A sender takes a delivery by moving its `next_at` ahead; where it dies, the delivery is due again.
"""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa

from farfield import webhooks
from farfield.errors import DeliveryNotFound, QuotaExceeded, WebhookNotFound
from farfield.store.engine import new_id, now, read, write
from farfield.store.pages import Cursor, newest_first, owned
from farfield.store.sealed import seal, unseal
from farfield.store.tables import WEBHOOK_EVENTS, job, webhook, webhook_delivery

BACKOFF_S = (5.0, 30.0, 120.0, 600.0, 1800.0, 3600.0, 7200.0, 14400.0, 28800.0)  # after 17 hours it has failed
LEASE_S = 60.0  # more than a sender gives a receiver
OLD_SECRET_S = 24 * 3600.0
KEPT_S = 30 * 86400.0  # what ended is listed for so long
MAX_WEBHOOKS = 100
GONE = 410


@dataclass(frozen=True, slots=True, kw_only=True)
class Delivery:
    """A delivery that is ours to try now."""

    id: str
    webhook_id: str
    url: str
    sealed: tuple[str, ...]  # its secrets, as they are stored
    body: bytes
    attempt: int  # counted from 1

    def secrets(self, key: str | None) -> tuple[str, ...]:
        """Return what it is signed with. Raises ServiceError where `key` is not the one that they were sealed with."""
        return tuple(unseal(key, stored) for stored in self.sealed)


def create(
    engine: sa.Engine, tenant_id: str, *, name: str, url: str, events: Collection[str], every_job: bool,
    key: str | None = None,
) -> tuple[str, str]:  # fmt: skip
    """Return (id, secret) of a new webhook. `events`: of tables.WEBHOOK_EVENTS. Raises QuotaExceeded.

    every_job  told of all jobs of the tenant, or only of those that name it
    key        that seals the secret (`sealed`); None: it is stored as it is
    """
    webhook_id, secret = new_id(), webhooks.new_secret()
    with write(engine) as tx:
        there = tx.scalar(sa.select(sa.func.count()).where(webhook.c.tenant_id == tenant_id).select_from(webhook)) or 0
        if there >= MAX_WEBHOOKS:
            raise QuotaExceeded("webhooks", there, MAX_WEBHOOKS)
        tx.execute(
            sa.insert(webhook).values(
                id=webhook_id, tenant_id=tenant_id, name=name, url=url, secret=seal(key, secret), events=_words(events),
                every_job=every_job, active=True, created_at=now(),
            )
        )  # fmt: skip
    return webhook_id, secret


def get(engine: sa.Engine, tenant_id: str, webhook_id: str) -> sa.Row[Any]:
    """Return the webhook's row without its secrets. Raises WebhookNotFound."""
    with read(engine) as tx:
        return _row(tx, tenant_id, webhook_id)


def page(engine: sa.Engine, tenant_id: str, *, before: Cursor | None, limit: int) -> list[sa.Row[Any]]:
    """Return the tenant's newest webhooks, without secrets."""
    query = sa.select(*_SHOWN).where(owned(webhook.c.tenant_id, tenant_id))
    with read(engine) as tx:
        return list(tx.execute(newest_first(query, webhook.c.created_at, webhook.c.id, before=before, limit=limit)))


def change(
    engine: sa.Engine, tenant_id: str, webhook_id: str, values: Mapping[str, Any], *, expect: Any = bool
) -> None:
    """Change name, url, events, every_job or active. `expect` is called with the row as it is, and may refuse.

    Raises WebhookNotFound.
    """
    told = {**values, "events": _words(values["events"])} if "events" in values else dict(values)
    with write(engine) as tx:
        expect(_row(tx, tenant_id, webhook_id, lock=True))
        if told:
            tx.execute(sa.update(webhook).where(webhook.c.id == webhook_id).values(**told))
        if told.get("active"):
            late = (webhook_delivery.c.webhook_id == webhook_id) & (webhook_delivery.c.state == "pending")
            tx.execute(sa.update(webhook_delivery).where(late).values(next_at=now()))


def rotate(engine: sa.Engine, tenant_id: str, webhook_id: str, *, key: str | None = None) -> str:
    """Return a new secret; for a day deliveries are signed with the old one, too. Raises WebhookNotFound."""
    secret = webhooks.new_secret()
    with write(engine) as tx:
        _row(tx, tenant_id, webhook_id, lock=True)
        tx.execute(
            sa.update(webhook).where(webhook.c.id == webhook_id)
            .values(old_secret=webhook.c.secret, old_until=now() + OLD_SECRET_S, secret=seal(key, secret))
        )  # fmt: skip
    return secret


def delete(engine: sa.Engine, tenant_id: str, webhook_id: str, *, expect: Any = bool) -> None:
    """Delete the webhook with its deliveries. Raises WebhookNotFound."""
    with write(engine) as tx:
        expect(_row(tx, tenant_id, webhook_id, lock=True))
        tx.execute(sa.update(job).where(job.c.webhook_id == webhook_id).values(webhook_id=None))
        tx.execute(sa.delete(webhook_delivery).where(webhook_delivery.c.webhook_id == webhook_id))
        tx.execute(sa.delete(webhook).where(webhook.c.id == webhook_id))


def enqueue(tx: sa.Connection, job_id: str, seq: int, data: Mapping[str, Any]) -> None:
    """Write the deliveries of a job's event, within the transaction that writes the event."""
    row = tx.execute(
        sa.select(job.c.tenant_id, job.c.webhook_id, job.c.name, job.c.scene_digest).where(job.c.id == job_id)
    ).one()
    told = webhook.c.every_job | (webhook.c.id == row.webhook_id)
    hooks = tx.execute(
        sa.select(webhook.c.id, webhook.c.events).where(webhook.c.tenant_id == row.tenant_id, webhook.c.active, told)
    ).all()
    state = str(data.get("state"))
    for hook in hooks:
        if state in hook.events.split():
            about = {"job": job_id, "name": row.name, "scene": row.scene_digest, "seq": seq, **data,
                     "links": {"job": f"/v1/jobs/{job_id}"}}  # fmt: skip
            _add(tx, row.tenant_id, hook.id, f"job.{state}", about, job_id=job_id, seq=seq)


def test(engine: sa.Engine, tenant_id: str, webhook_id: str) -> str:
    """Send a delivery that tells of nothing, and return its id. Raises WebhookNotFound."""
    with write(engine) as tx:
        row = _row(tx, tenant_id, webhook_id)
        return _add(tx, row.tenant_id, webhook_id, "test", {"webhook": webhook_id})


def redeliver(engine: sa.Engine, tenant_id: str, webhook_id: str, delivery_id: str) -> None:
    """Try a delivery again, from the first attempt on. Raises WebhookNotFound, DeliveryNotFound."""
    with write(engine) as tx:
        _row(tx, tenant_id, webhook_id)
        found = (webhook_delivery.c.id == delivery_id) & (webhook_delivery.c.webhook_id == webhook_id)
        values = {"state": "pending", "attempt": 0, "next_at": now(), "ended_at": None}
        if not tx.execute(sa.update(webhook_delivery).where(found).values(**values)).rowcount:
            raise DeliveryNotFound(delivery_id)


def page_of_deliveries(
    engine: sa.Engine, tenant_id: str, webhook_id: str, *, state: str | None, before: Cursor | None, limit: int
) -> list[sa.Row[Any]]:
    """Return the webhook's newest deliveries. Raises WebhookNotFound."""
    with read(engine) as tx:
        _row(tx, tenant_id, webhook_id)
        query = sa.select(webhook_delivery).where(webhook_delivery.c.webhook_id == webhook_id)
        if state is not None:
            query = query.where(webhook_delivery.c.state == state)
        at, last = webhook_delivery.c.created_at, webhook_delivery.c.id
        return list(tx.execute(newest_first(query, at, last, before=before, limit=limit)))


def claim(engine: sa.Engine, *, but: Collection[str] = (), lease_s: float = LEASE_S) -> Delivery | None:
    """Take the delivery that has been due longest, or return None; `but`: webhooks that have enough under way."""
    with write(engine) as tx:
        due = tx.execute(
            sa.select(webhook_delivery.c.id, webhook.c.url, webhook.c.secret, webhook.c.old_secret,
                      (webhook.c.old_until > now()).label("both"))
            .join(webhook, webhook.c.id == webhook_delivery.c.webhook_id)
            .where(webhook_delivery.c.state == "pending", webhook_delivery.c.next_at <= now(), webhook.c.active,
                   webhook_delivery.c.webhook_id.not_in(list(but)))
            .order_by(webhook_delivery.c.next_at, webhook_delivery.c.id).limit(1)
            .with_for_update(skip_locked=True, of=webhook_delivery)
        ).one_or_none()  # fmt: skip
        if due is None:
            return None
        row = tx.execute(
            sa.update(webhook_delivery).where(webhook_delivery.c.id == due.id)
            .values(attempt=webhook_delivery.c.attempt + 1, next_at=now() + lease_s).returning(webhook_delivery)
        ).one()  # fmt: skip
    keys = (due.secret, due.old_secret) if due.both and due.old_secret else (due.secret,)
    return Delivery(
        id=row.id, webhook_id=row.webhook_id, url=due.url, sealed=keys, body=row.body.encode(), attempt=row.attempt
    )


def finish(engine: sa.Engine, tried: Delivery, *, status: int | None, error: str | None) -> None:
    """Write down how the attempt went: delivered, to be tried again later, or failed for good."""
    good = status is not None and 200 <= status < 300
    values: dict[str, Any] = {"status": status, "error": error[:200] if error else None}
    if good or tried.attempt > len(BACKOFF_S) or status == GONE:
        values |= {"state": "delivered" if good else "failed", "ended_at": now(), "next_at": None}
    else:
        values["next_at"] = now() + BACKOFF_S[tried.attempt - 1]
    ours = (webhook_delivery.c.id == tried.id) & (webhook_delivery.c.attempt == tried.attempt)
    with write(engine) as tx:
        tx.execute(sa.update(webhook_delivery).where(ours, webhook_delivery.c.state == "pending").values(**values))
        if status == GONE:  # by the specification: the receiver wants no more
            tx.execute(sa.update(webhook).where(webhook.c.id == tried.webhook_id).values(active=False))


def forget_old(engine: sa.Engine) -> int:
    """Delete deliveries that ended long ago, and return how many."""
    with write(engine) as tx:
        old = webhook_delivery.c.ended_at < now() - KEPT_S
        return tx.execute(sa.delete(webhook_delivery).where(old)).rowcount


_SHOWN = [c for c in webhook.c if c.name not in ("secret", "old_secret", "old_until")]


def _row(tx: sa.Connection, tenant_id: str, webhook_id: str, *, lock: bool = False) -> sa.Row[Any]:
    query = sa.select(*_SHOWN).where(webhook.c.id == webhook_id, owned(webhook.c.tenant_id, tenant_id))
    row = tx.execute(query.with_for_update() if lock else query).one_or_none()
    if row is None:
        raise WebhookNotFound(webhook_id)
    return row


def _words(events: Collection[str]) -> str:
    return " ".join(e for e in WEBHOOK_EVENTS if e in events)


def _add(
    tx: sa.Connection, tenant_id: str, webhook_id: str, event: str, data: Mapping[str, Any], *,
    job_id: str | None = None, seq: int | None = None,
) -> str:  # fmt: skip
    clock = float(tx.scalar(sa.select(now())) or 0.0)
    at = datetime.fromtimestamp(clock, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    body = json.dumps({"type": event, "timestamp": at, "data": dict(data)}, separators=(",", ":"), sort_keys=True)
    delivery_id = new_id()
    tx.execute(
        sa.insert(webhook_delivery).values(
            id=delivery_id, tenant_id=tenant_id, webhook_id=webhook_id, job_id=job_id, seq=seq, event=event, body=body,
            state="pending", attempt=0, next_at=now(), created_at=now(),
        )
    )  # fmt: skip
    return delivery_id
