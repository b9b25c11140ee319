"""Uploaded scenes: one row for each tenant that sent the file, one blob for all of them."""

from collections.abc import Callable
from typing import Any

import sqlalchemy as sa

from farfield.errors import ArtifactMissing, SceneInUse, SceneNotFound
from farfield.store import quotas
from farfield.store.engine import insert, now, read, write
from farfield.store.pages import Cursor, holding, newest_first, owned
from farfield.store.quotas import Quota
from farfield.store.shards import put_artifact
from farfield.store.tables import job, scene


def add(
    engine: sa.Engine, tenant_id: str, *, digest: str, name: str, suffix: str, n_bytes: int, summary: dict[str, Any],
    inspect_digest: str, inspect_bytes: int, picture_digest: str | None = None, picture_bytes: int = 0,
    quota: Quota | None = None, check: Callable[[str], bool] = bool,
) -> None:  # fmt: skip
    """Accept a scene whose blobs are stored; sent again it keeps its first row. Raises QuotaExceeded, ArtifactMissing.

    quota  of tenants that have none of their own; None: not looked at
    check  says whether a blob is there: asked while the rows are held, for one may have been collected meanwhile
    """
    with write(engine) as tx:
        there = sa.select(scene.c.digest).where(scene.c.tenant_id == tenant_id, scene.c.digest == digest)
        if quota is not None and tx.scalar(there) is None:
            quotas.check_bytes(tx, tenant_id, quota, n_bytes + inspect_bytes + picture_bytes)
        blobs = ((digest, n_bytes), (inspect_digest, inspect_bytes), (picture_digest, picture_bytes))
        for blob, size in sorted((blob, size) for blob, size in blobs if blob is not None):
            put_artifact(tx, blob, size)
            if not check(blob):
                raise ArtifactMissing(blob)
        values = {
            "tenant_id": tenant_id, "digest": digest, "name": name, "suffix": suffix, "n_bytes": n_bytes,
            "summary": summary, "inspect_digest": inspect_digest, "picture_digest": picture_digest, "created_at": now(),
        }  # fmt: skip
        tx.execute(insert(tx, scene).values(values).on_conflict_do_nothing())


def get(engine: sa.Engine, tenant_id: str, digest: str) -> sa.Row[Any]:
    """Return the scene's row. Raises SceneNotFound where this tenant has not sent it."""
    with read(engine) as tx:
        row = tx.execute(
            sa.select(scene).where(owned(scene.c.tenant_id, tenant_id), scene.c.digest == digest).limit(1)
        ).one_or_none()
    if row is None:
        raise SceneNotFound(digest)
    return row


def page(
    engine: sa.Engine, tenant_id: str, *, before: Cursor | None = None, limit: int, name: str | None = None
) -> list[sa.Row[Any]]:
    """Return the tenant's newest scenes after the cursor; `name`: with this in their name."""
    query = sa.select(scene).where(owned(scene.c.tenant_id, tenant_id))
    if name is not None:
        query = query.where(holding(scene.c.name, name))
    with read(engine) as tx:
        return list(tx.execute(newest_first(query, scene.c.created_at, scene.c.digest, before=before, limit=limit)))


def delete(engine: sa.Engine, tenant_id: str, digest: str, *, dry_run: bool) -> dict[str, int]:
    """Delete a scene that no job needs; return what goes with it, counted within the tenant (see jobs.delete).

    Its blobs are left to the collection of garbage. Raises SceneNotFound, SceneInUse; a dry run never the latter.
    """
    with write(engine) as tx:
        mine = (scene.c.tenant_id == tenant_id) & (scene.c.digest == digest)
        if tx.execute(sa.select(scene.c.digest).where(mine).with_for_update()).one_or_none() is None:
            raise SceneNotFound(digest)
        used = sa.select(sa.func.count()).where(job.c.tenant_id == tenant_id, job.c.scene_digest == digest)
        jobs = tx.scalar(used) or 0
        of, but = quotas.scene_digests(tenant_id, digest), quotas.digests(tenant_id, but_scene=digest)
        number, n_bytes = quotas.needed_bytes(tx, of=of, but=but)
        if not dry_run:
            if jobs:
                raise SceneInUse(digest, jobs)
            tx.execute(sa.delete(scene).where(mine))
        return {"jobs": jobs, "artifacts": number, "bytes": n_bytes}
