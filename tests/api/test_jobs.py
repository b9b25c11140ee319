"""Jobs over HTTP: once for a key, in pages, followed, cancelled, deleted; and the files they leave."""

import json
import threading

import pytest
from farfield.store import jobs


def _frames(text):
    """Return the events of a stream as (id, kind, data)."""
    found = []
    for block in text.split("\n\n"):
        fields = dict(line.split(": ", 1) for line in block.splitlines() if ": " in line and not line.startswith(":"))
        if "data" in fields:
            found.append((int(fields["id"]), fields["event"], json.loads(fields["data"])))
    return found


def test_a_job_from_submit_to_placement(service, worker):
    digest = service.upload()
    answer = service.client.post(
        "/v1/jobs", json={"scene": digest, "settings": {"budget": "300 calls"}, "name": "town"}
    )
    assert answer.status_code == 201
    job = answer.json()
    assert (job["state"], job["name"], job["budget"], job["progress"]) == ("queued", "town", "300 calls", 0.0)
    assert answer.headers["location"] == job["links"]["self"]
    assert service.client.get(f"/v1/jobs/{job['id']}/report").json()["code"] == "JobNotFinished"
    assert service.client.get(f"/v1/jobs/{job['id']}/curve").json()["code"] == "JobNotFinished"
    assert service.client.get(f"/v1/placements/{job['id']}/manifest.json").json()["code"] == "JobNotFinished"
    worker()
    job = service.client.get(f"/v1/jobs/{job['id']}").json()
    assert (job["state"], job["verdict"], job["progress"]) == ("done", "valid", 1.0)
    stages = {s["name"]: s for s in job["stages"]}
    assert stages["visibility"]["skipped"] == "the toy has nothing to hide"
    assert stages["viewspace"]["shards"]["done"] == 6
    assert service.client.get(job["links"]["report"]).json()["verdict"] == "valid"
    assert service.client.get(job["links"]["placement"]).json()["budget"] == "300 calls"
    listed = service.client.get(f"/v1/jobs/{job['id']}/stages/viewspace/shards").json()["shards"]
    assert [s["kind"] for s in listed] == ["merge", "plan", *["run"] * 6]


def test_an_idempotency_key_makes_one_job(service):
    digest = service.upload()
    key = {"idempotency-key": "build-17"}
    body = {"scene": digest, "settings": {"seed": 3}}
    first, second = (service.client.post("/v1/jobs", json=body, headers=key) for _ in range(2))
    assert (first.status_code, second.status_code) == (201, 200)
    assert first.json()["id"] == second.json()["id"]
    other = service.client.post("/v1/jobs", json={"scene": digest}, headers=key)
    assert (other.status_code, other.json()["code"]) == (409, "IdempotencyConflict")


@pytest.mark.parametrize(
    "body, code, key",
    [
        ({"scene": "0" * 64}, "SceneNotFound", None),
        ({"settings": {"budget": "fast"}}, "SettingsInvalid", "budget"),
        ({"settings": {"camera": {"fov_deg": 500}}}, "SettingsInvalid", "camera.fov_deg"),
        ({"settings": {"nonsense": 1}}, "SettingsInvalid", "nonsense"),
        ({"scene": "short"}, "RequestInvalid", None),
        ({"colour": "red"}, "RequestInvalid", None),
    ],
)
def test_a_bad_request_says_what_is_wrong(service, body, code, key):
    answer = service.client.post("/v1/jobs", json={"scene": service.upload(), **body})
    assert answer.headers["content-type"] == "application/problem+json"
    assert (answer.json()["code"], answer.json().get("key")) == (code, key)
    assert answer.json()["status"] == answer.status_code


def test_the_schema_of_the_settings_is_the_dataclass(service):
    parts = service.client.get("/v1/openapi.json").json()["components"]["schemas"]
    assert parts["Settings"]["properties"]["budget"]["default"] == "16 ms"
    assert "Problem" in parts


def test_pages_of_jobs_hold_each_once(service):
    digest = service.upload()
    made = [service.client.post("/v1/jobs", json={"scene": digest}).json()["id"] for _ in range(7)]
    service.client.post(f"/v1/jobs/{made[0]}/cancel")
    seen, cursor = [], None
    while True:
        page = service.client.get("/v1/jobs", params={"limit": 3, **({"cursor": cursor} if cursor else {})}).json()
        seen += [j["id"] for j in page["jobs"]]
        cursor = page["next"]
        if cursor is None:
            break
    assert sorted(seen) == sorted(made)
    assert [j["id"] for j in service.client.get("/v1/jobs?state=cancelled").json()["jobs"]] == made[:1]
    assert service.client.get("/v1/jobs?cursor=bad").json()["code"] == "CursorInvalid"
    assert service.client.get("/v1/jobs?state=odd").json()["code"] == "RequestInvalid"


