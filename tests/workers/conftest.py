"""A service without processes: a database, a store, the toy pipeline, and a worker that is a function call."""

import json
from dataclasses import dataclass
from pathlib import Path

import pytest
import toy_pipeline
from farfield.settings import Settings, to_mapping
from farfield.stages import Stage
from farfield.store import jobs, progress, scenes, tenants
from farfield.store.artifacts import LocalArtifacts
from farfield.store.engine import open_engine
from farfield_workers.settings import WorkerSettings
from farfield_workers.work import work
from servers import database, empty_database, postgres, postgres_template  # noqa: F401  (fixtures)


@dataclass
class Bench:
    engine: object
    artifacts: LocalArtifacts
    settings: WorkerSettings
    tenant_id: str
    pipeline: object = toy_pipeline.PIPELINE

    def submit(self, budget="16 ms", webhook_id=None, **wish):
        """Create a job for the toy scene that asks for `wish`; return (job id, first message)."""
        data = json.dumps(wish).encode()
        digest = self.artifacts.put(data)
        scenes.add(
            self.engine, self.tenant_id, digest=digest, name="toy.glb", suffix=".glb", n_bytes=len(data), summary={},
            inspect_digest=self.artifacts.put(b"{}"), inspect_bytes=2,
        )  # fmt: skip
        return jobs.create(
            self.engine, self.tenant_id, name="toy", scene_digest=digest, idempotency_key=None,
            settings=to_mapping(Settings(budget=budget)), stages=list(Stage), webhook_id=webhook_id,
        )  # fmt: skip

    def work(self, message):
        return work(self.engine, self.artifacts, self.pipeline, self.settings, message.shard_id)

    def run(self, message):
        """Work until no message is left, in order."""
        waiting = [message]
        while waiting:
            waiting += self.work(waiting.pop(0))

    def go_on(self):
        """Work on all that is ready, whoever was told of it, until nothing is."""
        while waiting := progress.ready(self.engine):
            for message in waiting:
                self.work(message)

    def job(self, job_id):
        return jobs.get(self.engine, self.tenant_id, job_id)

    def stages(self, job_id):
        return {s["name"]: s for s in jobs.stages_of(self.engine, job_id)}

    def results(self, job_id):
        """Return the digest of each stage's artifact."""
        return {name: told["artifact"] for name, told in self.stages(job_id).items()}


ON_BOTH = {  # tests of what databases do differently: they run on PostgreSQL, too
    "test_a_job_passes_every_stage_and_ends_with_a_verdict",
    "test_events_are_numbered_without_gaps_and_end_with_the_job",
    "test_duplicate_messages_are_harmless",
    "test_last_shards_that_finish_at_once_advance_once",
    "test_an_odd_error_is_tried_three_times_and_shows_no_secret",
    "test_who_lost_the_lease_commits_nothing",
    "test_what_was_taken_over_is_not_written_and_the_rest_is",
    "test_groups_end_a_job_with_the_bytes_that_single_shards_make",
    "test_a_job_has_one_optimizer_at_a_time_and_its_fence_grows",
    "test_three_dead_workers_fail_the_job",
    "test_deleting_a_job_keeps_what_others_need",
    "test_writers_in_many_threads_never_meet_a_locked_database",
    "test_a_result_deleted_with_another_job_is_computed_again",
    "test_workers_of_many_processes_lose_nothing_and_advance_once",
    "test_a_collection_removes_what_a_deleted_job_alone_needed_and_says_before_what",
    "test_what_is_past_its_time_goes_and_the_end_of_a_stream_stays",
    "test_states_numbers_and_sizes_that_cannot_be_are_found",
    "test_bytes_past_32_bits_are_counted",
}


def pytest_generate_tests(metafunc):
    if metafunc.function.__name__ in ON_BOTH:
        metafunc.parametrize("database", ["sqlite", "postgres"], indirect=True)


@pytest.fixture
def bench(tmp_path, monkeypatch, database):  # noqa: F811  (a fixture)
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))  # for the isolated process
    url = database
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
