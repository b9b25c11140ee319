"""The Python client against the API: each call once, refusals by name, damage noticed."""

import hashlib
import json

import httpx
import pytest
from farfield.client import Client, Refused, file_digest
from farfield.errors import ColumnsAltered, ServiceError


@pytest.fixture
def client(service):
    return Client("http://127.0.0.1", service.key, http=service.client)


@pytest.fixture
def toy(tmp_path):
    path = tmp_path / "töy level.glb"
    path.write_text("{}")
    return path


def test_a_scene_is_sent_once_and_a_job_started_once(client, toy, worker):
    sent = []
    told = client.send_scene(toy, sent=sent.append)
    assert told["digest"] == file_digest(toy)
    assert client.send_scene(toy, sent=sent.append)["digest"] == told["digest"]
    assert sent == [2]
    jobs = [client.create_job(told["digest"], {"seed": 1}, idempotency_key="one", name="town") for _ in range(2)]
    assert jobs[0]["id"] == jobs[1]["id"]
    worker()
    heard = list(client.events(jobs[0]["id"]))
    assert heard[-1][1]["verdict"] == "valid"
    assert [e["kind"] for e in client.past_events(jobs[0]["id"])] == [kind for kind, _ in heard]
    assert list(client.events(jobs[0]["id"], after=len(heard))) == []
    assert client.report(jobs[0]["id"])["verdict"] == "valid"
    assert "/open#" in client.login_url("/jobs")


def test_all_pages_of_jobs_are_read(client, toy, monkeypatch):
    monkeypatch.setattr("farfield.client.PAGE", 3)
    digest = client.send_scene(toy)["digest"]
    made = [client.create_job(digest, {}, idempotency_key=f"{i}")["id"] for i in range(7)]
    assert [job["id"] for job in client.jobs()] == made[::-1]
    assert client.cancel(made[0])["state"] == "cancelled"
    assert [job["id"] for job in client.jobs(state="cancelled")] == made[:1]
    assert [client.retry(made[0])["state"] for _ in range(2)] == ["queued", "queued"]
    with pytest.raises(Refused) as refused:
        client.retry("0" * 32)
    assert refused.value.code == "JobNotFound"


def test_a_refusal_keeps_the_name_that_the_service_gave(client):
    with pytest.raises(Refused) as refused:
        client.create_job("0" * 64, {}, idempotency_key="none")
    assert refused.value.code == "SceneNotFound"
    assert refused.value.advice
    with pytest.raises(Refused) as refused:
        Client("http://127.0.0.1", "ff_no_key", http=client._http).knows_scene("0" * 64)
    assert refused.value.code == "KeyUnknown"


def placement(damage=()):
    """A service that has one placement; the files in `damage` come altered."""
    files = {"index-1.ffc": b"index", "chunks/a.ffc": b"chunk", "pages/p.webp": b"page", "scene.glb": b"glTF"}

    def told(name):
        return {"file": name, "sha256": hashlib.sha256(files[name]).hexdigest()}

    manifest = {
        "index": told("index-1.ffc"), "chunks": [told("chunks/a.ffc")], "pages": [told("pages/p.webp")],
        "scene": told("scene.glb"),
    }  # fmt: skip
    files |= {"manifest.json": json.dumps(manifest).encode(), "report.json": b"{}"}

    def answer(request):
        name = request.url.path.removeprefix("/v1/placements/job/")
        asked.append(name)
        return httpx.Response(200, content=files[name] + (b"!" if name in damage else b""))

    asked: list[str] = []
    return Client("http://127.0.0.1", "key", http=httpx.Client(transport=httpx.MockTransport(answer),
                                                               base_url="http://127.0.0.1")), asked  # fmt: skip


def test_fetch_goes_on_where_it_stopped_and_writes_the_manifest_last(tmp_path):
    broken, _ = placement(damage={"pages/p.webp"})
    with pytest.raises(ColumnsAltered, match=r"pages/p\.webp"):
        broken.fetch("job", tmp_path)
    assert not (tmp_path / "placement" / "manifest.json").exists()
    whole, asked = placement()
    steps = []
    assert whole.fetch("job", tmp_path, sent=steps.append) == 3
    assert asked == ["manifest.json", "pages/p.webp", "report.json"]
    assert sum(steps) == 6
    assert (tmp_path / "placement" / "pages" / "p.webp").read_bytes() == b"page"
    assert (tmp_path / "scene.glb").read_bytes() == b"glTF"


def test_a_folder_that_held_another_job_has_no_manifest_until_all_is_there(tmp_path):
    (tmp_path / "placement").mkdir()
    (tmp_path / "placement" / "manifest.json").write_text("{}")
    broken, _ = placement(damage={"pages/p.webp"})
    with pytest.raises(ColumnsAltered):
        broken.fetch("job", tmp_path)
    assert not (tmp_path / "placement" / "manifest.json").exists()


def test_a_manifest_cannot_name_a_file_outside(tmp_path):
    client, _ = placement()
    read = client.files
    client.files = lambda job: (b"{}", {"../evil": None, **read(job)[1]})
    with pytest.raises(ColumnsAltered, match="outside"):
        client.fetch("job", tmp_path)


