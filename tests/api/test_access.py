"""Nobody gets in without a key, and nobody sees another tenant's things."""

from dataclasses import replace

import pytest
from farfield.store import tenants
from farfield_api.app import make_app
from farfield_api.headers import HEADERS
from starlette.testclient import TestClient


def bearer(key):
    return {"authorization": f"Bearer {key}"}


DIGEST, JOB = "0" * 64, "0" * 32
# method, path, body, scope
ROUTES = [
    ("GET", "/metrics", None, "admin"),
    ("GET", "/v1/session", None, "read"),
    ("POST", "/v1/logins", {"to": "/jobs"}, "read"),
    ("POST", "/v1/scenes", None, "submit"),
    ("GET", "/v1/scenes", None, "read"),
    ("GET", f"/v1/scenes/{DIGEST}", None, "read"),
    ("HEAD", f"/v1/scenes/{DIGEST}", None, "read"),
    ("GET", f"/v1/scenes/{DIGEST}/objects", None, "read"),
    ("POST", "/v1/jobs", {"scene": DIGEST}, "submit"),
    ("GET", "/v1/jobs", None, "read"),
    ("GET", f"/v1/jobs/{JOB}", None, "read"),
    ("DELETE", f"/v1/jobs/{JOB}", None, "submit"),
    ("POST", f"/v1/jobs/{JOB}/cancel", None, "submit"),
    ("POST", f"/v1/jobs/{JOB}/retry", None, "submit"),
    ("GET", f"/v1/jobs/{JOB}/report", None, "read"),
    ("GET", f"/v1/jobs/{JOB}/curve", None, "read"),
    ("GET", f"/v1/jobs/{JOB}/events", None, "read"),
    ("GET", f"/v1/jobs/{JOB}/stages/scene/shards", None, "read"),
    ("POST", "/v1/devices", {"name": "office"}, "submit"),
    ("GET", "/v1/devices", None, "read"),
    ("GET", f"/v1/devices/{JOB}", None, "read"),
    ("POST", f"/v1/devices/{JOB}/samples", {"samples": []}, "submit"),
    ("GET", "/v1/placements", None, "read"),
    ("GET", "/v1/placements/town/manifest.json", None, "read"),
]
OPEN = {"/livez", "/readyz", "POST /v1/session"}


def test_every_route_is_in_the_table(service):
    described = service.client.get("/v1/openapi.json").json()
    assert described["openapi"].startswith("3.1")
    known = {
        (
            m,
            p.replace(DIGEST, "{digest}")
            .replace(f"devices/{JOB}", "devices/{device_id}")
            .replace(JOB, "{job_id}")
            .replace("/scene/", "/{stage}/"),
        )
        for m, p, _, _ in ROUTES
    }
    known |= {("GET", "/livez"), ("GET", "/readyz"), ("POST", "/v1/session"), ("DELETE", "/v1/session")}
    known |= {("GET", "/v1/placements/{placement}/{path}")}
    found = {(method.upper(), path) for path, methods in described["paths"].items() for method in methods}
    assert found <= known


@pytest.mark.parametrize("method, path, body, scope", ROUTES)
def test_without_a_key_with_a_wrong_one_or_without_the_scope(service, method, path, body, scope):
    def status(headers):
        answer = service.client.request(method, path, json=body, headers=headers)
        assert (
            answer.status_code < 400 or method == "HEAD" or answer.headers["content-type"] == "application/problem+json"
        )
        return answer.status_code

    key = service.key
    assert status({"authorization": ""}) == 401
    assert status(bearer("ff_nobody_nothing")) == 401
    assert status(bearer(key[:-1] + ("a" if key[-1] != "a" else "b"))) == 401
    assert status(bearer(service.new_key(*({"read", "submit", "admin"} - {scope})))) == (403)
    assert status(bearer(service.new_key(scope))) not in (401, 403)


def test_a_foreign_key_finds_nothing(service, worker):
    digest, job = service.upload(), service.create()
    worker()
    foreign = bearer(service.new_key("read", "submit", tenant="other"))
    paths = [f"/v1/scenes/{digest}", f"/v1/scenes/{digest}/objects", f"/v1/jobs/{job}", f"/v1/jobs/{job}/events",
             f"/v1/jobs/{job}/report", f"/v1/placements/{job}/manifest.json",
             f"/v1/jobs/{job}/stages/scene/shards"]  # fmt: skip
    for path in paths:
        assert service.client.get(path).status_code == 200, path
        assert service.client.get(path, headers=foreign).status_code == 404, path
    assert service.client.post(f"/v1/jobs/{job}/cancel", headers=foreign).status_code == 404
    assert service.client.delete(f"/v1/jobs/{job}", headers=foreign).status_code == 404
    assert service.client.post("/v1/jobs", json={"scene": digest}, headers=foreign).status_code == 404
    assert service.client.get("/v1/jobs", headers=foreign).json()["jobs"] == []
    assert service.client.get("/v1/scenes", headers=foreign).json()["scenes"] == []


