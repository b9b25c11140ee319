"""Files on their way in: one row for each, its tenant's alone; the bytes lie in a file named by the row's id.

`received` is how many bytes survive a power cut: it grows after they are synced, by compare-and-set. What a killed process
wrote beyond it is written over. A row ends as `scene_digest` or as `refusal`, and goes when it expires.
"""

from collections.abc import Mapping
from typing import Any

import sqlalchemy as sa

from farfield.errors import UploadNotFound, UploadsTooMany
from farfield.store.engine import new_id, now, read, write
from farfield.store.tables import upload

_OPEN = sa.and_(upload.c.scene_digest.is_(None), upload.c.refusal.is_(None))


def create(
    engine: sa.Engine, tenant_id: str, *, name: str, n_bytes: int, digest: str | None, lifetime_s: float, most: int
) -> str:
    """Make a row for a file of `n_bytes` and return its id. Raises UploadsTooMany where the tenant has `most` open.

    digest      SHA-256 that the file shall have, where the sender knows it
    lifetime_s  how long it waits for its next bytes
    """
    upload_id = new_id()
    with write(engine) as tx:
        mine = sa.select(sa.func.count()).select_from(upload).where(upload.c.tenant_id == tenant_id, _OPEN)
        if (tx.scalar(mine.where(upload.c.expires_at > now())) or 0) >= most:
            raise UploadsTooMany(most)
        tx.execute(
            sa.insert(upload).values(
                id=upload_id, tenant_id=tenant_id, name=name, n_bytes=n_bytes, digest=digest, received=0,
                created_at=now(), expires_at=now() + lifetime_s,
            )
        )  # fmt: skip
    return upload_id


def get(engine: sa.Engine, tenant_id: str, upload_id: str) -> sa.Row[Any]:
    """Return the row. Raises UploadNotFound where it is another tenant's, never was, or has expired."""
    mine = upload.c.id == upload_id, upload.c.tenant_id == tenant_id, upload.c.expires_at > now()
    with read(engine) as tx:
        row = tx.execute(sa.select(upload).where(*mine)).one_or_none()
    if row is None:
        raise UploadNotFound(upload_id)
    return row


def page(engine: sa.Engine, tenant_id: str, *, digest: str | None = None, limit: int = 50) -> list[sa.Row[Any]]:
    """Return the tenant's uploads, those with most bytes first; of the file with this SHA-256 where one is given."""
    query = sa.select(upload).where(upload.c.tenant_id == tenant_id, upload.c.expires_at > now())
    if digest is not None:
        query = query.where(upload.c.digest == digest)
    with read(engine) as tx:
        return list(tx.execute(query.order_by(upload.c.received.desc(), upload.c.id).limit(limit)))


def advance(engine: sa.Engine, upload_id: str, *, old: int, new: int, lifetime_s: float) -> bool:
    """Say that `new` bytes are safe where `old` were; False where something else has happened meanwhile."""
    with write(engine) as tx:
        changed = tx.execute(
            sa.update(upload)
            .where(upload.c.id == upload_id, upload.c.received == old, _OPEN)
            .values(received=new, expires_at=now() + lifetime_s)
        )
        return changed.rowcount == 1


def finish(
    engine: sa.Engine, upload_id: str, *, scene_digest: str | None = None, refusal: Mapping[str, Any] | None = None
) -> None:
    """Say what became of the file: the scene it is, or why it was refused (status, code, detail, advice)."""
    assert (scene_digest is None) != (refusal is None)
    with write(engine) as tx:
        values = {"scene_digest": scene_digest, "refusal": dict(refusal) if refusal is not None else None}
        tx.execute(sa.update(upload).where(upload.c.id == upload_id).values(**values))


def remove(engine: sa.Engine, upload_id: str) -> None:
    """Forget the row."""
    with write(engine) as tx:
        tx.execute(sa.delete(upload).where(upload.c.id == upload_id))


def expired(engine: sa.Engine) -> list[str]:
    """Return the ids of the rows whose time is over."""
    with read(engine) as tx:
        return list(tx.scalars(sa.select(upload.c.id).where(upload.c.expires_at <= now())))


def waiting(engine: sa.Engine, ids: list[str]) -> set[str]:
    """Return which of `ids` wait for their bytes."""
    found: set[str] = set()
    with read(engine) as tx:
        for start in range(0, len(ids), 500):
            found |= set(tx.scalars(sa.select(upload.c.id).where(upload.c.id.in_(ids[start : start + 500]), _OPEN)))
    return found
