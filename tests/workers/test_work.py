"""The walk of a job through its stages, with everything that may go wrong on the way."""

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
import sqlalchemy as sa
from farfield.errors import JobStillRunning
from farfield.stages import Stage
from farfield.store import collect, events, failures, jobs, progress, shards
from farfield.store.engine import now, read, write
from farfield.store.tables import job, shard, stage


def _events(bench, job_id):
    with read(bench.engine) as tx:
        return events.after(tx, job_id, 0, 10_000)


def _reach(bench, message, name, kind="run"):
    """Work until the shards of this stage are ready, and return their messages."""
    waiting = [message]
    while True:
        fresh = bench.work(waiting.pop(0))
        with read(bench.engine) as tx:
            at = tx.scalar(sa.select(stage.c.name).join(shard).where(shard.c.id == fresh[0].shard_id)) if fresh else ""
            what = tx.scalar(sa.select(shard.c.kind).where(shard.c.id == fresh[0].shard_id)) if fresh else ""
        if at == name and what == kind:
            return fresh
        waiting += fresh


def test_a_job_passes_every_stage_and_ends_with_a_verdict(bench):
    job_id, message = bench.submit()
    bench.run(message)
    row, stages = bench.job(job_id), bench.stages(job_id)
    assert (row.state, row.verdict, row.error) == ("done", "valid", None)
    assert list(stages) == [str(s) for s in Stage]
    assert stages["visibility"]["state"] == "skipped"
    assert stages["visibility"]["skipped"] == "the toy has nothing to hide"
    assert stages["viewspace"]["shards"]["done"] == stages["viewspace"]["shards"]["total"] == 6
    assert all(s["artifact"] and s["peak_bytes"] > 0 for s in stages.values())
    report = json.loads(bytes(bench.artifacts.buffer(row.report_digest)))
    assert [s["name"] for s in report["stages"]] == list(stages)


def test_events_are_numbered_without_gaps_and_end_with_the_job(in_process):
    job_id, message = in_process.submit()
    in_process.run(message)
    found = _events(in_process, job_id)
    assert [e["seq"] for e in found] == list(range(1, len(found) + 1))
    assert found[0]["data"] == {"state": "queued"}
    assert found[-1]["kind"] == "job"
    assert found[-1]["data"]["state"] == "done"


def test_a_second_equal_job_computes_nothing_but_its_report(in_process):
    first, message = in_process.submit()
    in_process.run(message)
    second, message = in_process.submit()
    in_process.run(message)
    with read(in_process.engine) as tx:
        fresh = tx.execute(
            sa.select(shard.c.kind).where(shard.c.job_id == second, shard.c.cached.is_(False))
        ).scalars()  # fmt: skip
        assert list(fresh) == ["report"]
    artifacts = [{n: s["artifact"] for n, s in in_process.stages(j).items()} for j in (first, second)]
    assert artifacts[0] == artifacts[1]


def test_a_new_budget_recomputes_only_the_stages_that_read_it(in_process):
    in_process.run(in_process.submit()[1])
    second, message = in_process.submit(budget="300 calls")
    in_process.run(message)
    with read(in_process.engine) as tx:
        fresh = tx.execute(
            sa.select(stage.c.name).join(shard).where(shard.c.job_id == second, shard.c.cached.is_(False)).distinct()
        ).scalars()  # fmt: skip
        assert sorted(fresh) == ["evaluation", "placementdb", "proof"]


def test_duplicate_messages_are_harmless(in_process):
    job_id, message = in_process.submit()
    waiting = [message]
    while waiting:
        at = waiting.pop(0)
        fresh = in_process.work(at)
        assert in_process.work(at) == []
        waiting += fresh
    assert in_process.job(job_id).state == "done"
    with read(in_process.engine) as tx:
        assert set(tx.scalars(sa.select(shard.c.attempt))) == {1}