def test_a_revoked_key_ends_its_sessions(service):
    key = service.new_key("read")
    service.client.headers.pop("authorization")
    assert service.client.post("/v1/session", json={"key": key}).status_code == 200
    assert service.client.get("/v1/jobs").status_code == 200
    tenants.revoke_key(service.engine, key.split("_")[1])
    assert service.client.get("/v1/jobs").status_code == 401


def test_a_session_needs_its_token_to_change_anything(service):
    digest = service.upload()
    service.client.headers.pop("authorization")
    answer = service.client.post("/v1/session", json={"key": service.key})
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    token = service.client.get("/v1/session").json()["csrf_token"]
    assert token == answer.json()["csrf_token"]
    body = {"scene": digest}
    assert service.client.post("/v1/jobs", json=body).json()["code"] == "CsrfMissing"
    assert service.client.post("/v1/jobs", json=body, headers={"x-csrf-token": "0" * 64}).status_code == 403
    assert service.client.post("/v1/jobs", json=body, headers={"x-csrf-token": token}).status_code == 201
    assert service.client.delete("/v1/session", headers={"x-csrf-token": token}).status_code == 204
    assert service.client.get("/v1/jobs").status_code == 401


def test_another_site_cannot_start_a_session(service):
    # A form of another site can only send simple content types, whatever the body looks like.
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x"):
        body = '{"key": "' + service.key + '"}'
        answer = service.client.post("/v1/session", content=body, headers={"content-type": kind})
        assert answer.status_code == 422
        assert "set-cookie" not in answer.headers


def test_a_forged_session_is_refused(service):
    service.client.headers.pop("authorization")
    service.client.post("/v1/session", json={"key": service.key})
    key_id, expires, mac = service.client.cookies["farfield_session"].split(".")
    for forged in (
        f"{key_id}.{int(expires) + 9}.{mac}",
        f"{key_id}.{expires}.{'0' * 64}",
        "",
        "a.b",
        f"{'f' * 32}.{expires}.{mac}",
    ):
        service.client.cookies.clear()
        answer = service.client.get("/v1/jobs", headers={"cookie": f"farfield_session={forged}"})
        assert answer.status_code == 401


def test_a_login_link_works_once(service):
    url = service.client.post("/v1/logins", json={"to": "/viewer/town"}).json()["url"]
    address, _, fragment = url.partition("#")
    assert address == "http://127.0.0.1/open"
    token = fragment.removeprefix("login=").removesuffix("&to=/viewer/town")
    service.client.headers.pop("authorization")
    assert service.client.post("/v1/session", json={"login": token}).status_code == 200
    assert service.client.get("/v1/placements/town/manifest.json").status_code == 200
    assert service.client.post("/v1/session", json={"login": token}).status_code == 401


@pytest.mark.parametrize("to", ["//elsewhere.example", "https://elsewhere.example", "/\\elsewhere", "jobs"])
def test_a_login_link_leads_nowhere_else(service, to):
    answer = service.client.post("/v1/logins", json={"to": to})
    assert answer.status_code == 422


def test_pages_carry_a_policy_without_inline_script(service):
    for path in ("/jobs", "/jobs/1", "/jobs/1/report", "/viewer/town", "/open", "/open/open.js", "/assets/app-abc.js"):
        answer = service.client.get(path, headers={"authorization": ""})
        assert answer.status_code == 200, path
        script = answer.headers["content-security-policy"].split("script-src")[1].split(";")[0]
        assert "unsafe-inline" not in script
    assert "immutable" in service.client.get("/assets/app-abc.js").headers["cache-control"]
    assert service.client.get("/", follow_redirects=False).headers["location"] == "/jobs"
    assert service.client.get("/nothing").json()["code"] == "NotFound"
    assert service.client.get("/..%2f..%2fsecret.txt").status_code == 404


def test_every_answer_has_the_security_headers(service, monkeypatch):
    def broken(*arguments, **options):
        raise RuntimeError("odd")

    monkeypatch.setattr("farfield_api.routes.jobs.jobs.page", broken)
    app = make_app(replace(service.settings, hosts=("127.0.0.1",)))
    unexpecting = TestClient(
        app, headers=bearer(service.key), raise_server_exceptions=False, base_url="http://127.0.0.1"
    )
    answers = {
        200: unexpecting.get("/livez"), 404: unexpecting.get("/v1/jobs/none"), 500: unexpecting.get("/v1/jobs"),
        400: unexpecting.get("/livez", headers={"host": "elsewhere.example"}),
    }  # fmt: skip
    for status, answer in answers.items():
        assert answer.status_code == status
        for header, value in HEADERS.items():
            assert answer.headers.get_list(header) == [value]
