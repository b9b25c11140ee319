"""The TypeScript types of the pages against the API: requests by its OpenAPI document, answers by real answers."""

import importlib.util
import re
from pathlib import Path

import pytest
from farfield.store import tenants, workers
from farfield.store.workers import Telling

WEB = Path(__file__).resolve().parents[2] / "webviewer"


@pytest.fixture(scope="module")
def generator():
    spec = importlib.util.spec_from_file_location("make_api_types", WEB / "scripts" / "make_api_types.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def interfaces():
    """Return {interface: {key: optional?}} of src/api/types.ts."""
    found = {}
    text = (WEB / "src" / "api" / "types.ts").read_text()
    for name, base, body in re.findall(r"export interface (\w+)(?: extends (\w+))? \{\n(.*?)\n\}", text, re.S):
        keys = {key: bool(mark) for key, mark in re.findall(r"^  (\w+)(\??):", body, re.M)}
        found[name] = {**found.get(base, {}), **keys}
    return found


def test_the_request_types_are_those_of_the_api(generator):
    made = generator.typescript(generator.document())
    assert generator.TARGET.read_text() == made, "run: python webviewer/scripts/make_api_types.py"


def _hold(interfaces, name, answer):
    wanted = interfaces[name]
    missing = {key for key, optional in wanted.items() if not optional} - set(answer)
    assert not missing, f"{name} has no {sorted(missing)} in the answer"
    unknown = set(answer) - set(wanted)
    assert not unknown, f"{name} does not know {sorted(unknown)}"


def test_the_answer_types_are_what_the_api_answers(service, worker, interfaces):
    job = service.create()
    queued = service.client.get(f"/v1/jobs/{job}").json()
    worker()
    failed = service.create(fail="bake", error="named")
    worker()
    get = lambda path: service.client.get(path, headers={"accept": "application/json"}).json()  # noqa: E731
    _hold(interfaces, "Session", get("/v1/session"))
    page = get("/v1/jobs")
    _hold(interfaces, "JobPage", page)
    for listed in page["jobs"]:
        _hold(interfaces, "Job", listed)
        _hold(interfaces, "JobLinks", listed["links"])
    for detail in (queued, get(f"/v1/jobs/{job}"), get(f"/v1/jobs/{failed}")):
        _hold(interfaces, "JobDetail", detail)
        for stage in detail["stages"]:
            _hold(interfaces, "StageRow", stage)
            _hold(interfaces, "ShardCounts", stage["shards"])
    _hold(interfaces, "JobError", get(f"/v1/jobs/{failed}")["error"])
    shards = get(f"/v1/jobs/{job}/stages/viewspace/shards")
    _hold(interfaces, "ShardPage", shards)
    for shard in shards["shards"]:
        _hold(interfaces, "ShardRow", shard)
    for of in (job, failed):
        events = get(f"/v1/jobs/{of}/events")
        _hold(interfaces, "EventPage", events)
        for event in events["events"]:
            _hold(interfaces, "JobEvent", event)
            _hold(interfaces, "EventData", event["data"])


def test_the_device_types_are_what_the_api_answers(service, interfaces):
    made = service.client.post("/v1/devices", json={"name": "office"}).json()
    _hold(interfaces, "Device", made)
    page = service.client.get("/v1/devices").json()
    _hold(interfaces, "DevicePage", page)
    _hold(interfaces, "Device", page["devices"][0])


def test_the_operators_types_are_what_the_api_answers(service, interfaces):
    operator = tenants.create_tenant(service.engine, "the operator", operator=True)
    key = tenants.create_key(service.engine, operator, "operator", ("read", "submit", "admin"))
    capability = {"cores": 2, "memory_bytes": 1 << 30, "version": "1", "renderer": None}
    workers.tell(service.engine, Telling(name="a:1", host="a", queues=("cpu",), capability=capability))
    headers = {"authorization": f"Bearer {key}"}
    page = service.client.get("/v1/workers", headers=headers).json()
    _hold(interfaces, "WorkerPage", page)
    _hold(interfaces, "Worker", page["workers"][0])
    _hold(interfaces, "Capability", page["workers"][0]["capability"])
    told = service.client.get("/v1/storage", headers=headers).json()
    _hold(interfaces, "Storage", told)
    _hold(interfaces, "StoredKind", told["kinds"]["scenes"])
    _hold(interfaces, "StoredTenant", told["tenants"][0])


def test_the_scene_type_is_what_inspect_says(interfaces):
    from farfield.scene.derive import Suggestion
    from farfield.scene.describe import describe
    from towns import town

    suggestion = Suggestion(
        boxes=(((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),), boxes_why="", cell_m=1.0, cell_why="", interval_deg=11.25,
        interval_why="", budgets=("16 ms",), budgets_why="", hints=(),
    )  # fmt: skip
    said = describe(town(), suggestion)
    _hold(interfaces, "Suggestion", said["suggested"])
    assert set(interfaces["SceneObject"]) <= set(said["objects"][0])
    upload = {"digest", "name", "bytes", "uploaded_at"}
    assert {k for k, optional in interfaces["Scene"].items() if not optional} <= set(said) | upload
