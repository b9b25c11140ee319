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


def test_a_late_fit_to_fewer_frames_changes_nothing(service):
    from farfield.store import devices

    device = make(service)
    send(service, device, rows(frames(120)))
    before = service.client.get(f"/v1/devices/{device}").json()
    devices.keep_fit(service.engine, device, n_fitted=119, model=None, refusal={"code": "SamplesTooFew"})
    assert service.client.get(f"/v1/devices/{device}").json() == before


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
