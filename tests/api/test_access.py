"""Nobody gets in without a key, and nobody sees another tenant's things."""

import json
import re
from dataclasses import replace

import pytest
import sqlalchemy as sa
from farfield.store import tenants
from farfield.store.tables import ended_session
from farfield_api.app import make_app
from farfield_api.headers import HEADERS as SECURITY
from starlette.testclient import TestClient


def bearer(key):
    return {"authorization": f"Bearer {key}"}


DIGEST, ID = "0" * 64, "0" * 32
OPERATOR = "operator"  # scope admin, of the operator's tenant
# Every route: method, path as the app knows it, body, scope that it needs. `FREE` needs none, `ANY` any key.
FREE, ANY = "free", "any"
ROUTES = [
    ("GET", "/livez", None, FREE),
    ("GET", "/readyz", None, FREE),
    ("GET", "/v1/openapi.json", None, FREE),
    ("GET", "/metrics", None, OPERATOR),
    ("GET", "/v1/workers", None, OPERATOR),
    ("GET", "/v1/storage", None, OPERATOR),
    ("POST", "/v1/session", {"key": "ff_nobody_nothing"}, FREE),
    ("GET", "/v1/session", None, "read"),
    ("DELETE", "/v1/session", None, ANY),
    ("POST", "/v1/logins", {"to": "/jobs"}, "read"),
    ("OPTIONS", "/v1/uploads", None, "read"),
    ("POST", "/v1/uploads", None, "submit"),
    ("GET", "/v1/uploads", None, "read"),
    ("GET", "/v1/uploads/{upload_id}", None, "read"),
    ("HEAD", "/v1/uploads/{upload_id}", None, "read"),
    ("PATCH", "/v1/uploads/{upload_id}", None, "submit"),
    ("DELETE", "/v1/uploads/{upload_id}", None, "submit"),
    ("POST", "/v1/scenes", None, "submit"),
    ("GET", "/v1/scenes", None, "read"),
    ("GET", "/v1/scenes/{digest}", None, "read"),
    ("HEAD", "/v1/scenes/{digest}", None, "read"),
    ("DELETE", "/v1/scenes/{digest}", None, "submit"),
    ("GET", "/v1/scenes/{digest}/objects", None, "read"),
    ("GET", "/v1/scenes/{digest}/picture", None, "read"),
    ("POST", "/v1/jobs", {"scene": DIGEST}, "submit"),
    ("GET", "/v1/jobs", None, "read"),
    ("GET", "/v1/jobs/{job_id}", None, "read"),
    ("DELETE", "/v1/jobs/{job_id}", None, "submit"),
    ("POST", "/v1/jobs/{job_id}/cancel", None, "submit"),
    ("POST", "/v1/jobs/{job_id}/retry", None, "submit"),
    ("GET", "/v1/jobs/{job_id}/report", None, "read"),
    ("GET", "/v1/jobs/{job_id}/curve", None, "read"),
    ("GET", "/v1/jobs/{job_id}/events", None, "read"),
    ("GET", "/v1/jobs/{job_id}/stages/{stage}/shards", None, "read"),
    ("POST", "/v1/devices", {"name": "office"}, "submit"),
    ("GET", "/v1/devices", None, "read"),
    ("GET", "/v1/devices/{device_id}", None, "read"),
    ("DELETE", "/v1/devices/{device_id}", None, "submit"),
    ("POST", "/v1/devices/{device_id}/samples", {"samples": []}, "submit"),
    ("GET", "/v1/placements", None, "read"),
    ("GET", "/v1/placements/{placement}/gltf", None, "read"),
    ("GET", "/v1/placements/{placement}/{path:path}", None, "read"),
    ("HEAD", "/v1/placements/{placement}/{path:path}", None, "read"),
    ("POST", "/v1/tenants", {"name": "new"}, OPERATOR),
    ("GET", "/v1/tenants", None, OPERATOR),
    ("GET", "/v1/tenants/{tenant_id}", None, OPERATOR),
    ("GET", "/v1/tenants/{tenant_id}/quota", None, OPERATOR),
    ("PUT", "/v1/tenants/{tenant_id}/quota", {}, OPERATOR),
    ("GET", "/v1/usage", None, "read"),
    ("POST", "/v1/keys", {"name": "new", "scopes": ["admin"]}, "admin"),
    ("GET", "/v1/keys", None, "admin"),
    ("GET", "/v1/keys/{key_id}", None, "admin"),
    ("DELETE", "/v1/keys/{key_id}", None, "admin"),
    ("POST", "/v1/keys/{key_id}/rotate", {}, "admin"),
    ("POST", "/v1/webhooks", {"name": "new", "url": "https://8.8.8.8/"}, "submit"),
    ("GET", "/v1/webhooks", None, "read"),
    ("GET", "/v1/webhooks/{webhook_id}", None, "read"),
    ("PATCH", "/v1/webhooks/{webhook_id}", {}, "submit"),
    ("DELETE", "/v1/webhooks/{webhook_id}", None, "submit"),
    ("POST", "/v1/webhooks/{webhook_id}/rotate", None, "submit"),
    ("POST", "/v1/webhooks/{webhook_id}/test", None, "submit"),
    ("GET", "/v1/webhooks/{webhook_id}/deliveries", None, "read"),
    ("POST", "/v1/webhooks/{webhook_id}/deliveries/{delivery_id}/redeliver", None, "submit"),
    ("GET", "/v1/audit", None, "admin"),
]
# What shows no data: the pages, which ask for all they show under /v1.
PAGES = {"/", "/jobs", "/jobs/{item}", "/jobs/{item}/report", "/viewer/{item}", "/viewer/{item}/report", "/compare",
         "/workers", "/storage", "/devices", "/open", "/open/{name}", "/{path:path}"}  # fmt: skip
