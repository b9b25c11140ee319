"""Keys, quotas, limits and the audit log: who may what, how much, how often, and who did it."""

import asyncio
from dataclasses import replace

import pytest
import sqlalchemy as sa
from farfield.errors import QuotaExceeded
from farfield.store import quotas
from farfield.store.engine import read, write
from farfield.store.quotas import Quota
from farfield.store.tables import api_key, audit
from farfield_api import rates, upload
from farfield_api.app import make_app
from farfield_api.routes import keys
from starlette.requests import Request
from starlette.testclient import TestClient


def bearer(key):
    return {"authorization": f"Bearer {key}"}


def limit(service, **quota):
    object.__setattr__(service.settings, "quota", Quota(**quota))


def test_a_key_is_made_used_rotated_and_revoked(service):
    wanted = {"name": "nightly", "scopes": ["submit", "read"], "expires_in_s": 3600}
    made = service.client.post("/v1/keys", json=wanted)
    assert (made.status_code, made.headers["cache-control"]) == (201, "no-store")
    key = made.json()
    assert key["scopes"] == ["read", "submit"]
    assert service.client.get("/v1/usage", headers=bearer(key["key"])).status_code == 200
    shown = service.client.get(made.headers["location"])
    assert "key" not in shown.json()
    assert key["key"].split("_", 2)[2] not in service.client.get("/v1/keys").text + shown.text
    fresh = service.client.post(f"/v1/keys/{key['id']}/rotate", json={"grace_s": 0}).json()
    assert (fresh["name"], fresh["scopes"]) == (key["name"], key["scopes"])
    assert fresh["expires_at"] is not None
    assert service.client.get("/v1/usage", headers=bearer(key["key"])).status_code == 401
    assert service.client.get("/v1/usage", headers=bearer(fresh["key"])).status_code == 200
    assert service.client.delete(f"/v1/keys/{fresh['id']}").json()["revoked_at"] is not None
    assert service.client.get("/v1/usage", headers=bearer(fresh["key"])).status_code == 401
    assert service.client.post(f"/v1/keys/{fresh['id']}/rotate", json={}).json()["code"] == "KeyNotFound"


def test_an_old_key_works_until_its_grace_ends(service):
    key = service.new_key("read")
    path = f"/v1/keys/{key.split('_')[1]}/rotate"
    object.__setattr__(service, "key", key)
    admin = service.new_key("read", "admin")
    service.client.post(path, json={"grace_s": 60}, headers=bearer(admin))
    assert service.client.get("/v1/usage", headers=bearer(key)).status_code == 200


def test_no_key_makes_a_mightier_one(service):
    weak = bearer(service.new_key("admin", "read"))
    for path, body in (("/v1/keys", {"name": "n", "scopes": ["submit"]}),
                       (f"/v1/keys/{service.key.split('_')[1]}/rotate", {})):  # fmt: skip
        answer = service.client.post(path, json=body, headers=weak)
        assert (answer.status_code, answer.json()["detail"]) == (403, "this needs the scope submit")


def test_when_a_key_was_used_is_written_down_later(service):
    state = service.client.app.state.farfield
    with read(service.engine) as tx:
        assert tx.scalar(sa.select(api_key.c.last_used_at)) is None
    service.client.get("/v1/usage")
    state.key_use.write()
    (key,) = service.client.get("/v1/keys").json()["keys"]
    assert key["last_used_at"] is not None


def test_the_operator_makes_tenants_and_sets_what_they_may_have(service, operator):
    made = service.client.post("/v1/tenants", json={"name": "harbour"}, headers=operator)
    assert made.status_code == 201
    assert (
        service.client.post("/v1/tenants", json={"name": "harbour"}, headers=operator).json()["code"] == "TenantExists"
    )
    path = f"{made.headers['location']}/quota"
    seen = service.client.get(path, headers=operator)
    wanted = {"max_jobs": 3, "max_bytes": None, "max_running": 1}
    both = {**operator, "if-match": seen.headers["etag"]}
    changed = service.client.put(path, json=wanted, headers=both)
    assert (changed.status_code, changed.json()) == (200, wanted)
    late = service.client.put(path, json={}, headers=both)
    assert (late.status_code, late.json()["code"]) == (412, "PreconditionFailed")
    assert service.client.get(path, headers=operator).json() == wanted
    assert service.client.get(path, headers={**operator, "if-none-match": changed.headers["etag"]}).status_code == 304
    for most, status in ((2**31 - 1, 200), (2**31, 422)):  # as many as the column holds
        assert service.client.put(path, json={**wanted, "max_jobs": most}, headers=operator).status_code == status
    service.client.put(path, json=wanted, headers=operator)
    acting = {**operator, "farfield-tenant": made.json()["id"]}
    key = service.client.post("/v1/keys", json={"name": "first", "scopes": ["read"]}, headers=acting).json()
    assert key["tenant"] == made.json()["id"]
    usage = service.client.get("/v1/usage", headers=bearer(key["key"])).json()
    assert usage["quota"] == wanted
    assert {t["name"] for t in service.client.get("/v1/tenants", headers=operator).json()["tenants"]} == {
        "toy", "us", "harbour"
    }  # fmt: skip


