"""Devices: frames in as they come, a profile once they suffice, and jobs that take its figures."""

import json

import pytest
from farfield.rendertime.profiles import PROFILES
from farfield.rendertime.samples import COLUMNS
from farfield.settings import COEFFICIENTS
from naive.fit import TRUE, frames


def bearer(key):
    return {"authorization": f"Bearer {key}"}


def rows(samples):
    return [dict(zip((*COLUMNS, "ms"), row)) for row in samples.tolist()]


def make(service, name="office", **more):
    answer = service.client.post("/v1/devices", json={"name": name, **more})
    assert answer.status_code == 201, answer.text
    assert answer.headers["location"] == f"/v1/devices/{answer.json()['id']}"
    return answer.json()["id"]


def send(service, device, samples, **more):
    return service.client.post(f"/v1/devices/{device}/samples", json={"samples": samples}, **more)


def test_frames_add_up_until_they_make_a_profile(service):
    device = make(service)
    wanted = {"scene": service.upload(), "settings": {"device": "office"}}
    refused = service.client.post("/v1/jobs", json=wanted)
    assert (refused.status_code, refused.json()["code"]) == (422, "DeviceNotCalibrated")
    samples = rows(frames(160))
    first = send(service, device, samples[:60]).json()
    assert (first["samples"], first["profile"], first["missing"]["code"]) == (60, None, "SamplesTooFew")
    assert "60 samples are too few" in service.client.post("/v1/jobs", json=wanted).json()["detail"]
    second = send(service, device, samples[60:]).json()
    assert (second["samples"], second["missing"]) == (160, None)
    assert second == service.client.get(f"/v1/devices/{device}").json()
    for key, true in zip(COEFFICIENTS, TRUE):
        assert second["profile"][key] == pytest.approx(true, rel=2e-3)
    assert second["profile"]["fit"]["samples"] == 160
    job = service.client.post("/v1/jobs", json=wanted)
    assert job.status_code == 201, job.text
    shown = service.client.get(f"/v1/jobs/{job.json()['id']}").json()["settings"]
    assert (shown["device"], shown["device_profile"]) == ("office", second["profile"])
    assert not list(service.settings.artifacts.glob("tmp/samples-*"))


def test_an_idempotency_key_holds_while_the_device_gets_more_frames(service):
    device = make(service)
    assert send(service, device, rows(frames(160))).json()["missing"] is None
    wanted, once = {"scene": service.upload(), "settings": {"device": "office"}}, {"idempotency-key": "one"}
    first = service.client.post("/v1/jobs", json=wanted, headers=once)
    noise = lambda rng, ns: rng.exponential(2e5, len(ns))  # noqa: E731
    send(service, device, rows(frames(160, seed=1, noise=noise)))
    again = service.client.post("/v1/jobs", json=wanted, headers=once)
    assert (first.status_code, again.status_code, again.json()["id"]) == (201, 200, first.json()["id"]), again.text


def test_degenerate_frames_are_kept_and_named(service):
    device = make(service)
    samples = frames(150)
    samples[:, 1] = 7_000
    missing = send(service, device, rows(samples)).json()["missing"]
    assert missing["code"] == "SamplesDegenerate" and "no sample varies triangles (they are 7000)" in missing["detail"]
    assert send(service, device, rows(frames(150, seed=1))).json()["profile"] is not None


@pytest.mark.parametrize(
    "samples",
    [[{"calls": 1}], [{**rows(frames(1))[0], "ms": -1}], "many", [3]],
    ids=["missing", "negative", "text", "3"],
)
def test_bad_frames_are_refused_and_not_kept(service, samples):
    device = make(service)
    answer = send(service, device, samples)
    assert (answer.status_code, answer.json()["code"]) == (422, "SamplesInvalid")
    assert service.client.get(f"/v1/devices/{device}").json()["samples"] == 0
    text = json.dumps({"samples": [{**rows(frames(1))[0], "ms": float("nan")}]})
    answer = service.client.post(
        f"/v1/devices/{device}/samples", content=text, headers={"content-type": "application/json"}
    )
    assert (answer.status_code, answer.json()["code"]) == (422, "SamplesInvalid")


def test_more_frames_than_a_device_may_have_are_refused(service, monkeypatch):
    monkeypatch.setattr("farfield.store.devices.MAX_SAMPLES", 150)
    device = make(service)
    assert send(service, device, rows(frames(100))).json()["samples"] == 100
    answer = send(service, device, rows(frames(51)))
    assert (answer.status_code, answer.json()["code"]) == (422, "SamplesInvalid")
    assert service.client.get(f"/v1/devices/{device}").json()["samples"] == 100


def test_frames_that_came_meanwhile_are_fitted_with(service, monkeypatch):
    from farfield_api.routes import devices as route

    device, fit, fitted = make(service), route._fit, []

    async def slow(state, all_frames):
        fitted.append(len(all_frames))
        if len(fitted) == 1:  # while the first is fitted, others come
            assert devices.keep(
                service.engine, service.tenant_id, device, frames(3).tolist(), n_before=0, model=None, refusal=None
            )
        return await fit(state, all_frames)

    from farfield.store import devices

    monkeypatch.setattr(route, "_fit", slow)
    assert send(service, device, rows(frames(20))).json()["samples"] == 23
    assert fitted == [20, 23]


