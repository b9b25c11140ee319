"""Find what is wrong: blobs against their digests and rows, references, the numbering of events, states that cannot be.

Reads only, and may run while the service works: what changes meanwhile is looked at again before it is called wrong.
Nothing it calls right is wrong by more than what happened since it looked; `store.repair` mends what can be mended.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import sqlalchemy as sa

from farfield.errors import ArtifactDamaged, ArtifactMissing
from farfield.stages import Stage
from farfield.store.artifacts import Artifacts
from farfield.store.collect import references
from farfield.store.engine import now, read
from farfield.store.jobs import ENDED
from farfield.store.tables import artifact, event, job, scene, shard, stage

LATE_S = 300.0  # past its end, a lease that nobody took back says that no reconciler runs
OPEN = ("ready", "running")
FILES = str(Stage.PLACEMENTDB)  # the stage whose artifact clients fetch


@dataclass(frozen=True, slots=True, order=True)
class Finding:
    """One thing. `kind`: a word for what is wrong; `of`: what it is about (a digest, a job's id); `note`: no fault by itself."""

    kind: str
    of: str
    text: str
    note: bool = False


def check(
    engine: sa.Engine, artifacts: Artifacts, *, hashes: bool = True, seen: Callable[[int], object] = int
) -> list[Finding]:
    """Return everything found, in order of kind.

    hashes  read every blob and compare it with its name; else only sizes
    seen    told the bytes of each blob when it has been looked at
    """
    found = [*_blobs(engine, artifacts, hashes, seen), *_references(engine), *_events(engine), *_states(engine)]
    return sorted(found)


def needed(engine: sa.Engine, digest: str) -> bool:
    """Say whether somebody will miss the artifact: who fetches a scene, a report or a placement, or a job that runs.

    Else it only saved work: pieces and results of jobs that have ended.
    """
    scenes = [column for column in references() if column.table is scene]
    alive = job.c.state.in_(("queued", "running"))
    of_stage = sa.select(stage.c.id).join(job, job.c.id == stage.c.job_id)
    queries = [
        sa.select(job.c.id).where(job.c.report_digest == digest),
        of_stage.where(stage.c.artifact_digest == digest, alive | ((stage.c.name == FILES) & (job.c.state == "done"))),
        of_stage.join(shard, shard.c.stage_id == stage.c.id)
        .where(shard.c.artifact_digest == digest, alive, stage.c.finished_at.is_(None)),
        *(sa.select(column).where(column == digest) for column in scenes),
    ]  # fmt: skip
    with read(engine) as tx:
        return any(tx.execute(query.limit(1)).first() is not None for query in queries)


def _blobs(engine: sa.Engine, artifacts: Artifacts, hashes: bool, seen: Callable[[int], object]) -> Iterator[Finding]:
    with read(engine) as tx:
        rows = dict(tx.execute(sa.select(artifact.c.digest, artifact.c.n_bytes)).tuples().all())
    stored = set()
    for blob in artifacts.blobs():
        stored.add(blob.digest)
        damaged = hashes and _damaged(artifacts, blob.digest)
        seen(blob.n_bytes)
        if damaged:
            yield Finding("damaged", blob.digest, "the blob does not have the digest that it is named by")
        elif blob.digest not in rows:
            with read(engine) as tx:
                known = tx.scalar(sa.select(artifact.c.n_bytes).where(artifact.c.digest == blob.digest))
            if known is None:
                yield Finding("stray", blob.digest, "no row knows this blob: it will be collected", note=True)
        elif blob.n_bytes != rows[blob.digest]:
            text = f"{blob.n_bytes} bytes are stored, the row says {rows[blob.digest]}"
            yield Finding("size" if hashes else "damaged", blob.digest, text)
    for digest in sorted(set(rows) - stored):
        if artifacts.has(digest):  # stored since the listing
            continue
        with read(engine) as tx:
            if tx.scalar(sa.select(artifact.c.digest).where(artifact.c.digest == digest)) is None:  # collected since
                continue
        if needed(engine, digest):
            yield Finding("missing", digest, "it is needed, and it is not stored")
        else:
            yield Finding("leftover", digest, "it is not stored; it would only save work", note=True)


def _damaged(artifacts: Artifacts, digest: str) -> bool:
    try:
        for _ in artifacts.stream(digest):  # a whole blob is checked when it is opened
            break
    except ArtifactDamaged:
        return True
    except ArtifactMissing:  # removed since the listing
        pass
    return False


def _references(engine: sa.Engine) -> Iterator[Finding]:
    for column in references():
        with read(engine) as tx:
            lost = column.is_not(None) & ~sa.exists().where(artifact.c.digest == column)
            for digest in tx.scalars(sa.select(column).where(lost).distinct()):
                text = f"{column.table.name}.{column.name} refers to it, and it has no row"
                yield Finding("dangling", str(digest), text)


def _events(engine: sa.Engine) -> Iterator[Finding]:
    counted = (
        sa.select(event.c.job_id, sa.func.count().label("n"), sa.func.min(event.c.seq).label("first"),
                  sa.func.max(event.c.seq).label("last"))
        .group_by(event.c.job_id).subquery()
    )  # fmt: skip
    query = sa.select(job.c.id, job.c.event_seq, counted).join(counted, counted.c.job_id == job.c.id, isouter=True)
    with read(engine) as tx:
        for r in tx.execute(query).all():
            # The oldest may be past their time; what is left has no gap, and the last one is there.
            if (r.n or 0) != (r.last or 0) - (r.first or 1) + 1 or (r.last or 0) != r.event_seq:
                text = f"events {r.first} to {r.last} are {r.n} in number, and the counter stands at {r.event_seq}"
                yield Finding("events", r.id, text)


def _states(engine: sa.Engine) -> Iterator[Finding]:
    alive = job.c.state.in_(("queued", "running"))
    of_job = shard.c.job_id == job.c.id
    with read(engine) as tx:
        ended = sa.select(job.c.id).where(job.c.state.in_(ENDED), sa.exists().where(of_job, shard.c.state.in_(OPEN)))
        for job_id in tx.scalars(ended):
            yield Finding("open-shards", job_id, "the job has ended, and has shards that are ready or running")
        for r in tx.execute(
            sa.select(job.c.id, stage.c.name).join(stage, stage.c.job_id == job.c.id)
            .where(stage.c.state.in_(("done", "skipped")), stage.c.artifact_digest.is_(None))
        ):  # fmt: skip
            yield Finding("no-result", r.id, f"stage {r.name} is done, and has no artifact")
        for job_id in tx.scalars(sa.select(job.c.id).where(job.c.state == "done", job.c.report_digest.is_(None))):
            yield Finding("no-report", job_id, "the job is done, and has no report")
        done = sa.select(sa.func.count()).where(
            shard.c.stage_id == stage.c.id, shard.c.kind == "run", shard.c.state == "done"
        ).scalar_subquery()  # fmt: skip
        miscounted = (
            sa.select(job.c.id, stage.c.name, stage.c.n_done, done.label("n"))
            .join(stage, stage.c.job_id == job.c.id).where(alive, stage.c.state == "running", stage.c.n_done != done)
        )  # fmt: skip
        for job_id, name, n_done, n in tx.execute(miscounted):
            yield Finding("count", job_id, f"stage {name} counts {n_done} shards as done, and {n} are")
        holds = sa.exists().where(shard.c.id == job.c.optimizer_shard_id, shard.c.state == "running")
        for job_id in tx.scalars(sa.select(job.c.id).where(job.c.optimizer_until > now(), alive, ~holds)):
            yield Finding("optimizer", job_id, "its optimizer lease is held by a shard that does not run", note=True)
        late = sa.select(job.c.id).where(
            alive, sa.exists().where(of_job, shard.c.state == "running", shard.c.lease_until < now() - LATE_S)
        )
        for job_id in tx.scalars(late):
            yield Finding("late", job_id, "a lease ran out and nobody took it back: does the reconciler run?")
        still = ~sa.exists().where(of_job, shard.c.state.in_(OPEN))
        for job_id in tx.scalars(sa.select(job.c.id).where(alive, still)):
            yield Finding("still", job_id, "no shard of it is ready or running: the reconciler moves it on", note=True)
