"""Webhooks over HTTP: registered, changed, tried, listed, deleted; secrets shown once."""

import pytest
from farfield.webhooks import networks

PUBLIC = "https://8.8.8.8/farfield"


def make(service, **more):
    answer = service.client.post("/v1/webhooks", json={"name": "pipeline", "url": PUBLIC, **more})
    assert answer.status_code == 201, answer.text
    return answer


def test_a_secret_is_shown_once(service):
    made = make(service)
    secret = made.json()["secret"]
    assert made.headers["cache-control"] == "no-store"
    fresh = service.client.post(f"{made.headers['location']}/rotate").json()["secret"]
    assert fresh != secret
    shown = service.client.get(made.headers["location"]).text + service.client.get("/v1/webhooks").text
    shown += service.client.get("/v1/audit").text
    assert "secret" not in shown
    assert secret not in shown
    assert fresh not in shown


def test_a_job_may_name_a_webhook_and_it_is_told(service, worker):
    hook = make(service).json()["id"]
    job = service.client.post("/v1/jobs", json={"scene": service.upload(), "webhook": hook}).json()
    assert job["webhook"] == hook
    service.create(other=1)
    worker()
    listed = service.client.get(f"/v1/webhooks/{hook}/deliveries").json()["deliveries"]
    assert [(d["event"], d["job"], d["state"], d["attempt"]) for d in listed] == [("job.done", job["id"], "pending", 0)]
    missing = service.client.post("/v1/jobs", json={"scene": service.upload(), "webhook": "0" * 32})
    assert (missing.status_code, missing.json()["code"]) == (404, "WebhookNotFound")
    assert service.client.delete(f"/v1/webhooks/{hook}").status_code == 204
    assert service.client.get(f"/v1/jobs/{job['id']}").json()["webhook"] is None


def test_only_an_admin_hears_of_all_jobs(service):
    submit = {"authorization": f"Bearer {service.new_key('submit', 'read')}"}
    body = {"name": "n", "url": PUBLIC, "every_job": True}
    assert service.client.post("/v1/webhooks", json=body, headers=submit).status_code == 403
    every = make(service, every_job=True).headers["location"]
    named = service.client.post("/v1/webhooks", json={"name": "n", "url": PUBLIC}, headers=submit).headers["location"]
    assert service.client.patch(named, json={"every_job": True}, headers=submit).status_code == 403
    assert service.client.patch(named, json={"active": False}, headers=submit).json()["active"] is False
    for method, path in (("PATCH", every), ("DELETE", every), ("POST", f"{every}/rotate")):
        body = {"url": PUBLIC} if method == "PATCH" else None
        assert service.client.request(method, path, json=body, headers=submit).status_code == 403


def test_a_change_minds_what_others_have_changed(service):
    path = make(service).headers["location"]
    seen = service.client.get(path).headers["etag"]
    assert service.client.patch(path, json={"events": ["done"]}, headers={"if-match": seen}).json()["events"] == [
        "done"
    ]
    assert service.client.patch(path, json={"name": "late"}, headers={"if-match": seen}).status_code == 412
    assert service.client.delete(path, headers={"if-match": seen}).status_code == 412
    assert service.client.get(path).json()["name"] == "pipeline"
    assert service.client.delete(path, headers={"if-match": "*"}).status_code == 204


@pytest.mark.parametrize("url", ["https://127.0.0.1/", "https://localhost/", "https://[::1]:8000/", "https://10.1.2.3/",
                                 "https://169.254.169.254/", "http://8.8.8.8/", "https://name.invalid/"])  # fmt: skip
def test_private_addresses_are_refused_unless_allowed(service, url):
    answer = service.client.post("/v1/webhooks", json={"name": "n", "url": url})
    assert (answer.status_code, answer.json()["code"]) == (422, "WebhookAddressRefused")
    path = make(service).headers["location"]
    assert service.client.patch(path, json={"url": url}).json()["code"] == "WebhookAddressRefused"
    object.__setattr__(service.settings, "webhook_networks", networks("127.0.0.0/8,10.0.0.0/8"))
    allowed = service.client.post("/v1/webhooks", json={"name": "n", "url": "http://10.1.2.3/"})
    assert allowed.status_code == 201


def test_deliveries_are_tried_again_and_listed_in_pages(service):
    hook = make(service).json()["id"]
    path = f"/v1/webhooks/{hook}"
    made = [service.client.post(f"{path}/test").json()["delivery"] for _ in range(3)]
    first = service.client.get(f"{path}/deliveries?limit=2").json()
    rest = service.client.get(f"{path}/deliveries", params={"limit": 2, "cursor": first["next"]}).json()
    assert {d["id"] for d in (*first["deliveries"], *rest["deliveries"])} == set(made)
    assert service.client.post(f"{path}/deliveries/{made[0]}/redeliver").status_code == 202
    assert service.client.post(f"{path}/deliveries/{'0' * 32}/redeliver").json()["code"] == "DeliveryNotFound"
    assert service.client.get(f"{path}/deliveries?state=failed").json()["deliveries"] == []


def test_a_tenant_has_so_many_webhooks(service, monkeypatch):
    monkeypatch.setattr("farfield.store.webhooks.MAX_WEBHOOKS", 1)
    make(service)
    answer = service.client.post("/v1/webhooks", json={"name": "n", "url": PUBLIC})
    assert (answer.status_code, answer.json()["code"]) == (403, "QuotaExceeded")