GUARDED = [route for route in ROUTES if route[3] != FREE]
EXAMPLES = {"digest": DIGEST, "stage": "scene", "placement": "town", "path:path": "manifest.json"}
HEADERS = {"tus-resumable": "1.0.0", "accept": "application/json"}


def at(path, **more):
    """Return the path with examples in its braces."""
    return re.sub(r"\{([\w:]+)\}", lambda m: more.get(m[1], EXAMPLES.get(m[1], ID)), path)


def all_routes(routes):
    for route in routes:
        inner = getattr(route, "original_router", None) or getattr(getattr(route, "app", None), "router", None)
        if inner is not None:
            yield from all_routes(inner.routes)
        else:
            for method in route.methods - ({"HEAD"} if "GET" in route.methods else set()):
                yield method, route.path


def test_every_route_is_in_the_table(service):
    found = {(m, p) for m, p in all_routes(service.client.app.routes) if p not in PAGES}
    known = {(m, p) for m, p, _, _ in ROUTES}
    assert found == known, "say in ROUTES which scope a new route needs: the tests here then try to get in"
    pages = {p for _, p in all_routes(service.client.app.routes)} & PAGES
    assert pages == PAGES


def ask(service, method, path, body, **headers):
    answer = service.client.request(method, at(path), json=body, headers={**HEADERS, **headers})
    if answer.status_code >= 400 and method != "HEAD":
        assert answer.headers["content-type"] == "application/problem+json"
    return answer


@pytest.fixture
def keys(service):
    """Keys that are none, and keys that lack something, by what is wrong with them."""
    engine, everything = service.engine, ("read", "submit", "admin")
    good = service.key
    found = {
        "missing": "", "not a key": "Bearer ff_nobody_nothing", "another scheme": f"Basic {good}", "empty": "Bearer ",
        "wrong": f"Bearer {good[:-1]}{'a' if good[-1] != 'a' else 'b'}", "prefix": f"Bearer xx{good[2:]}",
        "another's secret": f"Bearer ff_{service.new_key('read').split('_')[1]}_{good.split('_', 2)[2]}",
    }  # fmt: skip
    expired = tenants.create_key(engine, service.tenant_id, "expired", everything, lifetime_s=-1.0)
    revoked = service.new_key(*everything)
    tenants.revoke_key(engine, revoked.split("_")[1])
    return found | {"expired": f"Bearer {expired}", "revoked": f"Bearer {revoked}"}


def test_nobody_gets_in_without_a_valid_key(service, keys):
    answers, often = {}, {what: keys[what] for what in ("missing", "wrong", "expired", "revoked")}
    for i, (method, path, body, _) in enumerate(GUARDED):
        for what, header in (keys if i == 1 else often).items():
            answer = ask(service, method, path, body, authorization=header)
            assert answer.status_code == 401, (method, path, what)
            if method != "HEAD" and what != "missing":
                answers[what] = {k: v for k, v in answer.json().items() if k != "request_id"}
    assert len({json.dumps(answer) for answer in answers.values()}) == 1  # why it is no key cannot be told


def test_no_scope_stands_for_another(service):
    scopes = {"read", "submit", "admin"}
    under = {scope: service.new_key(*scopes - {scope}) for scope in scopes} | {OPERATOR: service.new_key(*scopes)}
    enough = {scope: service.new_key(scope) for scope in scopes}
    enough[OPERATOR] = service.new_key("admin", tenant="us", operator=True)
    for method, path, body, scope in GUARDED:
        if scope == ANY:
            continue
        assert ask(service, method, path, body, authorization=f"Bearer {under[scope]}").status_code == 403, (
            method,
            path,
        )
        answer = ask(service, method, path, body, authorization=f"Bearer {enough[scope]}")
        assert answer.status_code not in (401, 403), (method, path, answer.text)


