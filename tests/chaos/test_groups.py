"""Groups of short shards under deaths: workers killed in the middle of a group cost nothing and change nothing."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
import sqlalchemy as sa
from farfield.settings import Settings, to_mapping
from farfield.stages import Stage
from farfield.store import events, jobs, progress, scenes, tenants
from farfield.store.artifacts import LocalArtifacts
from farfield.store.engine import open_engine, read
from farfield.store.tables import shard, stage
from servers import database, empty_database, postgres, postgres_template  # noqa: F401  (fixtures)

SHARDS = 500  # more than shards.EVENT_SHARDS
DEATHS = 2  # of which a shard survives as many
RACER = Path(__file__).parents[1] / "racing.py"


class Level:
    """A toy job of many short shards in `url`, and the processes that work on it."""

    def __init__(self, url, folder):
        self.url, self.engine, self.artifacts = url, open_engine(url), LocalArtifacts(folder)
        self.tenant_id = tenants.create_tenant(self.engine, "toy")
        wish = json.dumps({"seconds": 0.008, "shards": SHARDS}).encode()
        digest = self.artifacts.put(wish)
        scenes.add(self.engine, self.tenant_id, digest=digest, name="toy.glb", suffix=".glb", n_bytes=len(wish), summary={},
                   inspect_digest=self.artifacts.put(b"{}"), inspect_bytes=2)  # fmt: skip
        self.job_id, _ = jobs.create(self.engine, self.tenant_id, name="toy", scene_digest=digest, idempotency_key=None,
                                     settings=to_mapping(Settings(seed=0)), stages=list(Stage))  # fmt: skip

    def start(self, number):
        command = [sys.executable, str(RACER), self.url, str(self.artifacts.root), str(number)]
        return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)

    def in_a_group(self):
        """Return the racers that hold more than the shard they count for."""
        waits = (shard.c.state == "running") & shard.c.host.is_(None)
        with read(self.engine) as tx:
            return sorted(set(tx.scalars(sa.select(shard.c.worker).where(waits))))

    def results(self):
        of = (stage.c.name == Stage.VIEWSPACE) & (stage.c.job_id == self.job_id) & (shard.c.kind == "run")
        query = sa.select(shard.c.params, shard.c.artifact_digest).join(stage, stage.c.id == shard.c.stage_id)
        with read(self.engine) as tx:
            return tx.execute(query.where(of)).all()


def kill_in_a_group(level, racers):
    """Kill a racer that works on a group, take back what it held, and return how many shards that were."""
    end = time.monotonic() + 60
    while not (held := level.in_a_group()):
        assert time.monotonic() < end and any(r.poll() is None for r in racers.values()), "no group was formed"
        time.sleep(0.002)
    number = int(held[0].split()[1])
    racers[number].kill()
    racers[number].communicate()
    taken = progress.release_worker(level.engine, held[0])
    del racers[number]
    racers[number + 2] = level.start(number + 2)
    return taken


@pytest.mark.parametrize("database", ["sqlite", "postgres"], indirect=True)
def test_workers_die_in_the_middle_of_groups(database, tmp_path):  # noqa: F811  (a fixture)
    level = Level(database, tmp_path / "artifacts")
    racers = {number: level.start(number) for number in range(2)}
    try:
        lost = [kill_in_a_group(level, racers) for _ in range(DEATHS)]
        told = [racer.communicate(timeout=110)[1] for racer in racers.values()]
    finally:
        for racer in racers.values():
            racer.kill()
    assert [racer.returncode for racer in racers.values()] == [0, 0], told
    assert max(lost) > 1, "nobody died with a group in its hands"
    row = jobs.get(level.engine, level.tenant_id, level.job_id)
    assert row.state == "done", row.error
    with read(level.engine) as tx:
        shards = tx.execute(sa.select(shard.c.state, shard.c.kind, shard.c.attempt, shard.c.claims)).all()
        seen = events.after(tx, level.job_id, 0, 100_000)
    assert {s.state for s in shards} == {"done"}
    assert sum(s.attempt > 1 for s in shards) <= sum(lost), "a death cost attempts of shards that nobody held"
    assert [e["seq"] for e in seen] == list(range(1, row.event_seq + 1))
    of = {s["name"]: s["shards"] for s in jobs.stages_of(level.engine, level.job_id)}[Stage.VIEWSPACE]
    assert (of["total"], of["done"]) == (SHARDS, SHARDS)
    for row in level.results():
        said = json.loads(bytes(level.artifacts.buffer(row.artifact_digest)))
        assert said[:2] == ["viewspace", row.params], "a shard has another's result"
    level.engine.dispose()
