"""Mend what `fsck` found: put damaged blobs aside, and set jobs back to where what they lost is computed again.

Method   Shards are pure functions, so what is lost is computed again to the same bytes, and everything after it stays
         right. A job that runs, or is done and lost its files or its report, goes back to the first stage that lost
         something: there, only the shards without a blob run again. A later stage that lost something too, that was
         open, or that writes the report, starts over: its shards need what the first one has yet to compute.
Timed    A result that a clock may have stopped has no key, and may come out differently: then all later stages start over.
Not      A scene whose file is lost, while its job still needs it, can only be sent again. Failed and cancelled jobs stay as
         they are: submitted again, they compute what is gone.
"""

from collections.abc import Iterable
from typing import Any

import sqlalchemy as sa

from farfield.store import events
from farfield.store.artifacts import Artifacts, LocalArtifacts
from farfield.store.collect import unreferenced
from farfield.store.engine import read, write
from farfield.store.fsck import FILES, OPEN, Finding, check
from farfield.store.jobs import ENDED
from farfield.store.shards import anew, lock_job
from farfield.store.tables import artifact, event, job, shard, stage

OVER = ("done", "skipped", "failed")


def repair(engine: sa.Engine, artifacts: Artifacts, found: Iterable[Finding]) -> tuple[list[str], list[Finding]]:
    """Mend what can be mended; return what was done, in words, and what is still wrong then."""
    found = list(found)
    done = [f"{f.of}: {quarantine(artifacts, f.of)}" for f in found if f.kind == "damaged"]
    # A piece that nobody needs is needed again where what was made of it is lost.
    lost = {f.of for f in found if f.kind in ("damaged", "missing", "leftover")}
    lost = {digest for digest in lost if not artifacts.has(digest)}
    for job_id in _jobs_that_lost(engine, lost):
        text = set_back(engine, job_id, lost)
        if text:
            done.append(f"job {job_id}: {text}")
    with write(engine) as tx:
        for finding in found:
            done += _mend(tx, artifacts, finding)
    return done, [finding for finding in check(engine, artifacts, hashes=False) if not finding.note]


def quarantine(artifacts: Artifacts, digest: str) -> str:
    """Take the blob away under its name, so that it can be stored anew; return what was done."""
    if not isinstance(artifacts, LocalArtifacts):
        artifacts.remove(digest)  # a bucket with versions keeps it
        return "the damaged blob was removed"
    folder = artifacts.root / "quarantine"
    folder.mkdir(exist_ok=True)
    artifacts.path(digest).rename(folder / digest)
    return "the damaged blob lies in quarantine/ now"


def set_back(engine: sa.Engine, job_id: str, lost: set[str]) -> str:
    """Set a job back to the first stage that lost something it needs; return what was done, "" for nothing."""
    with write(engine) as tx:
        lock_job(tx, job_id)
        row = tx.execute(sa.select(job).where(job.c.id == job_id)).one_or_none()
        if row is None or row.state in ("failed", "cancelled"):
            return ""
        stages = tx.execute(sa.select(stage).where(stage.c.job_id == job_id).order_by(stage.c.ordinal)).all()
        last = stages[-1]
        files = next((s.artifact_digest for s in stages if s.name == FILES), None)
        if row.state == "done" and not {row.report_digest, files} & lost:
            return ""  # what is lost only saved work
        gone = [s for s in stages if s.artifact_digest in lost]
        if gone and gone[0].ordinal == 0 and row.scene_digest in lost:
            return ""
        open_ = next((s for s in stages if s.state not in OVER and s.state != "waiting"), None)
        first = gone[0] if gone else open_ if open_ is not None else last
        name = _restart(tx, first, lost, row.report_digest in lost and not gone)
        if name is None:
            return ""
        timed = gone and _was_timed(tx, first)
        over = row.state == "done"
        for later in stages[first.ordinal + 1 :]:
            if timed or later in gone or later is open_ or (over and later is last):
                _start_over(tx, later)
        held = sa.exists().where(shard.c.id == job.c.optimizer_shard_id, shard.c.state == "running")
        # The lease of an optimizer whose shard has gone would keep the new one waiting; the fence stays.
        tx.execute(
            sa.update(job).where(job.c.id == job_id, ~held).values(optimizer_until=None, optimizer_shard_id=None)
        )
        if over:
            tx.execute(
                sa.update(job).where(job.c.id == job_id)
                .values(state="queued", verdict=None, report_digest=None, figures=None, finished_at=None)
            )  # fmt: skip
            events.append(tx, job_id, "job", {"state": "queued"})
        events.append(tx, job_id, "stage", {"stage": first.name, "state": name})
        return f"set back to {name} stage {first.name}"


