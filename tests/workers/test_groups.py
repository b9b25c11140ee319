"""Short shards of a large stage go in groups: fewer transactions, and every guarantee that a shard alone has."""

from contextlib import contextmanager

import pytest
import sqlalchemy as sa
from farfield.errors import StoreUnavailable
from farfield.store import events, groups, jobs, progress, shards
from farfield.store.engine import read
from farfield.store.fair import Host, next_shard
from farfield.store.tables import shard
from farfield_workers import work

MANY = 40


@pytest.fixture
def grouping(monkeypatch):
    """Count a stage of 40 shards as large, and shards as short whatever the machine does; return the groups' sizes."""
    sizes, commit = [], groups.commit

    def seen(engine, artifacts, done):
        sizes.append(len(done))
        return commit(engine, artifacts, done)

    monkeypatch.setattr(shards, "EVENT_SHARDS", 10)
    monkeypatch.setattr(work, "GROUP_S", 1e6)
    monkeypatch.setattr(work, "LONGEST_GROUP_S", 1e6)
    monkeypatch.setattr(groups, "commit", seen)
    return sizes


def many_ready(bench, **wish):
    """Return (job id, its 40 shards of `viewspace`, all ready)."""
    job_id, _ = bench.submit(shards=MANY, **wish)
    while len(waiting := progress.ready(bench.engine)) < MANY:
        for message in waiting:
            bench.work(message)
    return job_id, [m.shard_id for m in waiting]


def take(bench, shard_id, most=5, worker="w", **more):
    return shards.claim_group(bench.engine, shard_id, worker=worker, most=lambda stage: most, **more)


def rows(bench, job_id):
    with read(bench.engine) as tx:
        of = (shard.c.job_id == job_id) & (shard.c.kind == "run")
        return {r.id: r for r in tx.execute(sa.select(shard).where(of))}


def done(bench, held, data=b"1"):
    return groups.Done(
        held=held,
        digest=bench.artifacts.put(data),
        n_bytes=len(data),
        key=None,
        seconds=0.1,
        peak_bytes=1,
        cached=False,
    )


def test_groups_end_a_job_with_the_bytes_that_single_shards_make(in_process, grouping, monkeypatch):
    job_id, _ = in_process.submit(shards=MANY)
    in_process.go_on()
    assert max(grouping) > 1, "nothing went in a group"
    told, found = in_process.job(job_id), rows(in_process, job_id)
    assert told.state == "done"
    assert {(r.state, r.attempt, r.claims) for r in found.values()} == {("done", 1, 1)}
    with read(in_process.engine) as tx:
        seen = events.after(tx, job_id, 0, 10_000)
    assert [e["seq"] for e in seen] == list(range(1, told.event_seq + 1))
    results, before = in_process.results(job_id), len(grouping)
    # Not taken over from the first job, and alone.
    monkeypatch.setattr(work, "MOST_IN_GROUP", 1)
    monkeypatch.setattr(shards, "known_result", lambda *_: None)
    other, _ = in_process.submit(shards=MANY)
    in_process.go_on()
    assert in_process.results(other) == results and len(grouping) == before


def test_the_last_shards_of_a_stage_are_left_to_who_is_free(in_process, grouping):
    _, ids = many_ready(in_process)
    assert len(take(in_process, ids[0], most=1000)) == MANY // 8


def test_a_shard_that_fails_fails_alone(in_process, grouping, tmp_path, monkeypatch):
    job_id, ids = many_ready(in_process)
    compute, broken = work._compute, []

    def failing(pipeline, settings, call, *more, **named):
        if call.stage == "viewspace" and call.params == 3 and not broken:
            broken.append(call)
            raise RuntimeError("once")
        return compute(pipeline, settings, call, *more, **named)

    monkeypatch.setattr(work, "_compute", failing)
    work.pace.note(rows(in_process, job_id)[ids[0]].stage_id, 0.001)
    in_process.work(progress.Message(ids[0], "cpu"))
    states = [rows(in_process, job_id)[i] for i in ids]
    assert [r.state for r in states[:3]] == ["done"] * 3
    assert (states[3].state, states[3].attempt) == ("ready", 1), "the one that failed counts an attempt"
    assert {(r.state, r.attempt) for r in states[4:]} == {("ready", 0)}, "the others of the group count none"
    in_process.go_on()
    assert in_process.job(job_id).state == "done"


