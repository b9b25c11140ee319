"""The API over a fresh database, in this process, with keys of two tenants; no broker answers."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from farfield.store import tenants
from farfield.store.engine import open_engine
from farfield_api.app import make_app
from farfield_api.settings import ApiSettings
from servers import database, empty_database, postgres, postgres_template  # noqa: F401  (fixtures)
from starlette.testclient import TestClient

TESTS = Path(__file__).parents[1]


@dataclass
class Service:
    client: TestClient
    settings: ApiSettings
    engine: object
    tenant_id: str
    key: str

    def new_key(self, *scopes, tenant="toy", operator=False):
        tenant_id = tenants.create_tenant(self.engine, tenant, operator=operator)
        return tenants.create_key(self.engine, tenant_id, "test", scopes)

    def upload(self, name="toy.glb", **wish):
        """Send a toy scene and return its digest."""
        headers = {"content-disposition": f'attachment; filename="{name}"'}
        answer = self.client.post("/v1/scenes", content=json.dumps(wish).encode(), headers=headers)
        assert answer.status_code in (200, 201), answer.text
        return answer.json()["digest"]

    def create(self, **wish):
        """Create a job for a toy scene and return its id."""
        answer = self.client.post("/v1/jobs", json={"scene": self.upload(**wish)})
        assert answer.status_code == 201, answer.text
        return answer.json()["id"]


def bearer(key):
    return {"authorization": f"Bearer {key}"}


ON_BOTH = {  # tests of what databases do differently: they run on PostgreSQL, too
    "test_a_job_from_submit_to_placement",
    "test_an_idempotency_key_makes_one_job",
    "test_pages_of_jobs_hold_each_once",
    "test_cancel_and_delete",
    "test_a_cancelled_job_can_be_retried_and_an_old_worker_commits_nothing",
    "test_a_key_is_made_used_rotated_and_revoked",
    "test_jobs_that_are_asked_for_at_once_do_not_exceed_a_quota",
    "test_nobody_alters_the_audit_log",
    "test_pieces_become_the_scene_of_these_bytes",
    "test_metrics_tell_of_jobs_shards_queues_and_requests",
}


def pytest_generate_tests(metafunc):
    if metafunc.function.__name__ in ON_BOTH:
        metafunc.parametrize("database", ["sqlite", "postgres"], indirect=True)


@pytest.fixture
def service(tmp_path, database):  # noqa: F811  (a fixture)
    engine = open_engine(database)
    tenant_id = tenants.create_tenant(engine, "toy")
    key = tenants.create_key(engine, tenant_id, "test", ("read", "submit", "admin"))
    web = tmp_path / "dist"
    (web / "assets").mkdir(parents=True)
    for name in ("jobs", "job", "report", "viewer"):
        (web / f"{name}.html").write_text(f"<title>{name}</title>")
    (web / "assets" / "app-abc.js").write_text("1")
    settings = ApiSettings(
        database_url=database, broker_url=f"redis+socket://{tmp_path}/none.sock",
        artifacts=tmp_path / "artifacts", secret="ab" * 32, web=web,
        max_scene_bytes=100_000, poll_s=0.02, inspect_seconds=20,
        inspect_command=(sys.executable, str(TESTS / "toy_inspect.py")),
        export_command=(sys.executable, str(TESTS / "toy_export.py")),
        placements={"town": _placement(tmp_path / "town")},
    )  # fmt: skip
    with TestClient(make_app(settings), headers=bearer(key), base_url="http://127.0.0.1") as client:
        yield Service(client, settings, engine, tenant_id, key)
    engine.dispose()


def _placement(folder):
    (folder / "placement").mkdir(parents=True)
    (folder / "placement" / "manifest.json").write_text('{"version": 1}')
    (folder / "placement" / f"{'0123456789abcdef' * 4}.bin").write_bytes(bytes(range(200)))
    (folder / "scene.glb").write_bytes(b"glTF")
    (folder / "report.json").write_text('{"verdict": "valid"}')
    (folder.parent / "secret.txt").write_text("not yours")
    return folder


@pytest.fixture
def operator(service):
    """The headers of a key of the operator's tenant with all scopes."""
    return bearer(service.new_key("read", "submit", "admin", tenant="us", operator=True))


@pytest.fixture
def worker(service, monkeypatch):
    """Call it to work on everything that is ready, until nothing is."""
    from dataclasses import replace

    import toy_pipeline
    from farfield.store import progress
    from farfield.store.artifacts import LocalArtifacts
    from farfield_workers.settings import WorkerSettings
    from farfield_workers.work import work

    settings = WorkerSettings(
        database_url="", broker_url="", artifacts=service.settings.artifacts, worker="here", pipeline="", lease_s=60.0,
        renew_s=1.0, scene_memory_bytes=0, scene_seconds=60,
    )  # fmt: skip
    artifacts = LocalArtifacts(service.settings.artifacts)
    pipeline = replace(toy_pipeline.PIPELINE, isolated=frozenset())

    def run():
        waiting = progress.ready(service.engine)
        while waiting:
            waiting += work(service.engine, artifacts, pipeline, settings, waiting.pop(0).shard_id)

    return run
