"""The API holds to its OpenAPI document, whatever it is asked: no answer that is not described, no failure of the service.

`--accept` asks far more. The same requests every time: they are made from a fixed seed.
"""

import pytest
import requests
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis.errors import Unsatisfiable
from schemathesis.checks import CHECKS, load_all_checks
from schemathesis.core.failures import FailureGroup
from schemathesis.generation import GenerationMode

load_all_checks()
schemathesis.serializer.alias("application/offset+octet-stream", "application/octet-stream")
HELD = CHECKS.get_by_names(
    ["not_a_server_error", "status_code_conformance", "content_type_conformance", "response_headers_conformance",
     "response_schema_conformance", "negative_data_rejection"]
)  # fmt: skip
STREAM = "/v1/jobs/{job_id}/events"  # endless, where JSON is not asked for


@pytest.fixture
def there(service, worker):
    """One of everything that has an address: {name in paths: its value}."""
    ask = service.client
    job = service.create()
    worker()
    hook = ask.post("/v1/webhooks", json={"name": "n", "url": "https://8.8.8.8/"}).json()["id"]
    return {
        "job_id": job, "digest": service.upload(), "placement": job, "webhook_id": hook, "path": "manifest.json",
        "stage": "viewspace", "tenant_id": service.tenant_id, "key_id": service.new_key("read").split("_")[1],
        "device_id": ask.post("/v1/devices", json={"name": "office"}).json()["id"],
        "delivery_id": ask.post(f"/v1/webhooks/{hook}/test").json()["delivery"],
    }  # fmt: skip


def examine(service, operation, key, there, *, number, mode):
    """Ask the operation `number` times, and check the answers."""
    names = {p.name for p in operation.path_parameters}
    known = {name: value for name, value in there.items() if name in names} if mode is GenerationMode.POSITIVE else {}
    headers = {"authorization": f"Bearer {key}", **({"accept": "application/json"} if operation.path == STREAM else {})}

    @settings(
        max_examples=number, derandomize=True, deadline=None, database=None, phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(case=operation.as_strategy(generation_mode=mode, path_parameters=known or None))
    def check(case):
        asked = case.as_transport_kwargs(base_url="http://127.0.0.1", headers=headers)
        known = {k: asked[k] for k in ("method", "url", "headers", "params", "json", "data", "files") if k in asked}
        ready = requests.Request(**known, cookies=asked.get("cookies")).prepare()
        answer = service.client.request(ready.method, ready.url, headers=dict(ready.headers), content=ready.body)
        case.validate_response(answer, checks=_held(operation.path), headers=headers)

    try:
        check()
    except Unsatisfiable:
        assert mode is GenerationMode.NEGATIVE  # nothing can be wrong with a request that says nothing


def _held(path):
    """Return the checks for a path: what may be true, and is no failure of the service."""
    left_out = {
        "/readyz": "not_a_server_error"
    }  # it answers 503 where the database or its migrations are not as they must be
    if path.startswith("/v1/uploads"):
        left_out[path] = (
            "negative_data_rejection"  # numbers in headers, which are read as leniently as tus clients write them
        )
    return [check for check in HELD if check.__name__ != left_out.get(path)]


def test_every_answer_is_as_the_document_says(service, there, request, monkeypatch):
    async def no_fit(state, frames):
        return None, {"code": "SamplesTooFew", "detail": "too few", "advice": "more"}

    monkeypatch.setattr("farfield_api.routes.devices._fit", no_fit)  # seconds each; tests/api/test_devices.py has them
    service.client._transport.raise_server_exceptions = False  # a failure of the service is an answer, too: 500
    number = 25 if request.config.getoption("--accept") else 1
    admin = service.new_key("read", "submit", "admin")
    document = service.client.get("/v1/openapi.json").json()
    for methods in document["paths"].values():
        for operation in methods.values():
            del operation["responses"]["default"]  # what nobody foresaw: here it would excuse everything
    schema = schemathesis.openapi.from_dict(document)
    failures, asked = [], 0
    # What deletes comes last, or there would be little to ask for.
    operations = sorted((result.ok() for result in schema.get_all_operations()), key=lambda o: o.method == "delete")
    for operation in operations:
        for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
            try:
                examine(service, operation, admin, there, number=number, mode=mode)
            except FailureGroup as group:
                failures += [f"{operation.label} ({mode.value}): {e}" for e in group.exceptions]
            asked += 1
    assert asked > 100
    assert not failures, "\n\n".join(failures)
