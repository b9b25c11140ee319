"""A service without processes: a database, a store, the toy pipeline, and a worker that is a function call."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
import toy_pipeline
from farfield.settings import Settings, to_mapping
from farfield.stages import Stage
from farfield.store import jobs, scenes, tenants
from farfield.store.artifacts import LocalArtifacts
from farfield.store.engine import open_engine
from farfield_workers.serve import migrate
from farfield_workers.settings import WorkerSettings
from farfield_workers.work import work


@dataclass
class Bench:
    engine: object
    artifacts: LocalArtifacts
    settings: WorkerSettings
    tenant_id: str
    pipeline: object = toy_pipeline.PIPELINE

    def submit(self, budget="16 ms", **wish):
        """Create a job for the toy scene that asks for `wish`; return (job id, first message)."""
        data = json.dumps(wish).encode()
        digest = self.artifacts.put(data)
        scenes.add(
            self.engine, self.tenant_id, digest=digest, name="toy.glb", suffix=".glb", n_bytes=len(data), summary={},
            inspect_digest=self.artifacts.put(b"{}"), inspect_bytes=2,
        )  # fmt: skip
        return jobs.create(
            self.engine, self.tenant_id, name="toy", scene_digest=digest, idempotency_key=None,
            settings=to_mapping(Settings(budget=budget)), stages=list(Stage),
        )  # fmt: skip

    def work(self, message):
        return work(self.engine, self.artifacts, self.pipeline, self.settings, message.shard_id)

    def run(self, message):
        """Work until no message is left, in order."""
        waiting = [message]
        while waiting:
            waiting += self.work(waiting.pop(0))

    def job(self, job_id):
        return jobs.get(self.engine, self.tenant_id, job_id)

    def stages(self, job_id):
        return {s["name"]: s for s in jobs.stages_of(self.engine, job_id)}


@pytest.fixture(scope="session")
def empty_database(tmp_path_factory):
    path = tmp_path_factory.mktemp("database") / "farfield.sqlite"
    engine = open_engine(f"sqlite:///{path}")
    migrate(engine, Path(__file__).parents[2] / "migrations")
    engine.dispose()
    return path


@pytest.fixture
def bench(tmp_path, monkeypatch, empty_database):
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))  # for the isolated process
    url = f"sqlite:///{tmp_path / 'farfield.sqlite'}"
    shutil.copy(empty_database, tmp_path)
    engine = open_engine(url)
    settings = WorkerSettings(
        database_url=url, broker_url="", artifacts=tmp_path / "artifacts", worker="here",
        pipeline="toy_pipeline:PIPELINE", lease_s=60.0, renew_s=0.05, scene_memory_bytes=4 << 30, scene_seconds=60,
    )  # fmt: skip
    yield Bench(engine, LocalArtifacts(settings.artifacts), settings, tenants.create_tenant(engine, "toy"))
    engine.dispose()


@pytest.fixture
def in_process(bench):
    """The same, and no stage gets a process of its own: faster where isolation is not the point."""
    from dataclasses import replace

    bench.pipeline = replace(toy_pipeline.PIPELINE, isolated=frozenset())
    return bench
