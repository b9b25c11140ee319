"""What a worker does when the store, the disk, the clock or its own process fails, one fault at a time."""

import errno
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import sqlalchemy as sa
from farfield.stages import Stage
from farfield.store import counters, failures, jobs, progress, shards
from farfield.store.engine import now, write
from farfield.store.tables import job, shard
from farfield_workers.work import advance


def reach(bench, message, name, kind="run"):
    """Work until a shard of this stage and kind is ready, and return its message."""
    waiting = [message]
    while True:
        fresh = bench.work(waiting.pop(0))
        for at in fresh:
            with write(bench.engine) as tx:
                row = tx.execute(sa.select(shard).where(shard.c.id == at.shard_id)).one()
                of = tx.scalar(sa.text("SELECT name FROM stage WHERE id = :id"), {"id": row.stage_id})
            if (of, row.kind) == (name, kind):
                return at
        waiting += fresh


def with_step(bench, stage, **fields):
    steps = bench.pipeline.steps
    bench.pipeline = replace(bench.pipeline, steps={**steps, stage: replace(steps[stage], **fields)})


def spoil(path: Path, how: str):
    if how == "missing":
        path.unlink()
        return
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize("how", ["damaged", "missing"])
def test_an_artifact_that_the_store_has_altered_is_computed_again_to_the_same_bytes(in_process, how):
    calm, message = in_process.submit(skip=False)
    in_process.run(message)
    expected = in_process.results(calm)
    job_id, message = in_process.submit(skip=False, other=1)
    at = reach(in_process, message, "placement")
    stages = in_process.stages(job_id)
    for name in ("viewspace", "candidates", "hierarchy"):  # merges, with their pieces, and what both rest on
        spoil(in_process.artifacts.path(stages[name]["artifact"]), how)
    with write(in_process.engine) as tx:
        rows = tx.execute(sa.select(shard.c.artifact_digest).where(shard.c.job_id == job_id, shard.c.kind == "run"))
        for digest in {d for (d,) in rows if d and in_process.artifacts.path(d).exists()}:
            if digest not in [*expected.values(), stages["hierarchy"]["artifact"], in_process.job(job_id).scene_digest]:
                spoil(in_process.artifacts.path(digest), how)
    before = {n: s["artifact"] for n, s in stages.items() if s["artifact"]}
    in_process.run(at)
    row = in_process.job(job_id)
    assert (row.state, row.verdict) == ("done", "valid"), row.error
    after = in_process.results(job_id)
    assert {n: after[n] for n in before} == before
    with write(in_process.engine) as tx:  # nobody's attempt, and nobody's second commit
        assert set(tx.scalars(sa.select(shard.c.attempt).where(shard.c.job_id == job_id))) == {1}


def test_an_upload_that_is_lost_fails_the_job_by_name(in_process):
    job_id, message = in_process.submit()
    (at,) = in_process.work(message)
    in_process.artifacts.path(in_process.job(job_id).scene_digest).unlink()
    in_process.run(at)
    row = in_process.job(job_id)
    assert (row.state, row.error["code"]) == ("failed", "ArtifactLost")
    assert "Upload" in row.error["advice"]


def test_a_report_that_is_lost_before_the_job_ends_fails_it_and_a_retry_writes_it_anew(in_process, monkeypatch):
    job_id, message = in_process.submit()
    at = reach(in_process, message, str(list(Stage)[-1]), kind="report")
    with monkeypatch.context() as dying:  # the worker ends between its commit and the next step
        dying.setattr("farfield_workers.work.advance", lambda *_: [])
        in_process.work(at)
    assert progress.standing_still(in_process.engine) == [job_id]
    with write(in_process.engine) as tx:
        digest = tx.scalar(sa.select(shard.c.artifact_digest).where(shard.c.id == at.shard_id))
    in_process.artifacts.path(digest).unlink()
    pieces = in_process.engine, in_process.artifacts, in_process.pipeline, in_process.settings
    assert advance(*pieces, job_id) == []
    row = in_process.job(job_id)
    assert (row.state, row.error["code"]) == ("failed", "ArtifactLost")
    for again in jobs.retry(in_process.engine, in_process.tenant_id, job_id):
        in_process.run(again)
    assert (in_process.job(job_id).state, in_process.job(job_id).verdict) == ("done", "valid")


