"""What is broken on purpose is found by name, mended where it can be, and the job ends with the same bytes."""

import json

import pytest
import sqlalchemy as sa
from farfield.store import fsck, repair
from farfield.store.engine import read, write
from farfield.store.tables import artifact, event, job, shard, stage


def _damage(bench, digest):
    path = bench.artifacts.path(digest)
    path.chmod(0o644)
    path.write_bytes(b"x" * path.stat().st_size)


def _lose(bench, digest):
    bench.artifacts.path(digest).unlink()


def _wrong(bench):
    return [f for f in fsck.check(bench.engine, bench.artifacts) if not f.note]


def _digests(bench, job_id, name, kind):
    query = sa.select(shard.c.artifact_digest).join(stage, stage.c.id == shard.c.stage_id)
    with read(bench.engine) as tx:
        mine = (shard.c.job_id == job_id) & (stage.c.name == name) & (shard.c.kind == kind)
        return list(tx.scalars(query.where(mine).order_by(shard.c.ordinal)))


def _until(bench, message, name):
    """Work until the first shard of a stage's `run` is ready."""
    waiting = [message]
    while waiting:
        with read(bench.engine) as tx:
            at = tx.execute(
                sa.select(stage.c.name, shard.c.kind).join(shard, shard.c.stage_id == stage.c.id)
                .where(shard.c.id == waiting[0].shard_id)
            ).one()  # fmt: skip
        if (at.name, at.kind) == (name, "run"):
            return
        waiting += bench.work(waiting.pop(0))
    raise AssertionError(f"stage {name} was not reached")


def test_a_clean_service_has_nothing_wrong(in_process):
    in_process.run(in_process.submit()[1])
    assert fsck.check(in_process.engine, in_process.artifacts) == []


@pytest.mark.parametrize("harm, what", [(_damage, "both"), (_damage, "piece"), (_lose, "merge"), (_lose, "piece")])
def test_a_running_job_that_lost_a_result_goes_back_and_ends_with_the_same_bytes(in_process, harm, what):
    calm, message = in_process.submit()
    in_process.run(message)
    expected = in_process.results(calm)
    job_id, message = in_process.submit()
    _until(in_process, message, "bake")
    merged, pieces = (_digests(in_process, job_id, "viewspace", kind) for kind in ("merge", "run"))
    single = _digests(in_process, job_id, "hierarchy", "run")
    for digest in {"merge": merged, "piece": [*merged, pieces[2]], "single": single, "both": [*merged, *single]}[what]:
        harm(in_process, digest)
    found = fsck.check(in_process.engine, in_process.artifacts)
    assert {f.kind for f in found if not f.note} == {"damaged" if harm is _damage else "missing"}
    mended, left = repair.repair(in_process.engine, in_process.artifacts, found)
    assert left == []
    assert any(f"job {job_id}: set back" in text for text in mended)
    in_process.go_on()
    assert in_process.job(job_id).state == "done"
    assert in_process.results(job_id) == expected
    assert _wrong(in_process) == []
    if harm is _damage:
        assert list((in_process.artifacts.root / "quarantine").iterdir())


@pytest.mark.parametrize("what", ["files", "report"])
def test_a_job_that_is_done_and_lost_what_clients_fetch_computes_it_again(in_process, what):
    job_id, message = in_process.submit()
    in_process.run(message)
    before = in_process.results(job_id)
    row = in_process.job(job_id)
    _damage(in_process, before["placementdb"] if what == "files" else row.report_digest)
    _, left = repair.repair(in_process.engine, in_process.artifacts, _wrong(in_process))
    assert left == []
    assert in_process.job(job_id).state == "queued"
    in_process.go_on()
    row = in_process.job(job_id)
    assert (row.state, row.verdict) == ("done", "valid")
    assert in_process.results(job_id) == before
    assert json.loads(bytes(in_process.artifacts.buffer(row.report_digest)))["verdict"] == "valid"
    assert _wrong(in_process) == []


def test_what_only_saved_work_is_no_fault(in_process):
    job_id, message = in_process.submit()
    in_process.run(message)
    _lose(in_process, _digests(in_process, job_id, "viewspace", "run")[0])
    assert [(f.kind, f.note) for f in fsck.check(in_process.engine, in_process.artifacts)] == [("leftover", True)]
    again, message = in_process.submit()
    in_process.run(message)
    assert in_process.job(again).state == "done"
    assert in_process.results(again) == in_process.results(job_id)


def test_a_lost_scene_is_said_and_can_only_be_sent_again(in_process):
    job_id, _ = in_process.submit()
    digest = in_process.job(job_id).scene_digest
    data = in_process.artifacts.path(digest).read_bytes()
    _damage(in_process, digest)
    _, left = repair.repair(in_process.engine, in_process.artifacts, _wrong(in_process))
    assert [(f.kind, f.of) for f in left] == [("missing", digest)]
    in_process.artifacts.put(data)
    assert _wrong(in_process) == []


def test_states_numbers_and_sizes_that_cannot_be_are_found(in_process):
    job_id, message = in_process.submit()
    in_process.run(message)
    second, message = in_process.submit(shards=4, budget="300 calls")
    _until(in_process, message, "viewspace")
    size = _digests(in_process, job_id, "hierarchy", "run")[0]
    with write(in_process.engine) as tx:
        tx.execute(sa.delete(event).where(event.c.job_id == job_id, event.c.seq == 3))
        tx.execute(sa.update(shard).where(shard.c.job_id == job_id, shard.c.kind == "report").values(state="ready"))
        tx.execute(sa.update(artifact).where(artifact.c.digest == size).values(n_bytes=1))
        tx.execute(sa.update(stage).where(stage.c.job_id == second, stage.c.state == "running").values(n_done=3))
        tx.execute(sa.update(job).where(job.c.id == second).values(event_seq=job.c.event_seq - 1))
    found = _wrong(in_process)
    expected = {("events", job_id), ("open-shards", job_id), ("size", size), ("count", second), ("events", second)}
    assert {(f.kind, f.of) for f in found} == expected
    _, left = repair.repair(in_process.engine, in_process.artifacts, found)
    # An event that is gone stays gone: it is said, and nothing is made up.
    assert [(f.kind, f.of) for f in left] == [("events", job_id)]