def test_an_operators_key_without_admin_is_like_any_other(service):
    key = service.new_key("read", "submit", tenant="us", operator=True)
    for method, path, body, scope in GUARDED:
        if scope == OPERATOR:
            assert ask(service, method, path, body, authorization=f"Bearer {key}").status_code == 403
    named = {"farfield-tenant": service.tenant_id, "authorization": f"Bearer {key}"}
    assert service.client.get("/v1/jobs", headers=named).json()["code"] == "TenantRefused"


def test_a_session_without_its_token_changes_nothing(service):
    service.client.headers.pop("authorization")
    service.client.post("/v1/session", json={"key": service.key})
    for method, path, body, _ in GUARDED:
        if method in ("GET", "HEAD", "OPTIONS"):
            continue
        for token in ({}, {"x-csrf-token": ""}, {"x-csrf-token": "0" * 64}, {"x-csrf-token": "\u00e9"}):
            answer = ask(service, method, path, body, **{k: v.encode("latin-1") for k, v in token.items()})
            assert (answer.status_code, answer.json()["code"]) == (403, "CsrfMissing"), (method, path)
    assert service.client.get("/v1/session").status_code == 200


def things(service, worker):
    """Make one of everything that has an address; return {name in paths: its value}."""
    job = service.create()
    worker()
    hook = service.client.post("/v1/webhooks", json={"name": "n", "url": "https://8.8.8.8/"}).json()["id"]
    upload = service.client.post("/v1/uploads", headers={**HEADERS, "upload-length": "9"}).headers["location"]
    return {
        "job_id": job, "digest": service.upload(), "placement": job, "webhook_id": hook,
        "device_id": service.client.post("/v1/devices", json={"name": "office"}).json()["id"],
        "key_id": service.new_key("read").split("_")[1], "upload_id": upload.rsplit("/", 1)[-1],
        "delivery_id": service.client.post(f"/v1/webhooks/{hook}/test").json()["delivery"],
    }  # fmt: skip


def test_what_is_another_tenants_is_not_there(service, worker):
    """Status, body and headers are those for what nobody has: knowing a digest or an id tells nothing."""
    there = things(service, worker)
    foreign = {"authorization": f"Bearer {service.new_key('read', 'submit', 'admin', tenant='other')}"}
    tried = 0
    for method, path, body, scope in GUARDED:
        if "{" not in path or scope == OPERATOR:
            continue
        real, none = at(path, **there), at(path, placement=ID)
        extra = {**HEADERS, **foreign, **({"upload-offset": "0", "content-type": "application/offset+octet-stream"}
                                          if method == "PATCH" and "uploads" in path else {})}  # fmt: skip
        theirs, nobodys = (service.client.request(method, p, json=body, headers=extra) for p in (real, none))
        assert theirs.status_code == 404, (method, path, theirs.text)

        def plain(answer):
            text = answer.text
            for name, value in there.items():
                text = text.replace(value, EXAMPLES.get(name, ID) if name != "placement" else ID)
            gone = ("ratelimit", "ratelimit-policy", "content-length", "x-request-id")
            text = re.sub(r',"request_id":"[^"]*"', "", text)
            return answer.status_code, text, {k: v for k, v in answer.headers.items() if k not in gone}

        assert plain(theirs) == plain(nobodys), (method, path)
        tried += 1
    assert tried > 25
    assert service.client.get(f"/v1/jobs/{there['job_id']}").json()["state"] == "done"  # nothing happened to it
    for path, key in (("/v1/jobs", "jobs"), ("/v1/scenes", "scenes"), ("/v1/devices", "devices"), ("/v1/uploads", "uploads"),
                      ("/v1/webhooks", "webhooks")):  # fmt: skip
        assert service.client.get(path).json()[key] != []
        assert service.client.get(path, headers=foreign).json()[key] == []
    listed = service.client.get("/v1/placements", headers=foreign).json()["placements"]
    assert [p["id"] for p in listed] == ["town"]  # what the operator shows to everybody
    body = {"scene": there["digest"]}
    assert service.client.post("/v1/jobs", json=body, headers=foreign).json()["code"] == "SceneNotFound"
    body = {"scene": service.upload(), "webhook": there["webhook_id"]}
    assert service.client.post("/v1/jobs", json=body, headers=foreign).status_code == 404