@pytest.mark.parametrize("seed", range(4))
def test_last_shards_that_finish_at_once_advance_once(in_process, seed):
    job_id, message = in_process.submit(skip=False, shards=8, seed=seed)
    with ThreadPoolExecutor(8) as pool:
        waiting = [message]
        while waiting:
            # Every message twice, all at once.
            waiting = [m for found in pool.map(in_process.work, waiting * 2) for m in found]
    assert in_process.job(job_id).state == "done"
    with read(in_process.engine) as tx:
        counts = tx.execute(
            sa.select(stage.c.name, shard.c.kind, sa.func.count()).join(shard).group_by(stage.c.name, shard.c.kind)
        ).all()  # fmt: skip
    assert all(n == (8 if kind == "run" and name in ("viewspace", "candidates") else 1) for name, kind, n in counts)


def test_a_named_error_fails_the_job_at_once_with_its_advice(in_process):
    job_id, message = in_process.submit(fail="hierarchy", error="named")
    in_process.run(message)
    row = in_process.job(job_id)
    assert row.state == "failed"
    assert row.error == {
        "code": "SceneEmpty", "message": "the toy has no triangles", "stage": "hierarchy",
        "advice": "Check that the export contains meshes with triangles.",
    }  # fmt: skip
    assert in_process.stages(job_id)["hierarchy"]["state"] == "failed"
    with read(in_process.engine) as tx:
        assert tx.scalar(sa.select(sa.func.max(shard.c.attempt))) == 1


def test_a_named_error_crosses_the_border_of_the_isolated_process(bench):
    job_id, message = bench.submit(fail="scene", error="named")
    bench.run(message)
    assert bench.job(job_id).error["code"] == "SceneEmpty"
    assert "advice" in bench.job(job_id).error


def test_an_odd_error_is_tried_three_times_and_shows_no_secret(in_process):
    job_id, message = in_process.submit(fail="viewspace")
    in_process.run(message)
    row = in_process.job(job_id)
    assert row.state == "failed"
    assert row.error["code"] == "StageFailed"
    assert "secret" not in json.dumps(row.error)
    with read(in_process.engine) as tx:
        assert tx.scalar(sa.select(sa.func.max(shard.c.attempt))) == 3
        assert "secret of /this/machine" in tx.scalar(sa.select(shard.c.log).where(shard.c.log.is_not(None)))


def test_a_failed_evaluation_leaves_the_placement_unproven(in_process):
    job_id, message = in_process.submit(fail="evaluation")
    in_process.run(message)
    row, stages = in_process.job(job_id), in_process.stages(job_id)
    assert (row.state, row.verdict) == ("done", "unproven")
    assert stages["evaluation"]["state"] == "failed"
    assert stages["placementdb"]["artifact"]


def test_who_lost_the_lease_commits_nothing(in_process):
    job_id, message = in_process.submit()
    old = shards.claim(in_process.engine, message.shard_id, worker="old")
    assert shards.claim(in_process.engine, message.shard_id, worker="new") is None
    assert progress.release_worker(in_process.engine, "old") == 1
    new = shards.claim(in_process.engine, message.shard_id, worker="new")
    digest = in_process.artifacts.put(b'{"skip": null, "shards": ["all"]}')
    result = {"digest": digest, "n_bytes": 33, "key": None, "seconds": 0.0, "peak_bytes": 1}
    assert not shards.renew(in_process.engine, old)
    assert shards.commit(in_process.engine, old, **result) == "lost"
    assert failures.fail(in_process.engine, old, error={}, log="", again=True) == "lost"
    assert shards.renew(in_process.engine, new)
    assert shards.commit(in_process.engine, new, **result) == "last"
    assert new.attempt == 2
    assert in_process.job(job_id).state == "running"


