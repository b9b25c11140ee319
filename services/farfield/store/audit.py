"""Who did what, when, from where: one row for every change that was asked for with a key, never altered (see tables)."""

from typing import Any

import sqlalchemy as sa

from farfield.store.engine import now, read, write
from farfield.store.pages import owned
from farfield.store.tables import audit

AT_THE_MACHINE = "the operator, at the machine"


def record(
    engine: sa.Engine, tenant_id: str, *, key_id: str | None, key_name: str, address: str, action: str, target: str,
    status: int,
) -> None:  # fmt: skip
    """Add an entry; nothing in it may be secret."""
    with write(engine) as tx:
        tx.execute(
            sa.insert(audit).values(
                tenant_id=tenant_id, key_id=key_id, key_name=key_name[:100], address=address[:100], action=action[:200],
                target=target[:500], status=status, created_at=now(),
            )
        )  # fmt: skip


def page(
    engine: sa.Engine, tenant_id: str, *, before: int | None, limit: int, key_id: str | None = None,
    action: str | None = None, since: float | None = None,
) -> list[sa.Row[Any]]:  # fmt: skip
    """Return up to `limit` entries, newest first, with an id below `before`; `action` as it stands in the entry."""
    query = sa.select(audit).where(owned(audit.c.tenant_id, tenant_id))
    if before is not None:
        query = query.where(audit.c.id < before)
    if key_id is not None:
        query = query.where(audit.c.key_id == key_id)
    if action is not None:
        query = query.where(audit.c.action == action)
    if since is not None:
        query = query.where(audit.c.created_at >= since)
    with read(engine) as tx:
        return list(tx.execute(query.order_by(audit.c.id.desc()).limit(limit)))
