"""Who is served next: claims in the order in which free workers ask, with no clock in it."""

import json

import pytest
import sqlalchemy as sa
from farfield.settings import Settings, to_mapping
from farfield.stages import Stage
from farfield.store import fair, jobs, progress, scenes, shards, tenants
from farfield.store.engine import now, write
from farfield.store.fair import Host, next_shard
from farfield.store.tables import job, shard
from farfield_workers.work import work_next

HERE = Host(name="here")
GIB = 1 << 30


def submit(bench, tenant_id, n_shards, *, priority="normal", need_bytes=0):
    """Create a job whose stage `viewspace` is ready with so many shards, and return its id."""
    data = json.dumps({"shards": n_shards, "who": tenant_id, "priority": priority}).encode()
    digest = bench.artifacts.put(data)
    scenes.add(
        bench.engine, tenant_id, digest=digest, name="toy.glb", suffix=".glb", n_bytes=len(data), summary={},
        inspect_digest=bench.artifacts.put(b"{}"), inspect_bytes=2,
    )  # fmt: skip
    job_id, message = jobs.create(
        bench.engine, tenant_id, name="toy", scene_digest=digest, settings=to_mapping(Settings()), stages=["viewspace"],
        idempotency_key=None, priority=priority,
    )  # fmt: skip
    held = shards.claim(bench.engine, message.shard_id, worker="planner")
    plan = bench.artifacts.put(json.dumps({"skip": None, "shards": list(range(n_shards))}).encode())
    shards.commit(bench.engine, held, digest=plan, n_bytes=33, key=None, seconds=0.0, peak_bytes=1)
    progress.advance(bench.engine, bench.artifacts, job_id, bench.pipeline.kinds())
    with write(bench.engine) as tx:
        tx.execute(
            sa.update(shard).where(shard.c.job_id == job_id, shard.c.kind == "run").values(need_bytes=need_bytes)
        )
    return job_id


class Workers:
    """So many workers, of which the one that was busy longest ends its shard and asks for the next."""

    def __init__(self, bench, number, host=HERE):
        self.bench, self.number, self.host, self.held, self.served = bench, number, host, [], []

    def claim(self):
        found = next_shard(self.bench.engine, "cpu", self.host)
        if found is None:
            return None
        held = shards.claim(self.bench.engine, found.shard_id, worker="w", host=self.host)
        if held is not None:
            self.held.append(held)
            self.served.append(held.job_id)
        return held

    def end_first(self):
        held = self.held.pop(0)
        digest = self.bench.artifacts.put(f"{held.job_id} {held.ordinal}".encode())
        shards.commit(self.bench.engine, held, digest=digest, n_bytes=1, key=None, seconds=0.0, peak_bytes=1)

    def run(self, claims):
        while len(self.served) < claims:
            if len(self.held) == self.number:
                self.end_first()
            if self.claim() is None:
                if not self.held:
                    return self.served
                self.end_first()
        return self.served


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_a_small_job_does_not_wait_for_a_heavy_one_that_came_before(in_process, workers):
    heavy = submit(in_process, in_process.tenant_id, 60)
    crowd = Workers(in_process, workers)
    crowd.run(10)
    small = submit(in_process, in_process.tenant_id, 4)
    served = crowd.run(26)[10:]
    assert served.count(small) == 4
    assert max(k for k, j in enumerate(served) if j == small) <= 8 + workers  # every other claim is the small one's
    assert served.count(heavy) == 12


def test_tenants_take_turns_however_many_jobs_and_shards_they_have(in_process):
    many, few = in_process.tenant_id, tenants.create_tenant(in_process.engine, "few")
    theirs = {submit(in_process, many, 20) for _ in range(3)}
    ours = submit(in_process, few, 12)
    served = Workers(in_process, 1).run(24)
    assert served.count(ours) == 12
    for k in range(0, 24, 2):
        assert {served[k] == ours, served[k + 1] == ours} == {True, False}
    assert all(abs(served.count(a) - 4) <= 1 for a in theirs)


def test_a_tenant_that_runs_little_goes_first(in_process):
    busy, idle = in_process.tenant_id, tenants.create_tenant(in_process.engine, "idle")
    submit(in_process, busy, 20)
    crowd = Workers(in_process, 4)
    crowd.run(4)
    ours = submit(in_process, idle, 20)
    for _ in range(4):
        crowd.end_first()
        crowd.claim()
    assert [j == ours for j in crowd.served[4:6]] == [True, True]
    assert [h.job_id == ours for h in crowd.held].count(True) == 2


def test_a_tenants_jobs_of_high_priority_go_first_and_those_of_low_last_but_others_are_not_held_up(in_process):
    mine, other = in_process.tenant_id, tenants.create_tenant(in_process.engine, "other")
    low = submit(in_process, mine, 3, priority="low")
    normal = submit(in_process, mine, 3)
    high = submit(in_process, mine, 3, priority="high")
    crowd = Workers(in_process, 1)
    served = crowd.run(9)
    crowd.end_first()
    assert served == [high] * 3 + [normal] * 3 + [low] * 3
    urgent = submit(in_process, mine, 6, priority="high")
    theirs = submit(in_process, other, 6, priority="low")
    served = Workers(in_process, 1).run(8)
    assert served.count(urgent) == served.count(theirs) == 4