def test_a_stream_resumes_after_the_last_event_and_ends_with_the_job(service, worker):
    job = service.create()
    worker()
    path = f"/v1/jobs/{job}/events"
    whole = _frames(service.client.get(path).text)
    assert [number for number, _, _ in whole] == list(range(1, len(whole) + 1))
    assert whole[-1][2]["state"] == "done"
    rest = _frames(service.client.get(path, headers={"last-event-id": "5"}).text)
    assert rest == whole[5:]
    assert service.client.get(path, headers={"last-event-id": str(len(whole))}).status_code == 204
    page = service.client.get(path, params={"after": 3, "limit": 4}, headers={"accept": "application/json"}).json()
    assert [e["seq"] for e in page["events"]] == [4, 5, 6, 7]
    assert page["next"] == 7


def test_an_open_stream_hears_what_happens_later(service, worker):
    job = service.create()
    later = threading.Timer(0.3, worker)
    later.start()
    frames = _frames(service.client.get(f"/v1/jobs/{job}/events").text)
    later.join()
    assert frames[0][2]["state"] == "queued"
    assert frames[-1][1] == "job"
    assert frames[-1][2]["verdict"] == "valid"


def test_cancel_and_delete(service):
    job = service.create()
    assert service.client.delete(f"/v1/jobs/{job}").json()["code"] == "JobStillRunning"
    assert service.client.post(f"/v1/jobs/{job}/cancel").json()["state"] == "cancelled"
    assert service.client.post(f"/v1/jobs/{job}/cancel").status_code == 200
    said = service.client.delete(f"/v1/jobs/{job}", params={"dry_run": True}).json()
    assert said["deleted"] is False
    assert service.client.get(f"/v1/jobs/{job}").status_code == 200
    assert service.client.delete(f"/v1/jobs/{job}").json() == {**said, "deleted": True}
    assert service.client.get(f"/v1/jobs/{job}").status_code == 404


def test_a_failed_job_shows_its_error_and_nothing_of_the_machine(service, worker):
    job = service.create(fail="bake")
    worker()
    shown = service.client.get(f"/v1/jobs/{job}")
    assert shown.json()["state"] == "failed"
    assert shown.json()["error"]["stage"] == "bake"
    assert "secret" not in shown.text


def test_the_files_of_a_job_come_in_ranges_and_stay_in_caches(service, worker):
    job = service.create()
    worker()
    path = f"/v1/placements/{job}/pages/p.bin"
    whole = service.client.get(path)
    assert whole.content == bytes(range(256)) * 40
    assert "immutable" in whole.headers["cache-control"]
    etag = whole.headers["etag"]
    assert not etag.startswith("W/")
    part = service.client.get(path, headers={"range": "bytes=256-259"})
    assert (part.status_code, part.content) == (206, bytes(range(4)))
    assert service.client.get(path, headers={"range": "bytes=0-1", "if-range": '"other"'}).status_code == 200
    assert service.client.get(path, headers={"range": "bytes=99999-"}).status_code == 416
    assert service.client.get(path, headers={"if-none-match": etag}).status_code == 304
    assert service.client.head(path).headers["content-length"] == "10240"
    assert service.client.get(f"/v1/placements/{job}/scene.glb").content == b"glTF"
    assert service.client.get(f"/v1/placements/{job}/report.json").json()["verdict"] == "valid"
    again = service.create()
    worker()
    assert service.client.get(f"/v1/placements/{again}/pages/p.bin").headers["etag"] == etag


@pytest.mark.parametrize(
    "path", ["..%2f..%2fsecret.txt", "%2e%2e/%2e%2e/secret.txt", "nothing.bin", "", "%00", "a" * 300, "circle", "out"]
)
def test_no_path_leaves_a_placement(service, worker, path):
    job = service.create()
    worker()
    folder = service.settings.placements["town"] / "placement"
    (folder / "circle").symlink_to("circle")
    (folder / "out").symlink_to(folder.parents[1] / "secret.txt")
    assert service.client.get(f"/{path}").status_code in (200, 404)  # 200: an empty path is the list of jobs
    for name in ("town", job):
        answer = service.client.get(f"/v1/placements/{name}/{path}")
        assert answer.status_code == 404
        assert "not yours" not in answer.text