def test_a_full_disk_puts_a_shard_off_and_costs_it_no_attempt(in_process, monkeypatch):
    full, plain = [], in_process.pipeline.steps[Stage.HIERARCHY].run

    def run(inputs, shard_):
        if len(full) < 5:
            full.append(1)
            raise OSError(errno.ENOSPC, "No space left on device", "/a/path")
        return plain(inputs, shard_)

    with_step(in_process, Stage.HIERARCHY, run=run)
    monkeypatch.setattr(failures, "PUT_OFF_S", (0.0,))
    job_id, message = in_process.submit()
    in_process.run(message)
    assert in_process.job(job_id).state == "done"
    with write(in_process.engine) as tx:
        rows = tx.execute(sa.select(shard.c.attempt, shard.c.put_off).where(shard.c.put_off > 0)).all()
    assert [(r.attempt, r.put_off) for r in rows] == [(1, 5)]


def test_a_disk_that_stays_full_fails_the_job_by_name_and_tells_no_path(in_process, monkeypatch):
    def run(inputs, shard_):
        raise OSError(errno.ENOSPC, "No space left on device", "/a/secret/path")

    with_step(in_process, Stage.HIERARCHY, run=run)
    monkeypatch.setattr(failures, "PUT_OFF_S", (0.0,))
    monkeypatch.setattr(failures, "MAX_PUT_OFF", 3)
    job_id, message = in_process.submit()
    in_process.run(message)
    error = in_process.job(job_id).error
    assert error["code"] == "DiskFull"
    assert "secret" not in json.dumps(error)
    assert counters.totals(in_process.engine)["job_failures", "code=DiskFull"] == 1


@pytest.mark.parametrize("jump_s", [-7200.0, -40.0, 90.0, 7200.0])
def test_a_clock_that_jumps_costs_work_and_never_a_result(in_process, jump_s):
    job_id, message = in_process.submit()
    old = shards.claim(in_process.engine, message.shard_id, worker="old")
    with write(in_process.engine) as tx:  # what a jump of the database's clock does to every time in the tables
        tx.execute(
            sa.update(shard).values(lease_until=shard.c.lease_until - jump_s, ready_at=shard.c.ready_at - jump_s)
        )
    taken = progress.reclaim(in_process.engine)
    assert taken == (0 if jump_s == -40.0 else 1)  # a small jump back only makes the lease longer
    if taken:
        new = shards.claim(in_process.engine, message.shard_id, worker="new")
        assert not shards.renew(in_process.engine, old)
        progress.release_worker(in_process.engine, "new")
        assert new.attempt == 2
    else:
        assert shards.renew(in_process.engine, old)
        progress.release_worker(in_process.engine, "old")
    in_process.run(message)
    assert in_process.job(job_id).state == "done"


def test_a_lost_shard_is_told_of_and_taken_back_once(in_process):
    job_id, message = in_process.submit()
    shards.claim(in_process.engine, message.shard_id, worker="w", lease_s=-1.0)
    assert progress.reclaim(in_process.engine) == 1
    assert progress.reclaim(in_process.engine) == 0
    in_process.run(message)
    assert in_process.job(job_id).state == "done"


SLEEPER = """
import os, sys, time
sys.path[:0] = {path!r}
from dataclasses import replace
from pathlib import Path
import toy_pipeline
from farfield.stages import Stage
from farfield.store.artifacts import LocalArtifacts
from farfield.store.engine import open_engine
from farfield_workers.settings import WorkerSettings
from farfield_workers.work import work

def run(inputs, shard):
    begun = inputs.checkpoint.read_text() if inputs.checkpoint.exists() else ""
    Path({told!r}).write_text("begun " + begun)
    for k in range(400):
        inputs.checkpoint.write_text(f"old {{k}}")
        time.sleep(0.05)
    return [b"late"]

steps = toy_pipeline.PIPELINE.steps
pipeline = replace(toy_pipeline.PIPELINE, isolated=frozenset(),
                   steps={{**steps, Stage.PLACEMENT: replace(steps[Stage.PLACEMENT], run=run)}})
settings = WorkerSettings(database_url={url!r}, broker_url="", artifacts=Path({artifacts!r}), worker="old", pipeline="",
                          lease_s=1.0, renew_s=0.1, scene_memory_bytes=1, scene_seconds=1)
print(work(open_engine(settings.database_url), LocalArtifacts(settings.artifacts), pipeline, settings, {shard!r}))
"""