def test_a_host_starts_what_fits_beside_what_it_runs(in_process):
    host = Host(name="small", memory_bytes=10 * GIB)
    large = submit(in_process, in_process.tenant_id, 3, need_bytes=6 * GIB)
    small = submit(in_process, in_process.tenant_id, 6, need_bytes=2 * GIB)
    crowd = Workers(in_process, 8, host)
    while crowd.claim() is not None:
        pass
    assert sorted(h.job_id for h in crowd.held) == sorted([large, small, small])
    other = Workers(in_process, 8, Host(name="other", memory_bytes=7 * GIB))  # another machine has its own
    assert other.claim() is not None
    # Two workers may see the same room at once; the claim decides.
    waiting = next(m for m in progress.ready(in_process.engine) if m.shard_id not in {h.shard_id for h in crowd.held})
    with write(in_process.engine) as tx:
        tx.execute(sa.update(shard).where(shard.c.id == waiting.shard_id).values(need_bytes=3 * GIB))
    assert shards.claim(in_process.engine, waiting.shard_id, worker="late", host=host) is None


def test_what_needs_much_is_not_passed_over_for_ever(in_process, monkeypatch):
    host = Host(name="small", memory_bytes=10 * GIB)
    submit(in_process, in_process.tenant_id, 50, need_bytes=4 * GIB)
    crowd = Workers(in_process, 2, host)
    crowd.run(2)
    large = submit(in_process, in_process.tenant_id, 1, need_bytes=8 * GIB)
    crowd.run(12)
    assert large not in crowd.served
    monkeypatch.setattr(fair, "PATIENCE_S", -1.0)
    crowd.end_first()
    assert crowd.claim() is None  # the host waits until it fits
    crowd.end_first()
    assert crowd.claim().job_id == large


def test_a_tenant_whose_shards_do_not_fit_leaves_the_host_to_others(in_process):
    host = Host(name="small", memory_bytes=10 * GIB)
    for _ in range(fair.LOOKS + 1):
        submit(in_process, in_process.tenant_id, 2, need_bytes=8 * GIB)
    crowd = Workers(in_process, 4, host)
    crowd.claim()
    ours = submit(in_process, tenants.create_tenant(in_process.engine, "other"), 4, need_bytes=GIB // 2)
    assert [crowd.claim().job_id for _ in range(3)] == [ours] * 3  # by the last it runs more, and is asked last


def test_ready_shards_wake_somebody_where_the_clock_has_jumped_back(in_process):
    submit(in_process, in_process.tenant_id, 5)
    assert progress.waiting(in_process.engine, "cpu") == 5
    with write(in_process.engine) as tx:
        tx.execute(sa.update(shard).where(shard.c.state == "ready").values(ready_at=now() + 3600.0))
    assert next_shard(in_process.engine, "cpu", HERE) is not None
    assert progress.waiting(in_process.engine, "cpu") == 5
    with write(in_process.engine) as tx:  # put off, as it may be
        tx.execute(sa.update(shard).where(shard.c.state == "ready").values(ready_at=now() + 60.0))
    assert next_shard(in_process.engine, "cpu", HERE) is None
    assert progress.waiting(in_process.engine, "cpu") == 0


def test_strangers_on_the_machine_are_seen_but_no_job_waits_for_them_for_ever(in_process, monkeypatch):
    submit(in_process, in_process.tenant_id, 2, need_bytes=4 * GIB)
    host = Host(name="small", memory_bytes=10 * GIB, free_bytes=3 * GIB)
    assert next_shard(in_process.engine, "cpu", host) is None
    monkeypatch.setattr(fair, "PATIENCE_S", -1.0)
    assert next_shard(in_process.engine, "cpu", host) is not None


def test_a_shard_that_fits_nowhere_fails_by_name(in_process):
    from dataclasses import replace

    in_process.settings = replace(in_process.settings, host="tiny", memory_bytes=1 << 20)
    job_id, _ = in_process.submit()
    with write(in_process.engine) as tx:
        tx.execute(sa.update(shard).where(shard.c.job_id == job_id).values(need_bytes=5 << 30))
    assert work_next(in_process.engine, in_process.artifacts, in_process.pipeline, in_process.settings, "cpu") == []
    row = in_process.job(job_id)
    assert (row.state, row.error["code"]) == ("failed", "OverMemory")
    assert "5.0 GiB" in row.error["message"]


def test_every_shard_states_what_it_may_need(in_process):
    job_id, message = in_process.submit()
    in_process.run(message)
    with write(in_process.engine) as tx:
        needs = sorted(tx.scalars(sa.select(shard.c.need_bytes).where(shard.c.job_id == job_id)))
    assert len(needs) > 30
    # But the first, which plans how the file is read; test_races holds the others against what processes took.
    assert needs[0] == 0 < needs[1]


def test_no_clock_decides_whose_turn_it_is(in_process):
    first, second = (submit(in_process, in_process.tenant_id, 4) for _ in range(2))
    with write(in_process.engine) as tx:  # a clock that has jumped by a year either way
        tx.execute(sa.update(job).where(job.c.id == first).values(created_at=now() + 3e7))
        tx.execute(sa.update(job).where(job.c.id == second).values(created_at=now() - 3e7))
    served = Workers(in_process, 1).run(8)
    assert {served[k] for k in (0, 1)} == {first, second}
    assert all(served[k] != served[k + 1] for k in range(7))


def test_the_stage_is_told_of_in_steps_where_its_shards_are_many(in_process):
    from farfield.store import events
    from farfield.store.engine import read

    job_id = submit(in_process, in_process.tenant_id, 450)
    Workers(in_process, 1).run(450)
    with read(in_process.engine) as tx:
        found = events.after(tx, job_id, 0, 10_000)
    told = [e["data"] for e in found if e["kind"] == "stage" and "done" in e["data"]]
    assert 95 <= len(told) <= 101
    assert len(found) < 120
    assert [e["seq"] for e in found] == list(range(1, len(found) + 1))
    stage = in_process.stages(job_id)[str(Stage.VIEWSPACE)]
    assert stage["shards"]["total"] == 450
    assert stage["shards"]["done"] + stage["shards"]["running"] == 450
