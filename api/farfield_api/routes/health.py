"""Is it alive, is it ready, what does it do: /livez, /readyz, /metrics."""

from typing import Any

import sqlalchemy as sa
from farfield.errors import ServiceError
from farfield.store.engine import now, read
from farfield.store.tables import artifact, job, shard, stage
from fastapi import APIRouter, Response

from farfield_api.auth import Admin
from farfield_api.errors import RESPONSES
from farfield_api.state import Service

router = APIRouter(tags=["health"], responses=RESPONSES)


@router.get("/livez", summary="The process answers")
async def livez() -> dict[str, str]:
    return {"status": "alive"}


@router.get("/readyz", summary="The database and the artifacts can be reached")
def readyz(service: Service) -> dict[str, str]:
    try:
        with read(service.engine) as tx:
            tx.execute(sa.select(sa.func.count()).select_from(sa.select(job.c.id).limit(1).subquery()))
    except sa.exc.SQLAlchemyError as error:
        raise ServiceError("the database does not answer") from error
    if not service.artifacts.temporary.is_dir():
        raise ServiceError("the artifact store is not there")
    return {"status": "ready"}


@router.get("/metrics", response_class=Response, summary="Prometheus metrics; needs the scope admin")
def metrics(caller: Admin, service: Service) -> Response:
    lines: list[str] = []

    def family(name: str, kind: str, text: str, rows: list[tuple[dict[str, Any], Any]]) -> None:
        lines.append(f"# HELP farfield_{name} {text}")
        lines.append(f"# TYPE farfield_{name} {kind}")
        for labels, value in rows:
            inner = ",".join(f'{k}="{v}"' for k, v in labels.items())
            lines.append(
                f"farfield_{name}{{{inner}}} {float(value or 0):.9g}"
                if inner
                else f"farfield_{name} {float(value or 0):.9g}"
            )

    count = sa.func.count()
    with read(service.engine) as tx:
        rows = tx.execute(sa.select(job.c.state, count).group_by(job.c.state)).all()
        family("jobs", "gauge", "Jobs by state.", [({"state": s}, n) for s, n in rows])
        rows = tx.execute(sa.select(shard.c.queue, shard.c.state, count).group_by(shard.c.queue, shard.c.state)).all()
        family("shards", "gauge", "Shards by queue and state.", [({"queue": q, "state": s}, n) for q, s, n in rows])
        waiting = sa.select(shard.c.queue, count, sa.func.max(now() - job.c.created_at)).join(
            job, job.c.id == shard.c.job_id
        )
        rows = tx.execute(waiting.where(shard.c.state == "ready").group_by(shard.c.queue)).all()
        family("queue_depth", "gauge", "Shards ready to run.", [({"queue": q}, n) for q, n, _ in rows])
        family(
            "queue_job_age_seconds",
            "gauge",
            "Age of the oldest job with a shard ready to run.",
            [({"queue": q}, a) for q, _, a in rows],
        )
        done = (
            sa.select(stage.c.name, count, sa.func.sum(shard.c.seconds), sa.func.max(shard.c.peak_bytes))
            .join(stage, stage.c.id == shard.c.stage_id)
            .where(shard.c.state == "done", shard.c.cached.is_(False)).group_by(stage.c.name)
        )  # fmt: skip
        rows = tx.execute(done).all()
        family("shard_seconds_count", "counter", "Shards computed.", [({"stage": s}, n) for s, n, _, _ in rows])
        family(
            "shard_seconds_sum",
            "counter",
            "Seconds spent computing shards.",
            [({"stage": s}, t) for s, _, t, _ in rows],
        )
        family("shard_peak_bytes", "gauge", "Largest memory of a shard.", [({"stage": s}, p) for s, _, _, p in rows])
        rows = tx.execute(
            sa.select(stage.c.name, sa.func.sum(shard.c.attempt - 1)).join(stage, stage.c.id == shard.c.stage_id)
            .where(shard.c.attempt > 1).group_by(stage.c.name)
        ).all()  # fmt: skip
        family("shard_retries", "counter", "Attempts after the first.", [({"stage": s}, n) for s, n in rows])
        n_bytes, number = tx.execute(sa.select(sa.func.sum(artifact.c.n_bytes), count)).one()
        family("artifacts", "gauge", "Artifacts stored.", [({}, number)])
        family("artifact_bytes", "gauge", "Bytes of artifacts stored.", [({}, n_bytes)])
    return Response("\n".join(lines) + "\n", media_type="text/plain; version=0.0.4")