def test_a_service_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setattr("time.sleep", lambda s: None)

    def refuse(request):
        raise httpx.ConnectError("refused")

    http = httpx.Client(transport=httpx.MockTransport(refuse), base_url="http://127.0.0.1")
    with pytest.raises(ServiceError, match="does not answer"):
        Client("http://127.0.0.1", "key", http=http).job("any")


class Cut:
    """A client whose line breaks, and whose service forgets, as the test says."""

    def __init__(self, client, cuts):
        self.client, self.cuts, self.patches = client, list(cuts), []

    def request(self, method, path, **more):
        if method == "PATCH":
            at, content = int(more["headers"]["upload-offset"]), b"".join(more.pop("content"))
            self.patches.append((at, len(content)))
            kept = self.cuts.pop(0) if self.cuts else len(content)
            if kept == "gone":
                self.client.delete(path, headers={"tus-resumable": "1.0.0"})
                raise httpx.WriteError("cut")
            more["headers"]["content-length"] = str(len(content[:kept]))
            answer = self.client.request(method, path, content=content[:kept], **more)
            if kept < len(content):
                raise httpx.WriteError("cut")
            return answer
        return self.client.request(method, path, **more)

    def __getattr__(self, name):
        return getattr(self.client, name)


def test_an_upload_goes_on_where_the_line_broke(service, tmp_path, monkeypatch):
    monkeypatch.setattr("time.sleep", lambda s: None)
    monkeypatch.setattr("farfield.sending.PIECE_BYTES", 40_000)
    path, sent = tmp_path / "level.glb", []
    path.write_text(json.dumps({"padding": "x" * 90_000}))
    cut = Cut(service.client, cuts=[30_000, 0, 40_000, "gone"])
    told = Client("http://127.0.0.1", service.key, http=cut).send_scene(path, sent=sent.append)
    n = path.stat().st_size
    assert (told["digest"], told["bytes"], sum(sent)) == (file_digest(path), n, n)
    starts = [at for at, _ in cut.patches]
    assert starts == [0, 30_000, 30_000, 70_000, 0, 40_000, 80_000]
    assert min(sent) == -n  # the service forgot: told, too


def test_an_upload_that_a_killed_client_began_is_found_by_its_digest(service, tmp_path):
    path, sent = tmp_path / "level.glb", []
    path.write_text(json.dumps({"padding": "y" * 50_000}))
    data = path.read_bytes()
    from farfield.sending import _started

    client = Client("http://127.0.0.1", service.key, http=service.client)
    from farfield.client import _Sender

    where = _started(_Sender(client), path.name, file_digest(path), len(data))
    head = {"tus-resumable": "1.0.0", "content-type": "application/offset+octet-stream", "upload-offset": "0"}
    assert service.client.patch(where, content=data[:20_000], headers=head).status_code == 204
    assert client.send_scene(path, sent=sent.append)["digest"] == file_digest(path)
    assert sent == [20_000, len(data) - 20_000]
    refused = tmp_path / "bad.glb"
    refused.write_text("no json")
    with pytest.raises(Refused, match=r"bad\.glb is not a scene"):
        client.send_scene(refused)


def test_a_pipeline_finds_deletes_and_is_told(client, service, toy, worker):
    scene = client.send_scene(toy)["digest"]
    hook = client.create_webhook("https://8.8.8.8/", name="pipeline")
    assert hook["secret"].startswith("whsec_")
    job = client.create_job(scene, {}, idempotency_key="one", name="harbour", webhook=hook["id"])
    worker()
    assert client.wait(job["id"])["verdict"] == "valid"
    assert [j["id"] for j in client.jobs(scene=scene, verdict="valid", name="harb")] == [job["id"]]
    assert list(client.jobs(name="town")) == []
    assert [s["digest"] for s in client.scenes(name="level")] == [scene]
    assert client.curve(job["id"])["budget"] == "16 ms"
    assert client.usage()["jobs"] == 1
    said = client.delete(job["id"], dry_run=True)
    assert client.delete(job["id"]) == {**said, "deleted": True}
    assert client.delete_scene(scene, dry_run=True)["deleted"] is False
    assert client.delete_scene(scene)["deleted"] is True
    assert [w["id"] for w in client.webhooks()] == [hook["id"]]
    client.delete_webhook(hook["id"])
    assert list(client.webhooks()) == []
    with pytest.raises(Refused, match="no webhook"):
        client.delete_webhook(hook["id"])


def test_who_asks_too_often_waits_as_long_as_it_is_told(monkeypatch):
    waited = []
    monkeypatch.setattr("time.sleep", waited.append)
    answers = [
        httpx.Response(429, headers={"retry-after": "7"}, json={"code": "RateLimited"}),
        httpx.Response(200, json={}),
    ]
    http = httpx.Client(transport=httpx.MockTransport(lambda request: answers.pop(0)), base_url="http://127.0.0.1")
    assert Client("http://127.0.0.1", "key", http=http).usage() == {}
    assert waited == [7]
