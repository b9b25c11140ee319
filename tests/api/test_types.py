"""The TypeScript types of the pages against the API: by its OpenAPI document, and by real answers what that leaves open."""

import importlib.util
import re
from pathlib import Path

import pytest
from farfield.store import workers
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
    for name, body in re.findall(r"export interface (\w+) \{\n(.*?)\n\}", text, re.S):
        found[name] = {key: bool(mark) for key, mark in re.findall(r"^  (\w+)(\??):", body, re.M)}
    return found


def test_the_schema_is_that_of_the_api(generator):
    made = generator.typescript(generator.document())
    assert generator.TARGET.read_text() == made, "run: python webviewer/scripts/make_api_types.py"


def _hold(interfaces, name, answer):
    wanted = interfaces[name]
    missing = {key for key, optional in wanted.items() if not optional} - set(answer)
    assert not missing, f"{name} has no {sorted(missing)} in the answer"
    unknown = set(answer) - set(wanted)
    assert not unknown, f"{name} does not know {sorted(unknown)}"


def test_the_answer_types_are_what_the_api_answers(service, worker, interfaces):
    jobs = [service.create(), service.create(fail="bake", error="named")]
    worker()
    _hold(interfaces, "Session", service.client.get("/v1/session").json())
    for job in jobs:
        answer = service.client.get(f"/v1/jobs/{job}/events", headers={"accept": "application/json"})
        for event in answer.json()["events"]:
            _hold(interfaces, "EventData", event["data"])


def test_the_operators_types_are_what_the_api_answers(service, operator, interfaces):
    capability = {"cores": 2, "memory_bytes": 1 << 30, "version": "1", "renderer": None}
    workers.tell(service.engine, Telling(name="a:1", host="a", queues=("cpu",), capability=capability))
    page = service.client.get("/v1/workers", headers=operator).json()
    _hold(interfaces, "WorkerPage", page)
    _hold(interfaces, "Worker", page["workers"][0])
    _hold(interfaces, "Capability", page["workers"][0]["capability"])
    told = service.client.get("/v1/storage", headers=operator).json()
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