def test_a_scene_that_another_tenant_has_is_sent_and_read_and_counted_like_a_new_one(service):
    digest = service.upload(a="same")
    foreign = {"authorization": f"Bearer {service.new_key('read', 'submit', tenant='other')}"}
    assert service.client.head(f"/v1/scenes/{digest}", headers=foreign).status_code == 404
    content, name = json.dumps({"a": "same"}).encode(), {"content-disposition": 'attachment; filename="toy.glb"'}
    sent = service.client.post("/v1/scenes", content=content, headers={**foreign, **name})
    assert (sent.status_code, sent.json()["digest"]) == (201, digest)
    path = f"/v1/scenes/{digest}?dry_run=true"
    both = [service.client.delete(path, headers=h).json() for h in ({}, foreign)]
    assert both[0] == both[1]
    assert both[0]["bytes"] > 0  # as if nobody else had it
    used = [service.client.get("/v1/usage", headers=h).json()["bytes"] for h in ({}, foreign)]
    assert used[0] == used[1]
    assert service.client.delete(f"/v1/scenes/{digest}", headers=foreign).json()["deleted"]
    assert service.client.get(f"/v1/scenes/{digest}/objects").status_code == 200


def test_an_operator_acts_in_the_tenant_that_it_names(service, worker):
    job = service.create()
    us = tenants.create_tenant(service.engine, "us", operator=True)
    key = {"authorization": f"Bearer {tenants.create_key(service.engine, us, 'us', ('read', 'submit', 'admin'))}"}
    path = f"/v1/jobs/{job}"
    assert service.client.get(path, headers=key).status_code == 404
    for named in (service.tenant_id, "*"):
        acting = {**key, "farfield-tenant": named}
        assert service.client.get(path, headers=acting).json()["tenant"] == service.tenant_id
        assert [j["id"] for j in service.client.get("/v1/jobs", headers=acting).json()["jobs"]] == [job]
    everyone = {**key, "farfield-tenant": "*"}
    assert service.client.post(f"{path}/cancel", headers=everyone).json()["code"] == "TenantNeeded"
    acting = {**key, "farfield-tenant": service.tenant_id}
    assert service.client.post(f"{path}/cancel", headers=acting).json()["state"] == "cancelled"
    entry = service.client.get("/v1/audit").json()["entries"][0]
    assert (entry["key_name"], entry["target"], entry["tenant"]) == ("us", f"{path}/cancel", service.tenant_id)
    assert service.client.get("/v1/jobs", headers={**key, "farfield-tenant": ID}).json()["code"] == "TenantNotFound"
    refused = service.client.get("/v1/jobs", headers={"farfield-tenant": us})
    assert (refused.status_code, refused.json()["code"]) == (403, "TenantRefused")


def test_answers_are_kept_in_private_caches_only(service, worker):
    there = things(service, worker)
    for method, path, body, _ in ROUTES:
        if path.startswith("/v1/") and path != "/v1/openapi.json" and "events" not in path:
            answer = service.client.request(method, at(path, **there), json=body, headers=HEADERS)
            caching = answer.headers["cache-control"]
            assert "private" in caching or "no-store" in caching, (method, path)
            assert "public" not in caching
            if "no-store" not in caching:
                assert {"authorization", "cookie"} <= {v.strip().lower() for v in answer.headers["vary"].split(",")}


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


def test_a_cookie_that_somebody_kept_opens_nothing_after_log_out(service):
    service.client.headers.pop("authorization")
    token = service.client.post("/v1/session", json={"key": service.key}).json()["csrf_token"]
    kept = service.client.cookies["farfield_session"]
    service.client.post("/v1/session", json={"key": service.key})  # another session of the same key, at the same second
    mine = service.client.cookies["farfield_session"]
    assert mine != kept

    def ask(session, method="GET", **headers):
        service.client.cookies.clear()
        return service.client.request(
            method, "/v1/session", headers={"cookie": f"farfield_session={session}", **headers}
        )

    assert ask(kept, "DELETE").json()["code"] == "CsrfMissing"
    assert ask(kept).status_code == 200
    assert ask(kept, "DELETE", **{"x-csrf-token": token}).status_code == 204
    assert (ask(kept).status_code, ask(kept).json()["code"]) == (401, "KeyUnknown")
    assert ask(mine).status_code == 200, "the key's other session goes on"
    with service.engine.connect() as tx:
        (stored,) = tx.scalars(sa.select(ended_session.c.session_digest))
    assert stored != kept and kept not in stored


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
    key_id, expires, nonce, mac = service.client.cookies["farfield_session"].split(".")
    for forged in (
        f"{key_id}.{int(expires) + 9}.{nonce}.{mac}",
        f"{key_id}.{expires}.{nonce}.{'0' * 64}",
        f"{key_id}.{expires}.{nonce[::-1]}.{mac}",
        f"{key_id}.{expires}.{mac}",
        "",
        "a.b",
        f"{'f' * 32}.{expires}.{nonce}.{mac}",
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
        for header, value in SECURITY.items():
            assert answer.headers.get_list(header) == [value]