def test_what_was_taken_over_is_not_written_and_the_rest_is(in_process, grouping):
    job_id, ids = many_ready(in_process)
    group = take(in_process, ids[0], lease_s=-1.0)
    assert len(group) == 5
    stolen = shards.claim(in_process.engine, ids[2], worker="thief")
    assert stolen is not None and stolen.claim == 2
    assert not groups.renew(in_process.engine, group, lease_s=60.0)
    results = [done(in_process, held) for held in group]
    outcome, written = groups.commit(in_process.engine, in_process.artifacts, results)
    assert outcome == "more" and [one.held.shard_id for one in written] == [ids[k] for k in (0, 1, 3, 4)]
    assert rows(in_process, job_id)[ids[2]].state == "running"
    assert groups.give_back(in_process.engine, group) == 0
    assert in_process.stages(job_id)["viewspace"]["shards"]["done"] == 4
    # Again, as who never heard the answer asks: nothing is counted twice.
    assert groups.commit(in_process.engine, in_process.artifacts, results) == ("lost", [])
    assert in_process.stages(job_id)["viewspace"]["shards"]["done"] == 4
    assert shards.commit(
        in_process.engine, stolen, digest=results[0].digest, n_bytes=1, key=None, seconds=0, peak_bytes=1
    )
    assert in_process.stages(job_id)["viewspace"]["shards"]["done"] == 5


def test_a_result_that_is_gone_is_handed_back_and_not_counted(in_process, grouping):
    job_id, ids = many_ready(in_process)
    group = take(in_process, ids[0])
    results = [done(in_process, held, data=str(held.ordinal).encode()) for held in group]
    in_process.artifacts.remove(results[1].digest)
    _, written = groups.commit(in_process.engine, in_process.artifacts, results)
    assert len(written) == 4 and groups.give_back(in_process.engine, group) == 1
    found = rows(in_process, job_id)[ids[1]]
    assert (found.state, found.attempt) == ("ready", 0)


def test_after_a_death_each_is_tried_alone(in_process, grouping):
    _, ids = many_ready(in_process)
    assert len(take(in_process, ids[0], worker="dead")) == 5
    assert progress.release_worker(in_process.engine, "dead") == 5
    assert [len(take(in_process, i)) for i in ids[:5]] == [1] * 5
    assert len(take(in_process, ids[5])) > 1, "what nobody has tried goes together"


def test_a_group_counts_as_one_that_runs_and_takes_the_memory_of_one(in_process, grouping):
    _, ids = many_ready(in_process)
    with in_process.engine.begin() as tx:
        tx.execute(sa.update(shard).where(shard.c.id.in_(ids)).values(need_bytes=100))
    host = Host(name="here", memory_bytes=250)
    assert len(take(in_process, ids[0], host=host)) == 5
    found = next_shard(in_process.engine, "cpu", host)
    assert found is not None and len(take(in_process, found.shard_id, host=host, worker="w2")) > 1
    assert next_shard(in_process.engine, "cpu", host) is None
    assert take(in_process, ids[30], host=host) == []


def test_a_cancelled_job_takes_nothing_of_a_group(in_process, grouping):
    job_id, ids = many_ready(in_process)
    group = take(in_process, ids[0])
    jobs.cancel(in_process.engine, in_process.tenant_id, job_id)
    assert not groups.renew(in_process.engine, group, lease_s=60.0)
    assert groups.commit(in_process.engine, in_process.artifacts, [done(in_process, h) for h in group]) == ("lost", [])
    assert groups.give_back(in_process.engine, group) == 0
    assert {r.state for i, r in rows(in_process, job_id).items() if i in ids} == {"cancelled"}


def test_a_store_that_goes_away_before_the_commit_costs_no_attempt(in_process, grouping, monkeypatch):
    job_id, ids = many_ready(in_process)

    def away(engine, artifacts, done):
        raise StoreUnavailable("the bucket does not answer")

    with monkeypatch.context() as gone:
        gone.setattr(groups, "commit", away)
        work.pace.note(rows(in_process, job_id)[ids[0]].stage_id, 0.001)
        in_process.work(progress.Message(ids[0], "cpu"))
    found = [rows(in_process, job_id)[i] for i in ids]
    assert {(r.state, r.attempt) for r in found} == {("ready", 0)}, "nothing is held by who works on nothing"
    assert [r.put_off for r in found[:2]] == [1, 0]
    with in_process.engine.begin() as tx:
        tx.execute(sa.update(shard).values(ready_at=0.0))
    in_process.go_on()
    assert in_process.job(job_id).state == "done"


def test_a_group_that_is_lost_while_one_of_it_fails_blames_nobody(in_process, grouping, monkeypatch):
    """The lease ends after the failure and before it is told: which of the group failed is not the first."""
    job_id, ids = many_ready(in_process)
    compute = work._compute

    def failing(pipeline, settings, call, *more, **named):
        if call.stage == "viewspace" and call.params == 2:
            raise RuntimeError("once")
        return compute(pipeline, settings, call, *more, **named)

    @contextmanager
    def lost(engine, group, settings, **more):
        yield
        raise work.ShardStopped

    with monkeypatch.context() as at_its_end:
        at_its_end.setattr(work, "_compute", failing)
        at_its_end.setattr(work, "leased", lost)
        work.pace.note(rows(in_process, job_id)[ids[0]].stage_id, 0.001)
        in_process.work(progress.Message(ids[0], "cpu"))
    assert {(r.state, r.attempt, r.error) for r in (rows(in_process, job_id)[i] for i in ids)} == {("ready", 0, None)}
    in_process.go_on()
    assert in_process.job(job_id).state == "done"