def test_an_optimizer_that_slept_past_its_lease_writes_nothing_not_even_its_checkpoint(in_process, tmp_path):
    job_id, message = in_process.submit()
    place = reach(in_process, message, "placement")
    told, here = tmp_path / "told", Path(__file__).parents[1]
    script = SLEEPER.format(
        path=[str(here)], told=str(told), url=str(in_process.engine.url.render_as_string(hide_password=False)),
        artifacts=str(in_process.settings.artifacts), shard=place.shard_id,
    )  # fmt: skip
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as old:
        try:
            end = time.monotonic() + 60
            checkpoints = in_process.artifacts.checkpoints
            while not list(checkpoints.iterdir()) and time.monotonic() < end:
                time.sleep(0.05)
            old.send_signal(signal.SIGSTOP)
            (left,) = [path for path in checkpoints.iterdir() if path.suffix != ".part"]
            assert left.read_text().startswith("old ")
            while not progress.reclaim(in_process.engine) and time.monotonic() < end:
                time.sleep(0.1)
            seen = []

            def run(inputs, shard_):
                seen.append(inputs.checkpoint.read_text())
                inputs.checkpoint.write_text("new")
                time.sleep(0.3)  # our own is handed over
                old.send_signal(signal.SIGCONT)
                time.sleep(1.5)
                seen.append(left.read_text())
                return [b"chosen"]

            with_step(in_process, Stage.PLACEMENT, run=run)
            (after,) = in_process.work(place)
            assert old.wait(30) == 0
            assert old.stdout.read().strip() == "[]"  # its commit, its renewal and its checkpoint were refused
        finally:
            old.kill()
    assert seen[0].startswith("old ")
    assert seen[1] == "new"
    with write(in_process.engine) as tx:
        row = tx.execute(sa.select(shard).where(shard.c.id == place.shard_id)).one()
        assert (row.state, row.attempt) == ("done", 2)
        assert tx.scalar(sa.select(job.c.optimizer_token)) == 2
    assert bytes(in_process.artifacts.buffer(row.artifact_digest)) == b"chosen"
    in_process.run(after)
    assert in_process.job(job_id).state == "done"


def test_a_database_that_drops_its_connections_is_asked_again(in_process, monkeypatch):
    commit, failures = shards.commit, []

    def dropping(*args, **more):
        if len(failures) < 2:
            failures.append(1)
            raise sa.exc.OperationalError("COMMIT", {}, Exception("terminating connection"))
        return commit(*args, **more)

    monkeypatch.setattr(shards, "commit", dropping)
    job_id, message = in_process.submit()
    in_process.run(message)
    assert in_process.job(job_id).state == "done"
    with write(in_process.engine) as tx:
        assert set(tx.scalars(sa.select(shard.c.attempt))) == {1}


def test_a_commit_whose_answer_was_lost_is_no_second_one(in_process, monkeypatch):
    commit, lost = shards.commit, []

    def unheard(*args, **more):
        told = commit(*args, **more)
        if not lost:
            lost.append(told)
            raise sa.exc.OperationalError("COMMIT", {}, Exception("connection lost"))
        return told

    monkeypatch.setattr(shards, "commit", unheard)
    job_id, message = in_process.submit()
    assert in_process.work(message) == []  # it cannot know that it was its own
    assert lost == ["last"]
    assert progress.standing_still(in_process.engine) == [job_id]
    (at,) = progress.advance(in_process.engine, in_process.artifacts, job_id, in_process.pipeline.kinds())
    in_process.run(at)
    assert in_process.job(job_id).state == "done"


def test_put_off_shards_wait_no_longer_than_told_where_the_clock_jumps_back(in_process):
    from farfield.store.fair import Host, next_shard

    _, message = in_process.submit()
    for ahead_s, there in ((60.0, False), (7200.0, True), (-1.0, True)):
        with write(in_process.engine) as tx:
            tx.execute(sa.update(shard).where(shard.c.id == message.shard_id).values(ready_at=now() + ahead_s))
        assert (next_shard(in_process.engine, "cpu", Host(name="here")) is not None) == there