def test_a_tenant_starts_no_more_jobs_than_it_may(service, worker):
    limit(service, max_running=2, max_jobs=3)
    first, _ = service.create(), service.create()
    body = {"scene": service.upload()}
    answer = service.client.post("/v1/jobs", json=body)
    assert (answer.status_code, answer.json()["code"]) == (429, "RunningQuotaExceeded")
    assert answer.headers["retry-after"]
    service.client.post(f"/v1/jobs/{first}/cancel")
    service.create()
    assert service.client.post(f"/v1/jobs/{first}/retry").json()["code"] == "RunningQuotaExceeded"
    worker()
    assert service.client.post(f"/v1/jobs/{first}/retry").status_code == 200  # it is stored already
    service.client.post(f"/v1/jobs/{first}/cancel")
    answer = service.client.post("/v1/jobs", json=body)
    assert (answer.status_code, answer.json()["code"]) == (403, "QuotaExceeded")
    service.client.delete(f"/v1/jobs/{first}")
    assert service.client.post("/v1/jobs", json=body).status_code == 201


def test_jobs_that_are_asked_for_at_once_do_not_exceed_a_quota(service):
    from concurrent.futures import ThreadPoolExecutor

    limit(service, max_running=3)
    body = {"scene": service.upload()}
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: service.client.post("/v1/jobs", json=body).status_code, range(12)))
    assert sorted(found) == [201] * 3 + [429] * 9


def test_a_tenant_stores_no_more_bytes_than_it_may(service, worker):
    job = service.create()
    worker()
    used = service.client.get("/v1/usage").json()["bytes"]
    limit(service, max_bytes=used + 10)
    other = {"content-disposition": 'attachment; filename="a.glb"'}
    answer = service.client.post("/v1/scenes", content=b'{"b": "0123456789"}', headers=other)
    assert (answer.status_code, answer.json()["code"]) == (403, "QuotaExceeded")
    assert service.upload()  # known already: it costs nothing
    freed = service.client.delete(f"/v1/jobs/{job}").json()["bytes"]
    assert service.client.get("/v1/usage").json()["bytes"] == used - freed
    assert service.client.post("/v1/scenes", content=b'{"b": "0123456789"}', headers=other).status_code == 201


@pytest.mark.parametrize("announced", [True, False])
def test_what_exceeds_the_quota_is_refused_while_it_comes(service, announced, tmp_path):
    piece, n, sent = bytes(1 << 16), 64, []
    limit(service, max_bytes=3 * len(piece))

    async def receive():
        sent.append(len(piece))
        return {"type": "http.request", "body": piece, "more_body": len(sent) < n}

    headers = [(b"content-length", str(n * len(piece)).encode())] if announced else []
    request = Request({"type": "http", "method": "POST", "path": "/v1/scenes", "headers": headers}, receive)
    quota, folder = service.settings.quota, tmp_path / "incoming"
    folder.mkdir()

    def room(already):
        return quotas.check_upload(service.engine, service.tenant_id, quota, already=already)

    with pytest.raises(QuotaExceeded):
        asyncio.run(upload.receive(request, folder, limit=1 << 30, stall_s=5.0, room=room))
    assert len(sent) <= (0 if announced else 4), "it took what it cannot keep"
    assert not list(folder.iterdir())