def _restart(tx: sa.Connection, at: sa.Row[Any], lost: set[str], report: bool) -> str | None:
    """Let the shards of the stage that have no blob run again; return its new state, None where there is nothing to do."""
    rows = tx.execute(sa.select(shard).where(shard.c.stage_id == at.id)).all()
    gone = {kind: [r for r in rows if r.kind == kind and r.artifact_digest in lost] for kind in ("plan", "run")}
    merge = [r for r in rows if r.kind == "merge"]
    if report:
        state, again = "reporting", [r for r in rows if r.kind == "report"]
    elif at.state == "planning":
        state, again = "planning", gone["plan"]
    elif gone["run"]:
        state, again = "running", gone["run"]
    elif at.artifact_digest in lost:
        # Every piece is there, or there is but one.
        state, again = ("merging", merge) if merge else ("running", [r for r in rows if r.kind == "run"])
    else:
        return None
    old = {r.id for r in again}
    if state in ("running", "merging"):
        old |= {r.id for r in rows if r.kind in ("merge", "report") and (r.kind == "report" or state == "running")}
    tx.execute(sa.delete(shard).where(shard.c.id.in_(old)))
    fresh = [anew(r) for r in again]
    if fresh:
        tx.execute(sa.insert(shard), fresh)
    n_done = sum(r.kind == "run" and r.state == "done" and r.id not in old for r in rows)
    values: dict[str, Any] = {"state": state, "finished_at": None, "n_done": n_done}
    if state != "reporting":
        values["artifact_digest"] = None
    tx.execute(sa.update(stage).where(stage.c.id == at.id).values(values))
    return state if fresh else None


def _start_over(tx: sa.Connection, at: sa.Row[Any]) -> None:
    tx.execute(sa.delete(shard).where(shard.c.stage_id == at.id))
    tx.execute(
        sa.update(stage).where(stage.c.id == at.id).values(
            state="waiting", artifact_digest=None, skipped=None, n_shards=0, n_done=0, started_at=None, finished_at=None
        )
    )  # fmt: skip


def _was_timed(tx: sa.Connection, at: sa.Row[Any]) -> bool:
    done = (shard.c.stage_id == at.id) & shard.c.kind.in_(("run", "merge")) & (shard.c.state == "done")
    return tx.scalar(sa.select(shard.c.id).where(done, shard.c.key.is_(None)).limit(1)) is not None


def _jobs_that_lost(engine: sa.Engine, lost: set[str]) -> list[str]:
    with read(engine) as tx:
        found: set[str] = set()
        for digest in lost:
            found |= set(tx.scalars(sa.select(shard.c.job_id).where(shard.c.artifact_digest == digest)))
            found |= set(tx.scalars(sa.select(job.c.id).where(job.c.report_digest == digest)))
    return sorted(found)


def _mend(tx: sa.Connection, artifacts: Artifacts, finding: Finding) -> list[str]:
    if finding.kind == "size" and artifacts.has(finding.of):
        n_bytes = artifacts.n_bytes(finding.of)
        tx.execute(sa.update(artifact).where(artifact.c.digest == finding.of).values(n_bytes=n_bytes))
        return [f"{finding.of}: its row says {n_bytes} bytes now"]
    if finding.kind == "leftover" and not artifacts.has(finding.of):
        gone = tx.execute(sa.delete(artifact).where(artifact.c.digest == finding.of, unreferenced())).rowcount
        return [f"{finding.of}: its row was removed"] if gone else []
    if finding.kind == "open-shards":
        of = (shard.c.job_id == finding.of) & shard.c.state.in_(OPEN)
        ended = sa.select(job.c.id).where(job.c.id == finding.of, job.c.state.in_(ENDED)).exists()
        tx.execute(sa.update(shard).where(of, ended).values(state="cancelled", lease_until=None))
        return [f"job {finding.of}: its open shards were cancelled"]
    if finding.kind == "count":
        done = sa.select(sa.func.count()).where(
            shard.c.stage_id == stage.c.id, shard.c.kind == "run", shard.c.state == "done"
        ).scalar_subquery()  # fmt: skip
        lock_job(tx, finding.of)
        running = (stage.c.job_id == finding.of) & (stage.c.state == "running")
        tx.execute(sa.update(stage).where(running).values(n_done=done))
        return [f"job {finding.of}: its shards were counted again"]
    if finding.kind == "events":
        top = sa.select(sa.func.coalesce(sa.func.max(event.c.seq), 0)).where(event.c.job_id == job.c.id)
        lock_job(tx, finding.of)
        behind = (job.c.id == finding.of) & (job.c.event_seq < top.scalar_subquery())
        moved = tx.execute(sa.update(job).where(behind).values(event_seq=top.scalar_subquery())).rowcount
        return [f"job {finding.of}: its counter of events was raised"] if moved else []
    return []
