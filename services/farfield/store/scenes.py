"""Uploaded scenes: one row for each tenant that sent the file, one blob for all of them."""

from typing import Any

import sqlalchemy as sa

from farfield.errors import SceneNotFound
from farfield.store.engine import now, read, write
from farfield.store.shards import put_artifact
from farfield.store.tables import scene


def add(
    engine: sa.Engine, tenant_id: str, *, digest: str, name: str, suffix: str, n_bytes: int, summary: dict[str, Any],
    inspect_digest: str, inspect_bytes: int,
) -> None:  # fmt: skip
    """Accept a scene whose blobs are stored; sent again it keeps its first row."""
    with write(engine) as tx:
        put_artifact(tx, digest, n_bytes)
        put_artifact(tx, inspect_digest, inspect_bytes)
        known = tx.scalar(sa.select(scene.c.digest).where(scene.c.tenant_id == tenant_id, scene.c.digest == digest))
        if known is None:
            tx.execute(
                sa.insert(scene).values(
                    tenant_id=tenant_id, digest=digest, name=name, suffix=suffix, n_bytes=n_bytes, summary=summary,
                    inspect_digest=inspect_digest, created_at=now(),
                )
            )  # fmt: skip


def get(engine: sa.Engine, tenant_id: str, digest: str) -> sa.Row[Any]:
    """Return the scene's row. Raises SceneNotFound where this tenant has not sent it."""
    with read(engine) as tx:
        row = tx.execute(sa.select(scene).where(scene.c.tenant_id == tenant_id, scene.c.digest == digest)).one_or_none()
    if row is None:
        raise SceneNotFound(digest)
    return row


def page(engine: sa.Engine, tenant_id: str, *, limit: int) -> list[sa.Row[Any]]:
    """Return the tenant's newest scenes."""
    with read(engine) as tx:
        order = (scene.c.created_at.desc(), scene.c.digest)
        return list(tx.execute(sa.select(scene).where(scene.c.tenant_id == tenant_id).order_by(*order).limit(limit)))
