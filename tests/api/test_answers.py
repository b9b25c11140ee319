"""What all answers share: ETags, 304, gzip, pages, filters; and streams that end when they must."""

import asyncio
import gzip

import pytest
from farfield.store import tenants
from farfield_api import streams
from farfield_api.answers import accepts_gzip, etag_of, matches
from farfield_api.routes import events


def test_what_has_not_changed_is_not_sent_again(service):
    job = service.create()
    for path in (
        f"/v1/jobs/{job}",
        "/v1/scenes",
        f"/v1/scenes/{service.upload()}",
        "/v1/devices",
        "/v1/keys",
        "/v1/usage",
    ):
        service.client.post(f"/v1/jobs/{job}/cancel")
        first = service.client.get(path)
        etag = first.headers["etag"]
        assert not etag.startswith("W/")
        again = service.client.get(path, headers={"if-none-match": f'"other", {etag}'})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", etag), path
        assert service.client.get(path, headers={"if-none-match": '"other"'}).content == first.content
    etag = service.client.get("/v1/jobs").headers["etag"]
    service.create(other=1)
    assert service.client.get("/v1/jobs", headers={"if-none-match": etag}).status_code == 200


def test_a_job_is_deleted_only_as_it_was_seen(service):
    job = service.create()
    path = f"/v1/jobs/{job}"
    service.client.post(f"{path}/cancel")
    seen = service.client.get(path).headers["etag"]
    service.client.post(f"{path}/retry")
    service.client.post(f"{path}/cancel")
    assert service.client.delete(path, headers={"if-match": seen}).json()["code"] == "PreconditionFailed"
    now = service.client.get(path).headers["etag"]
    assert service.client.delete(path, headers={"if-match": now}).json()["deleted"]


def raw(service, path, **headers):
    """Return (answer, its bytes as they came)."""
    with service.client.stream("GET", path, headers=headers) as answer:
        return answer, b"".join(answer.iter_raw())


def test_text_is_compressed_where_it_is_asked_for_and_nothing_else(service, worker):
    job = service.create()
    worker()
    path = f"/v1/jobs/{job}"
    plain, content = raw(service, path, **{"accept-encoding": "identity"})
    packed, squeezed = raw(service, path, **{"accept-encoding": "br, gzip;q=0.5"})
    assert "content-encoding" not in plain.headers
    assert packed.headers["content-encoding"] == "gzip"
    assert gzip.decompress(squeezed) == content
    assert len(squeezed) < len(content)
    assert packed.headers["etag"] == plain.headers["etag"][:-1] + '-gzip"'  # another representation
    for answer in (plain, packed):
        assert "accept-encoding" in answer.headers["vary"].lower()
        again = service.client.get(path, headers={"if-none-match": answer.headers["etag"]})
        assert again.status_code == 304
        assert again.headers["etag"] == answer.headers["etag"]
    for other in (f"/v1/placements/{job}/pages/p.bin", f"/v1/placements/{job}/scene.glb", f"/v1/jobs/{job}/events",
                  "/v1/session", f"/v1/scenes/{service.upload()}/picture"):  # fmt: skip
        answer, _ = raw(service, other, **{"accept-encoding": "gzip"})
        assert answer.status_code == 200, other
        assert "content-encoding" not in answer.headers, other
    ranged, part = raw(service, f"/v1/placements/{job}/manifest.json", range="bytes=0-3", **{"accept-encoding": "gzip"})
    assert (ranged.status_code, len(part)) == (206, 4)
    assert "content-encoding" not in ranged.headers
    for odd in ("bytes=" + "9" * 5000 + "-", "bytes=0-" + "9" * 5000, "bytes=-" + "9" * 5000):  # more than int() reads
        for file in (path, "/open"):
            assert raw(service, file, range=odd)[0].status_code in (200, 206, 400, 416)


@pytest.mark.parametrize(
    "header, wanted",
    [("gzip", True), ("", False), ("identity", False), ("gzip;q=0", False), ("*", True), ("*;q=0", False), ("br, GZIP", True),
     ("gzip;q=0.001", True), ("gzip;q=nonsense", False), ("*;q=1, gzip;q=0", False)],
)  # fmt: skip
def test_who_takes_gzip(header, wanted):
    assert accepts_gzip(header) is wanted


def test_an_etag_is_compared_whole():
    etag = etag_of(b"a")
    assert matches(etag, etag)
    assert matches(f'"x",W/{etag}', etag)
    assert matches("*", etag)
    assert not matches(etag[:-2] + '"', etag)
    assert not matches("", etag)


def test_jobs_are_found_by_what_they_are(service, worker):
    first, second = service.upload(n=1), service.upload(n=2)

    def make(scene, name):
        return service.client.post("/v1/jobs", json={"scene": scene, "name": name}).json()

    done = make(first, "Harbour 100%_a")
    worker()
    others = [make(second, f"town {i}") for i in range(3)]

    def found(**query):
        return [j["id"] for j in service.client.get("/v1/jobs", params=query).json()["jobs"]]

    newest = [j["id"] for j in others[::-1]]
    assert found(scene=first) == [done["id"]]
    assert found(scene=second) == newest
    assert found(verdict="valid") == [done["id"]]
    assert found(name="TOWN") == newest
    assert found(name="%_a") == [done["id"]]  # the letters that it says, no pattern
    assert found(name="_own") == []
    assert found(created_after=others[0]["created_at"], created_before=others[2]["created_at"]) in (
        newest[1:], newest[1:2], newest
    )  # fmt: skip
    assert found(created_before=done["created_at"]) == []
    assert found(name="town", state="queued", limit=2) == newest[:2]