def test_a_registered_folder_is_served_as_it_lies(service):
    manifest = service.client.get("/v1/placements/town/manifest.json")
    assert manifest.json() == {"version": 1}
    assert "immutable" not in manifest.headers["cache-control"]
    chunk = service.client.get(f"/v1/placements/town/{'0123456789abcdef' * 4}.bin")
    assert "immutable" in chunk.headers["cache-control"]
    (service.settings.placements["town"] / "placement" / "manifest.json").write_text('{"version": 22}')
    changed = service.client.get(
        "/v1/placements/town/manifest.json", headers={"if-none-match": manifest.headers["etag"]}
    )
    assert changed.json() == {"version": 22}
    assert service.client.get("/v1/placements").json()["placements"][0]["id"] == "town"


def test_a_job_is_accepted_while_the_broker_is_away(service):
    job = service.create()
    row = jobs.get(service.engine, service.tenant_id, job)
    assert row.state == "queued"


def test_reading_a_placement_leaves_no_file_and_what_its_deletion_frees_is_collected(service, worker):
    from farfield.store import collect
    from farfield.store.artifacts import LocalArtifacts

    job = service.create()
    worker()
    before = sorted(service.settings.artifacts.rglob("*"))
    assert service.client.get(f"/v1/placements/{job}/manifest.json").status_code == 200
    assert sorted(service.settings.artifacts.rglob("*")) == before
    n_bytes = service.client.delete(f"/v1/jobs/{job}").json()["bytes"]
    found = collect.collect(service.engine, LocalArtifacts(service.settings.artifacts), grace_s=0.0)
    gone = [p for p in before if not p.exists()]
    assert (found.removed, found.removed_bytes) == (len([p for p in gone if len(p.name) == 64]), n_bytes)
    assert gone
    assert service.client.get(f"/v1/placements/{job}/manifest.json").status_code == 404


def test_the_list_of_jobs_shows_what_their_reports_say(service, worker):
    job = service.create()
    (waiting,) = service.client.get("/v1/jobs").json()["jobs"]
    assert [waiting[k] for k in ("bytes", "hopeless_views", "smallest_budget")] == [None, None, None]
    worker()
    report = service.client.get(f"/v1/jobs/{job}/report").json()
    curve = service.client.get(f"/v1/jobs/{job}/curve").json()
    assert curve == {key: report[key] for key in ("budget", "budget_amount", "unit", "bytes", "curve")}
    (done,) = service.client.get("/v1/jobs").json()["jobs"]
    assert (done["bytes"], done["hopeless_views"]) == (report["bytes"], report["hopeless_views"])
    assert done["smallest_budget"] == report["smallest_budget"]["text"]


def test_a_cancelled_stage_grows_no_older(service):
    job = service.create()
    service.client.post(f"/v1/jobs/{job}/cancel")
    first, second = (service.client.get(f"/v1/jobs/{job}").json()["stages"][0]["seconds"] for _ in "12")
    assert first == second


@pytest.mark.parametrize("stage", ["scene", "viewspace"])
def test_a_failed_job_that_is_retried_goes_on_from_what_is_done(service, worker, tmp_path, stage):
    job = service.create(fail=stage, until=str(tmp_path / "mended"))
    path = f"/v1/jobs/{job}"
    assert service.client.post(f"{path}/retry").json()["code"] == "JobNotStopped"
    worker()
    failed = service.client.get(path).json()
    assert (failed["state"], failed["error"]["stage"]) == ("failed", stage)
    finished = {s["name"]: s["seconds"] for s in failed["stages"] if s["state"] in ("done", "skipped")}
    (tmp_path / "mended").touch()
    retried = service.client.post(f"{path}/retry")
    assert (retried.status_code, retried.json()["state"], retried.json()["error"]) == (200, "queued", None)
    assert service.client.post(f"{path}/retry").status_code == 409
    worker()
    done = service.client.get(path).json()
    assert (done["state"], done["verdict"]) == ("done", "valid")
    assert finished.items() <= {s["name"]: s["seconds"] for s in done["stages"]}.items()
    fresh = service.create()
    worker()
    manifests = [service.client.get(f"/v1/placements/{j}/manifest.json").json() for j in (job, fresh)]
    assert manifests[0].keys() == manifests[1].keys()
    assert service.client.post(f"{path}/retry").json()["code"] == "JobNotStopped"


def test_a_cancelled_job_can_be_retried_and_an_old_worker_commits_nothing(service, worker):
    from farfield.store import progress, shards

    job = service.create()
    (first,) = progress.ready(service.engine)
    old = shards.claim(service.engine, first.shard_id, worker="old")
    service.client.post(f"/v1/jobs/{job}/cancel")
    assert service.client.post(f"/v1/jobs/{job}/retry").json()["state"] == "queued"
    assert not shards.renew(service.engine, old)
    late = shards.commit(service.engine, old, digest="0" * 64, n_bytes=1, key=None, seconds=0.1, peak_bytes=1)
    assert late == "lost"
    worker()
    assert service.client.get(f"/v1/jobs/{job}").json()["verdict"] == "valid"