def test_a_job_has_one_optimizer_at_a_time_and_its_fence_grows(in_process):
    _, message = in_process.submit()
    (place,) = _reach(in_process, message, "placement")
    assert place.queue == "optimizer"
    first = shards.claim(in_process.engine, place.shard_id, worker="a")
    with write(in_process.engine) as tx:  # another shard of the same job on the optimizer's queue
        row = tx.execute(sa.select(shard).where(shard.c.id == place.shard_id)).one()._mapping
        tx.execute(sa.insert(shard).values({**row, "id": "other", "ordinal": 1, "state": "ready", "attempt": 0}))
    assert shards.claim(in_process.engine, "other", worker="b") is None
    with write(in_process.engine) as tx:
        tx.execute(sa.update(job).values(optimizer_until=now() - 1))
    second = shards.claim(in_process.engine, "other", worker="b")
    assert second.fence > first.fence
    result = {"digest": "0" * 64, "n_bytes": 0, "key": None, "seconds": 0.0, "peak_bytes": 1}
    assert shards.commit(in_process.engine, first, **result) == "lost"
    assert shards.commit(in_process.engine, second, **result) != "lost"


def test_a_cancelled_job_stops_its_shard_and_starts_no_other(in_process):
    job_id, message = in_process.submit(seconds=20.0)
    ready = _reach(in_process, message, "viewspace")
    pool = ThreadPoolExecutor(1)
    started = time.monotonic()
    # Many short sleeps would be interrupted at once; a long one is a native call that ends first.
    in_process.pipeline = replace(in_process.pipeline, steps={**in_process.pipeline.steps, Stage.VIEWSPACE: _sleepy()})
    running = pool.submit(in_process.work, ready[0])
    time.sleep(0.3)
    assert jobs.cancel(in_process.engine, in_process.tenant_id, job_id) == "cancelled"
    assert running.result(timeout=10) == []
    assert time.monotonic() - started < 10
    assert in_process.work(ready[1]) == []
    assert in_process.job(job_id).state == "cancelled"
    assert _events(in_process, job_id)[-1]["data"] == {"state": "cancelled"}


def _sleepy():
    import toy_pipeline

    def run(inputs, shard):
        for _ in range(2000):
            time.sleep(0.01)
        return [b"late"]

    return replace(toy_pipeline.PIPELINE.steps[Stage.VIEWSPACE], run=run)


def test_the_reconciler_finds_what_nobody_was_told_of(in_process):
    job_id, _ = in_process.submit()
    assert progress.waiting(in_process.engine, "cpu") == 1
    (message,) = progress.ready(in_process.engine)
    in_process.run(message)
    assert in_process.job(job_id).state == "done"


def test_the_reconciler_moves_on_what_a_dead_worker_left_between_commit_and_advance(in_process):
    job_id, message = in_process.submit()
    held = shards.claim(in_process.engine, message.shard_id, worker="dead")
    digest = in_process.artifacts.put(b'{"skip": null, "shards": ["all"]}')
    shards.commit(in_process.engine, held, digest=digest, n_bytes=33, key=None, seconds=0.0, peak_bytes=1)
    assert progress.ready(in_process.engine) == []
    assert progress.standing_still(in_process.engine) == [job_id]
    kinds = in_process.pipeline.kinds()
    (message,) = progress.advance(in_process.engine, in_process.artifacts, job_id, kinds)
    in_process.run(message)
    assert in_process.job(job_id).state == "done"


def test_three_dead_workers_fail_the_job(in_process):
    job_id, message = in_process.submit()
    for attempt in range(3):
        assert shards.claim(in_process.engine, message.shard_id, worker=f"w{attempt}")
        progress.release_worker(in_process.engine, f"w{attempt}")
    assert shards.claim(in_process.engine, message.shard_id, worker="w3") is None
    assert progress.ready(in_process.engine) == []
    for job_id in progress.standing_still(in_process.engine):
        progress.advance(in_process.engine, in_process.artifacts, job_id, in_process.pipeline.kinds())
    assert in_process.job(job_id).error["code"] == "WorkerDied"


