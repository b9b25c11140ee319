"""What takes how much room: artifacts by what they are, and each tenant against its quota."""

from typing import Any

import sqlalchemy as sa

from farfield.store.collect import unreferenced
from farfield.store.engine import read
from farfield.store.tables import artifact, event, job, scene, shard, stage, tenant


def by_kind(engine: sa.Engine) -> dict[str, dict[str, int]]:
    """Return number and bytes of artifacts of each kind; one that is several counts as the first of them.

    scenes, results (of stages), reports, pieces (of stages: what the next job need not compute), unreferenced, other
    """
    kinds = {
        "scenes": (scene.c.digest, scene.c.inspect_digest, scene.c.picture_digest),
        "results": (stage.c.artifact_digest,),
        "reports": (job.c.report_digest,),
        "pieces": (shard.c.artifact_digest,),
    }
    whens = [
        (sa.or_(*(sa.exists().where(column == artifact.c.digest) for column in columns)), name)
        for name, columns in kinds.items()
    ]
    kind = sa.case(*whens, (unreferenced(), "unreferenced"), else_="other").label("kind")
    named = sa.select(kind, artifact.c.n_bytes).subquery()
    counted = sa.select(named.c.kind, sa.func.count(), sa.func.sum(named.c.n_bytes)).group_by(named.c.kind)
    with read(engine) as tx:
        found = {name: (number, int(n_bytes or 0)) for name, number, n_bytes in tx.execute(counted)}
    return {
        name: dict(zip(("artifacts", "bytes"), found.get(name, (0, 0)), strict=True))
        for name in (*kinds, "unreferenced", "other")
    }


def n_events(engine: sa.Engine) -> int:
    """Return how many events are kept."""
    with read(engine) as tx:
        return int(tx.scalar(sa.select(sa.func.count()).select_from(event)) or 0)


def by_tenant(engine: sa.Engine) -> list[dict[str, Any]]:
    """Return each tenant's scenes and jobs, the bytes of its scenes, and its quota (null: the service's own)."""
    count = sa.func.count()
    sent = sa.select(scene.c.tenant_id, count, sa.func.sum(scene.c.n_bytes)).group_by(scene.c.tenant_id)
    with read(engine) as tx:
        scenes = {t: (n, int(b or 0)) for t, n, b in tx.execute(sent)}
        jobs: dict[str, int] = dict(
            tx.execute(sa.select(job.c.tenant_id, count).group_by(job.c.tenant_id)).tuples().all()
        )
        rows = tx.execute(sa.select(tenant.c.id, tenant.c.name, tenant.c.max_bytes).order_by(tenant.c.name)).all()
    return [
        {"tenant": r.id, "name": r.name, "scenes": scenes.get(r.id, (0, 0))[0],
         "scene_bytes": scenes.get(r.id, (0, 0))[1], "jobs": jobs.get(r.id, 0), "max_bytes": r.max_bytes}
        for r in rows
    ]  # fmt: skip