def test_a_fit_that_fails_leaves_nothing_and_can_be_asked_for_again(service, monkeypatch):
    device, command = make(service), service.settings.calibrate_command
    once = {"idempotency-key": "night-17"}
    object.__setattr__(service.settings, "calibrate_command", (command[0], "-c", "raise SystemExit(1)"))
    failed = send(service, device, rows(frames(120)), headers=once)
    assert failed.status_code == 422
    assert service.client.get(f"/v1/devices/{device}").json()["samples"] == 0
    object.__setattr__(service.settings, "calibrate_command", command)
    for _ in range(2):
        assert send(service, device, rows(frames(120)), headers=once).json()["samples"] == 120
    other = send(service, device, rows(frames(12)), headers=once)
    assert (other.status_code, other.json()["code"]) == (409, "IdempotencyConflict")


def test_few_wait_for_a_fit(service, monkeypatch):
    monkeypatch.setattr("farfield_api.routes.devices.MAX_WAITING", 0)
    answer = send(service, make(service), rows(frames(3)))
    assert (answer.status_code, answer.json()["code"], answer.headers["retry-after"]) == (429, "DeviceBusy", "5")


def test_devices_are_listed_in_pages_capped_and_deleted(service, monkeypatch):
    made = [make(service, f"office {i}") for i in range(5)]
    first = service.client.get("/v1/devices?limit=3").json()
    rest = service.client.get("/v1/devices", params={"cursor": first["next"]}).json()
    assert [d["id"] for d in (*first["devices"], *rest["devices"])] == made[::-1]
    assert rest["next"] is None
    assert [d["id"] for d in service.client.get("/v1/devices?name=OFFICE 3").json()["devices"]] == made[3:4]
    monkeypatch.setattr("farfield.store.devices.MAX_DEVICES", 5)
    answer = service.client.post("/v1/devices", json={"name": "one more"})
    assert (answer.status_code, answer.json()["code"]) == (403, "QuotaExceeded")
    send(service, made[0], rows(frames(160)))
    job = service.client.post("/v1/jobs", json={"scene": service.upload(), "settings": {"device": "office 0"}}).json()
    assert service.client.delete(f"/v1/devices/{made[0]}").status_code == 204
    assert service.client.get(f"/v1/devices/{made[0]}").status_code == 404
    assert service.client.get(f"/v1/jobs/{job['id']}").json()["settings"] == job["settings"]
    assert make(service, "one more")


def test_a_device_may_come_with_its_profile(service):
    profile = dict.fromkeys(COEFFICIENTS, 7.0) | {"per_frame_ns": 3}
    device = make(service, profile=profile)
    assert service.client.get(f"/v1/devices/{device}").json()["profile"] == profile | {"fit": None}
    bad = service.client.post("/v1/devices", json={"name": "b", "profile": profile | {"per_call_ns": -1}})
    assert (bad.status_code, bad.json()["code"]) == (422, "SettingsInvalid")
    listed = service.client.get("/v1/devices").json()
    assert [d["name"] for d in listed["devices"]] == ["office"]
    assert {p["name"] for p in listed["presets"]} == set(PROFILES)


def test_names_are_taken_once_a_tenant(service):
    make(service)
    for name in ("office", "phone"):
        answer = service.client.post("/v1/devices", json={"name": name})
        assert (answer.status_code, answer.json()["code"]) == (409, "DeviceExists")
    unknown = service.client.post("/v1/jobs", json={"scene": service.upload(), "settings": {"device": "toaster"}})
    assert (unknown.status_code, unknown.json()["code"], unknown.json()["key"]) == (422, "SettingsInvalid", "device")


def test_another_tenants_device_is_not_there(service):
    device = make(service, profile=dict.fromkeys(COEFFICIENTS, 7.0) | {"per_frame_ns": 3})
    foreign = bearer(service.new_key("read", "submit", tenant="other"))
    assert service.client.get(f"/v1/devices/{device}", headers=foreign).status_code == 404
    assert send(service, device, rows(frames(3)), headers=foreign).status_code == 404
    assert service.client.get("/v1/devices", headers=foreign).json()["devices"] == []
    assert service.client.post("/v1/devices", json={"name": "office"}, headers=foreign).status_code == 201
    assert service.client.get(f"/v1/devices/{device}").json()["samples"] == 0
    scene = service.client.post(
        "/v1/scenes", content=b"{}", headers={**foreign, "content-disposition": 'attachment; filename="a.glb"'}
    ).json()["digest"]
    job = {"scene": scene, "settings": {"device": "office"}}
    assert service.client.post("/v1/jobs", json=job, headers=foreign).json()["code"] == "DeviceNotCalibrated"