def test_deleting_a_job_keeps_what_others_need(in_process):
    first, message = in_process.submit()
    with pytest.raises(JobStillRunning):
        jobs.delete(in_process.engine, in_process.tenant_id, first, dry_run=True)
    in_process.run(message)
    second, message = in_process.submit(budget="300 calls")
    in_process.run(message)
    said = jobs.delete(in_process.engine, in_process.tenant_id, second, dry_run=True)
    assert collect.collect(in_process.engine, in_process.artifacts, grace_s=0.0).removed == 0
    assert jobs.delete(in_process.engine, in_process.tenant_id, second, dry_run=False) == said
    done = collect.collect(in_process.engine, in_process.artifacts, grace_s=0.0)
    # Its report, its files, their proof and evaluation, and the plan of neither: those bytes are the first job's, too.
    assert (done.removed, done.removed_bytes) == (4, said["bytes"])
    assert said["artifacts"] == 4
    assert all(in_process.artifacts.has(s["artifact"]) for s in in_process.stages(first).values())


def test_what_another_tenant_has_computed_is_computed_again(in_process):
    from dataclasses import replace

    from farfield.store import tenants

    def reused(bench):
        job_id, message = bench.submit()
        bench.run(message)
        with read(bench.engine) as tx:
            done = sa.select(shard.c.cached).where(shard.c.job_id == job_id, shard.c.kind == "run")
            return set(tx.scalars(done)), {s["artifact"] for s in bench.stages(job_id).values()}

    other = replace(in_process, tenant_id=tenants.create_tenant(in_process.engine, "other"))
    (first, mine), (again, _), (theirs, same) = reused(in_process), reused(in_process), reused(other)
    assert (first, again, theirs) == ({False}, {True}, {False})
    assert mine == same  # equal bytes are one blob all the same


def test_writers_in_many_threads_never_meet_a_locked_database(in_process):
    def submit(_):
        return in_process.submit()[0]

    with ThreadPoolExecutor(8) as pool:
        assert len(set(pool.map(submit, range(40)))) == 40
    assert threading.active_count() < 20


def test_stopping_the_service_is_no_attempt(in_process):
    job_id, message = in_process.submit()
    for _ in range(4):
        assert shards.claim(in_process.engine, message.shard_id, worker="w")
        assert progress.hand_back(in_process.engine) == 1
    (message,) = progress.ready(in_process.engine)
    in_process.run(message)
    assert in_process.job(job_id).state == "done"


@pytest.mark.parametrize("how", ["stopped", "put off"])
def test_who_gave_a_shard_back_touches_no_later_claim_of_the_same_attempt(in_process, monkeypatch, how):
    monkeypatch.setattr(failures, "PUT_OFF_S", (0.0,))
    _, message = in_process.submit()
    old = shards.claim(in_process.engine, message.shard_id, worker="old")

    def put_off():
        return failures.put_off(in_process.engine, old, error={}, log="")

    assert progress.hand_back(in_process.engine, "old") == 1 if how == "stopped" else put_off() == "ready"
    new = shards.claim(in_process.engine, message.shard_id, worker="new")
    assert new.attempt == old.attempt == 1
    result = {"digest": "0" * 64, "n_bytes": 1, "key": None, "seconds": 0.0, "peak_bytes": 1}
    assert not shards.renew(in_process.engine, old)
    assert shards.commit(in_process.engine, old, **result) == "lost"
    assert put_off() == "lost"  # asked again, because the first answer was lost
    assert shards.renew(in_process.engine, new)


def test_a_job_that_cannot_move_holds_up_no_other(in_process, monkeypatch):
    environment = {"DATABASE_URL": str(in_process.engine.url), "BROKER_URL": "memory://", "ARTIFACTS": "none"}
    for name, value in environment.items():
        monkeypatch.setenv(f"FARFIELD_{name}", value)
    from farfield_workers import reconciler

    stuck, message = in_process.submit()
    held = shards.claim(in_process.engine, message.shard_id, worker="dead")
    lost = {"digest": "0" * 64, "n_bytes": 33, "key": None, "seconds": 0.0, "peak_bytes": 1}
    assert shards.commit(in_process.engine, held, **lost) == "last"
    other, message = in_process.submit(shards=3)
    held = shards.claim(in_process.engine, message.shard_id, worker="dead")
    plan = in_process.artifacts.put(b'{"skip": null, "shards": ["all"]}')
    shards.commit(in_process.engine, held, digest=plan, n_bytes=33, key=None, seconds=0.0, peak_bytes=1)
    woken = []
    for name in ("engine", "artifacts", "pipeline", "settings"):
        monkeypatch.setattr(reconciler, name, lambda name=name: getattr(in_process, name))
    monkeypatch.setattr(reconciler, "wake", lambda queues: woken.extend(queues) or 0)
    assert set(progress.standing_still(in_process.engine)) == {stuck, other}
    reconciler.reconcile()
    assert woken == ["cpu", "optimizer", "gl"]
    assert [m.queue for m in progress.ready(in_process.engine)] == ["cpu"]
    assert progress.standing_still(in_process.engine) == []
    assert in_process.job(stuck).state == "failed"  # its plan is lost: it says so, instead of standing still for ever