def test_scenes_are_listed_in_pages_and_deleted_after_their_jobs(service):
    digests = [service.upload(f"level {i}.glb", n=i) for i in range(5)]
    first = service.client.get("/v1/scenes?limit=3").json()
    rest = service.client.get("/v1/scenes", params={"cursor": first["next"]}).json()
    assert [s["digest"] for s in (*first["scenes"], *rest["scenes"])] == digests[::-1]
    assert [s["digest"] for s in service.client.get("/v1/scenes?name=EL 3").json()["scenes"]] == digests[3:4]
    job = service.client.post("/v1/jobs", json={"scene": digests[0]}).json()["id"]
    path = f"/v1/scenes/{digests[0]}"
    assert service.client.delete(path, params={"dry_run": True}).json()["jobs"] == 1
    refused = service.client.delete(path)
    assert (refused.status_code, refused.json()["code"]) == (409, "SceneInUse")
    service.client.post(f"/v1/jobs/{job}/cancel")
    service.client.delete(f"/v1/jobs/{job}")
    said = service.client.delete(path, params={"dry_run": True}).json()
    assert service.client.delete(path).json() == {**said, "deleted": True}
    assert service.client.get(path).status_code == 404


@pytest.mark.parametrize("cursor", ["bad", "W10", "WzFd", "bnVsbA", "WyJhIiwiYiJd", "W05hTiwiYSJd", "WzFlOTk5LCJhIl0", "é",
                                    "WzEsIlx1MDAwMCJd", "WzEsIlx1ZDgwMCJd", "W3RydWUsImEiXQ", "W1tbW1tb"])  # fmt: skip
def test_a_cursor_that_is_none_of_ours_is_refused_by_name(service, cursor):
    for path in ("/v1/jobs", "/v1/scenes", "/v1/devices", "/v1/keys", "/v1/webhooks", "/v1/placements"):
        answer = service.client.get(path, params={"cursor": cursor})
        assert (answer.status_code, answer.json()["code"]) == (422, "CursorInvalid"), path


def test_events_are_read_by_kind(service, worker):
    job = service.create()
    worker()
    page = service.client.get(f"/v1/jobs/{job}/events?kind=job", headers={"accept": "application/json"}).json()
    assert [e["data"]["state"] for e in page["events"]] == ["queued", "running", "done"]
    stream = service.client.get(f"/v1/jobs/{job}/events?kind=job").text
    assert stream.count("event: job") == 3
    assert "event: shard" not in stream


def test_a_stream_ends_with_its_key(service, monkeypatch):
    monkeypatch.setattr(events, "CHECK_S", 0.0)
    monkeypatch.setattr("farfield_api.streams.KEEP_ALIVE_S", 0.05)
    key, job = service.new_key("read"), service.create()
    with service.client.stream("GET", f"/v1/jobs/{job}/events", headers={"authorization": f"Bearer {key}"}) as stream:
        lines = stream.iter_lines()
        while next(lines) != ": ping":  # still open though nothing happens
            pass
        tenants.revoke_key(service.engine, key.split("_")[1])
        assert "event: job" not in list(lines)  # it ends, and not with the job
    assert service.client.get(f"/v1/jobs/{job}").json()["state"] == "queued"


def test_a_key_has_only_so_many_streams_open(service, worker, monkeypatch):
    job = service.create()
    worker()
    path, other = f"/v1/jobs/{job}/events", {"authorization": f"Bearer {service.new_key('read')}"}
    poller, key_id = service.client.app.state.farfield.poller, service.key.split("_")[1]
    monkeypatch.setattr(streams, "MOST_OF_A_KEY", 1)
    with poller.counted(key_id):
        answer = service.client.get(path)
        assert (answer.status_code, answer.json()["code"]) == (429, "StreamsTooMany")
        assert service.client.get(path, headers={"accept": "application/json"}).status_code == 200
        assert service.client.get(path, headers=other).status_code == 200
    assert [service.client.get(path).status_code for _ in range(3)] == [200] * 3  # each ends, and is counted off


def test_a_reader_that_takes_nothing_is_left_alone(monkeypatch):
    monkeypatch.setattr(events, "STALL_S", 0.05)
    made = []

    async def frames():
        while True:
            made.append(1)
            yield b"data: x\n\n"

    async def never(message):
        await asyncio.Event().wait()

    async def nothing():
        await asyncio.Event().wait()

    scope = {"type": "http", "method": "GET", "path": "/", "headers": [], "asgi": {"spec_version": "2.4"}}
    asyncio.run(asyncio.wait_for(events.Followed(frames())(scope, nothing, never), 60.0))
    assert len(made) <= 1  # and nothing was gathered for it