def test_a_full_tenant_may_send_again_what_it_has(service):
    digest = service.upload(filler="x" * 5000)
    limit(service, max_bytes=1)
    assert service.upload(filler="x" * 5000) == digest
    headers = {"content-disposition": 'attachment; filename="a.glb"', "content-type": "application/octet-stream"}
    answer = service.client.post("/v1/scenes", content=b"y" * 90_000, headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (403, "QuotaExceeded")


def test_a_tenant_cannot_multiply_its_limits_by_keys_without_end(service, monkeypatch):
    monkeypatch.setattr(keys, "MOST", 3)
    answers = [service.client.post("/v1/keys", json={"name": "more", "scopes": ["read"]}) for _ in range(4)]
    made = [a.json()["id"] for a in answers if a.status_code == 201]
    assert answers[-1].json()["code"] == "QuotaExceeded"
    assert len(made) < 3
    rotate = f"/v1/keys/{made[0]}/rotate"
    assert service.client.post(rotate, json={"grace_s": 3600}).json()["code"] == "QuotaExceeded"
    assert service.client.post(rotate, json={}).status_code == 201  # the old one ends
    assert service.client.delete(f"/v1/keys/{made[1]}").status_code == 200
    assert service.client.post("/v1/keys", json={"name": "more", "scopes": ["read"]}).status_code == 201


def test_a_key_that_asks_too_often_is_told_when_to_go_on(service):
    settings = replace(service.settings, rate_read="3/minute", rate_write="1/minute")
    with TestClient(make_app(settings), headers=bearer(service.key), base_url="http://127.0.0.1") as client:
        answers = [client.get("/v1/usage") for _ in range(4)]
        assert [a.status_code for a in answers] == [200, 200, 200, 429]
        assert [a.headers["ratelimit"].split(";")[1] for a in answers] == ["r=2", "r=1", "r=0", "r=0"]
        assert answers[0].headers["ratelimit-policy"] == '"read";q=3;w=60'
        assert (answers[3].json()["code"], 0 < int(answers[3].headers["retry-after"]) <= 60) == ("RateLimited", True)
        other = bearer(service.new_key("read"))
        assert client.get("/v1/usage", headers=other).status_code == 200
        assert client.post("/v1/logins", json={"to": "/jobs"}).status_code == 201  # what changes is counted apart
        assert client.post("/v1/logins", json={"to": "/jobs"}).status_code == 429
        assert "ratelimit" not in client.get("/livez").headers


def test_a_store_of_limits_that_is_away_lets_everybody_through_and_is_left_alone(service, monkeypatch, caplog):
    monkeypatch.setattr(rates, "PAUSE_S", 3600.0)
    settings = replace(service.settings, rate_read="1/minute", rate_store="redis://127.0.0.1:1/0")
    with TestClient(make_app(settings), headers=bearer(service.key), base_url="http://127.0.0.1") as client:
        assert [client.get("/v1/usage").status_code for _ in range(4)] == [200] * 4
    assert caplog.text.count("nobody is limited") == 1


def test_every_change_is_in_the_audit_log_and_nothing_secret(service):
    job = service.create()
    service.client.post(f"/v1/jobs/{job}/cancel")
    service.client.post(f"/v1/jobs/{'0' * 32}/cancel")
    key = service.client.post("/v1/keys", json={"name": "made", "scopes": ["read"]}).json()
    reader = bearer(key["key"])
    assert service.client.post(f"/v1/jobs/{job}/retry", headers=reader).status_code == 403
    service.client.post("/v1/session", json={"key": key["key"]})
    service.client.cookies.clear()
    service.client.get("/v1/jobs")
    service.client.post("/v1/jobs", headers=bearer("ff_nobody_nothing"))
    answer = service.client.get("/v1/audit")
    listed = [(e["action"], e["status"], e["key_name"]) for e in answer.json()["entries"]][::-1]
    assert listed == [
        ("POST /v1/scenes", 201, "test"), ("POST /v1/jobs", 201, "test"), ("POST /v1/jobs/{job_id}/cancel", 200, "test"),
        ("POST /v1/jobs/{job_id}/cancel", 404, "test"), ("POST /v1/keys", 201, "test"),
        ("POST /v1/jobs/{job_id}/retry", 403, "made"), ("POST /v1/session", 200, "made"),
    ]  # fmt: skip
    entries = answer.json()["entries"]
    assert entries[5]["target"] == f"/v1/jobs -> /v1/jobs/{job}"
    assert {e["address"] for e in entries} == {"testclient"}
    assert key["key"].split("_", 2)[2] not in answer.text
    assert [e["id"] for e in service.client.get("/v1/audit?limit=2").json()["entries"]] == [
        e["id"] for e in entries[:2]
    ]
    following = service.client.get("/v1/audit", params={"limit": 2, "cursor": str(entries[1]["id"])}).json()
    assert [e["id"] for e in following["entries"]] == [e["id"] for e in entries[2:4]]
    only = service.client.get("/v1/audit", params={"key": key["id"]}).json()["entries"]
    assert {e["key_name"] for e in only} == {"made"}
    only = service.client.get("/v1/audit", params={"action": "POST /v1/keys"}).json()["entries"]
    assert len(only) == 1
    assert service.client.get("/v1/audit?cursor=x").json()["code"] == "CursorInvalid"


@pytest.mark.parametrize("change", [sa.update(audit).values(status=200), sa.delete(audit)])
def test_nobody_alters_the_audit_log(service, change):
    service.create()
    with pytest.raises(sa.exc.DatabaseError, match="append-only"), write(service.engine) as tx:
        tx.execute(change)


def test_a_change_is_answered_though_it_cannot_be_written_down(service, monkeypatch, caplog):
    def broken(*args, **more):
        raise sa.exc.OperationalError("", None, Exception())

    monkeypatch.setattr("farfield_api.trail.audit.record", broken)
    assert service.create()
    assert "no audit entry" in caplog.text