def test_a_result_deleted_with_another_job_is_computed_again(in_process):
    first, message = in_process.submit()
    in_process.run(message)
    second, message = in_process.submit()
    commit = shards.commit
    deleted = []

    def late(*args, **more):
        if not deleted:
            deleted.append(jobs.delete(in_process.engine, in_process.tenant_id, first, dry_run=False))
            assert collect.collect(in_process.engine, in_process.artifacts, grace_s=0.0).removed
        return commit(*args, **more)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shards, "commit", late)
        in_process.run(message)
    assert in_process.job(second).state == "done"
    assert all(in_process.artifacts.has(s["artifact"]) for s in in_process.stages(second).values())


def test_a_scene_that_takes_seconds_to_read_is_read(bench):
    job_id, message = bench.submit(scene_seconds=1.5)
    (ready,) = _reach(bench, message, "scene")
    assert bench.work(ready)
    assert bench.stages(job_id)["scene"]["state"] == "done"


def test_a_cancel_ends_the_isolated_process_soon(bench):
    job_id, message = bench.submit(scene_seconds=20.0)
    (ready,) = _reach(bench, message, "scene")
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(bench.work, ready)
        time.sleep(1.0)
        jobs.cancel(bench.engine, bench.tenant_id, job_id)
        started = time.monotonic()
        assert running.result(timeout=15) == []
    assert time.monotonic() - started < 10


def _with(bench, stage_name, **fields):
    steps = bench.pipeline.steps
    bench.pipeline = replace(bench.pipeline, steps={**steps, stage_name: replace(steps[stage_name], **fields)})


def test_a_shard_that_is_run_again_finds_the_checkpoint_of_the_attempt_before(in_process):
    seen = []

    def run(inputs, shard_):
        seen.append(inputs.checkpoint.read_text() if inputs.checkpoint.exists() else None)
        inputs.checkpoint.write_text(f"attempt {len(seen)}")
        if len(seen) == 1:
            raise RuntimeError("killed")
        return [b"chosen"]

    _with(in_process, Stage.PLACEMENT, run=run)
    job_id, message = in_process.submit()
    in_process.run(message)
    assert in_process.job(job_id).state == "done"
    assert seen == [None, "attempt 1"]
    assert list(in_process.artifacts.checkpoints.iterdir()) == []


def test_what_a_clock_may_have_stopped_is_no_other_jobs_but_a_whole_result_is_anyones(in_process):
    runs = []

    def run(inputs, shard_):
        runs.append(inputs.settings.budget)
        return [str(len(runs)).encode()]

    for timed in (True, True, False, True):  # the third leaves a key, which the fourth finds
        _with(in_process, Stage.PLACEMENT, run=run, timed=lambda settings, timed=timed: timed)
        message = in_process.submit()[1]
        in_process.run(message)
    assert len(runs) == 3
    with read(in_process.engine) as tx:
        keys = tx.execute(
            sa.select(shard.c.key, shard.c.cached).join(stage, stage.c.id == shard.c.stage_id)
            .join(job, job.c.id == shard.c.job_id).where(stage.c.name == "placement", shard.c.kind == "run")
            .order_by(job.c.created_at, job.c.id)
        ).all()  # fmt: skip
    assert sorted((k.key is None, k.cached) for k in keys) == [
        (False, False),
        (False, True),
        (True, False),
        (True, False),
    ]
