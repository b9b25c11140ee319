"""Uploads that resume: every byte once, one writer, nothing told to strangers, nothing left behind."""

import asyncio
import hashlib
import json
import os
import time
from base64 import b64encode
from types import SimpleNamespace

import pytest
import sqlalchemy as sa
from farfield.store.engine import write
from farfield.store.quotas import Quota
from farfield.store.tables import upload
from farfield_api import resumable
from farfield_api.body import Body
from farfield_api.errors import UploadCut, UploadStalled

TUS = {"tus-resumable": "1.0.0"}
PIECE = {**TUS, "content-type": "application/offset+octet-stream"}
DATA = json.dumps({"padding": "x" * 90_000}).encode()


def b64(text):
    return b64encode(text if isinstance(text, bytes) else text.encode()).decode()


def start(service, data=DATA, *, name="level ü.glb", sha256=True, **headers):
    told = f"filename {b64(name)}" + (f",sha256 {b64(hashlib.sha256(data).hexdigest())}" if sha256 else "")
    headers = {**TUS, "upload-length": str(len(data)), "upload-metadata": told, **headers}
    return service.client.post("/v1/uploads", headers=headers)


def piece(service, where, offset, data, **headers):
    return service.client.patch(where, content=data, headers={**PIECE, "upload-offset": str(offset), **headers})


def left_over(service):
    uploads = service.settings.artifacts / "uploads"
    return sorted(os.listdir(service.settings.artifacts / "tmp") + (os.listdir(uploads) if uploads.is_dir() else []))


def offset_of(service, where):
    return int(service.client.head(where, headers=TUS).headers["upload-offset"])


def test_pieces_become_the_scene_of_these_bytes(service):
    answer = start(service)
    assert (answer.status_code, answer.headers["tus-resumable"], answer.headers["upload-offset"]) == (201, "1.0.0", "0")
    where = answer.headers["location"]
    for at in range(0, len(DATA), 40_000):
        answer = piece(service, where, at, DATA[at : at + 40_000])
        assert (answer.status_code, answer.content) == (204, b""), answer.text
        assert int(answer.headers["upload-offset"]) == offset_of(service, where) == min(at + 40_000, len(DATA))
    digest = hashlib.sha256(DATA).hexdigest()
    assert answer.headers["content-location"] == f"/v1/scenes/{digest}"
    told = service.client.get(where).json()
    assert (told["state"], told["scene"], told["links"]["scene"]) == ("done", digest, f"/v1/scenes/{digest}")
    scene = service.client.get(f"/v1/scenes/{digest}").json()
    assert (scene["name"], scene["bytes"], scene["objects"]) == ("level ü.glb", len(DATA), 1)
    assert service.client.get(scene["links"]["picture"]).content.startswith(b"\x89PNG")
    assert piece(service, where, len(DATA), b"").status_code == 204  # the answer was lost: asked again, it is the same
    assert left_over(service) == []


def test_creation_may_bring_the_first_bytes(service):
    told = {"upload-length": str(len(DATA)), "upload-metadata": f"filename {b64('a.glb')}"}
    answer = service.client.post("/v1/uploads", content=DATA[:1000], headers={**PIECE, **told})
    assert (answer.status_code, answer.headers["upload-offset"]) == (201, "1000")
    assert piece(service, answer.headers["location"], 1000, DATA[1000:]).status_code == 204


def test_the_protocol_is_told_and_held(service):
    told = service.client.options("/v1/uploads").headers
    assert (told["tus-version"], told["tus-max-size"]) == ("1.0.0", "100000")
    assert {"creation", "checksum", "expiration", "termination"} <= set(told["tus-extension"].split(","))
    where = start(service).headers["location"]
    for answer, status, code in (
        (service.client.patch(where, headers={"content-type": PIECE["content-type"]}), 412, "TusVersionUnknown"),
        (service.client.patch(where, headers={**TUS, "upload-offset": "0"}), 415, "UploadTypeUnknown"),
        (service.client.patch(where, headers=PIECE), 400, "UploadHeaderInvalid"),
        (piece(service, where, 7, b"x"), 409, "UploadOffsetWrong"),
        (piece(service, where, 0, b"x", **{"upload-checksum": "md5 abcd"}), 400, "UploadHeaderInvalid"),
        (start(service, **{"upload-metadata": "filename ä".encode("latin-1")}), 400, "UploadHeaderInvalid"),
        (start(service, **{"upload-length": "100001"}), 413, "UploadTooLarge"),
        (service.client.post("/v1/uploads", headers=TUS), 400, "UploadHeaderInvalid"),
        (piece(service, "/v1/uploads/none", 0, b"x"), 404, "UploadNotFound"),
    ):
        assert (answer.status_code, answer.json()["code"]) == (status, code)
        assert answer.headers["tus-resumable"] == "1.0.0"
    assert offset_of(service, where) == 0


@pytest.mark.parametrize("content", [DATA + b"!", iter([DATA, b"!"])], ids=["announced", "streamed"])
def test_more_bytes_than_announced_are_refused_and_not_kept(service, content):
    where = start(service).headers["location"]
    answer = piece(service, where, 0, content)
    assert (answer.status_code, answer.json()["code"]) == (413, "UploadTooLarge")
    assert offset_of(service, where) == 0
    assert piece(service, where, 0, DATA).status_code == 204


def test_a_checksum_decides_what_is_kept(service):
    where = start(service).headers["location"]
    wrong = piece(service, where, 0, DATA[:500], **{"upload-checksum": f"sha256 {b64(bytes(32))}"})
    assert (wrong.status_code, wrong.json()["code"], offset_of(service, where)) == (460, "UploadChecksumWrong", 0)
    for kind, at in (("sha1", 0), ("sha256", 500)):
        part = DATA[at : at + 500]
        right = piece(
            service, where, at, part, **{"upload-checksum": f"{kind} {b64(hashlib.new(kind, part).digest())}"}
        )
        assert right.status_code == 204
    assert piece(service, where, 1000, DATA[1000:]).status_code == 204


def test_bytes_that_are_not_the_announced_ones_become_no_scene(service):
    where = start(service).headers["location"]
    answer = piece(service, where, 0, DATA[::-1])
    assert (answer.status_code, answer.json()["code"]) == (422, "UploadAltered")
    assert service.client.head(where, headers=TUS).status_code == 410
    told = service.client.get(where).json()
    assert (told["state"], told["problem"]["code"]) == ("refused", "UploadAltered")
    assert piece(service, where, len(DATA), b"").json()["code"] == "UploadAltered"
    assert left_over(service) == []


def test_a_file_that_is_no_scene_is_refused_by_the_readers_name_and_leaves_nothing(service):
    where = start(service, b"no json", name="bad.glb").headers["location"]
    for answer in (piece(service, where, 0, b"no json"), piece(service, where, 7, b"")):
        assert (answer.status_code, answer.json()["code"]) == (422, "SceneUnreadable")
        assert answer.json()["detail"] == "bad.glb is not a scene"
    assert left_over(service) == []


def test_strangers_see_no_upload(service):
    where = start(service).headers["location"]
    digest = hashlib.sha256(DATA).hexdigest()
    found = service.client.get("/v1/uploads", params={"sha256": digest}).json()["uploads"]
    assert [u["links"]["self"] for u in found] == [where]
    strange = {"authorization": f"Bearer {service.new_key('read', 'submit', tenant='other')}"}
    none = service.client.get("/v1/uploads/none", headers=strange).json()
    for answer in (
        service.client.get(where, headers=strange), service.client.delete(where, headers={**TUS, **strange}),
        service.client.patch(where, content=b"x", headers={**PIECE, **strange, "upload-offset": "0"}),
    ):  # fmt: skip
        assert answer.status_code == 404
        told = {**answer.json(), "request_id": none["request_id"]}
        assert told == {**none, "detail": none["detail"].replace("none", where.rsplit("/", 1)[1])}
    assert service.client.head(where, headers={**TUS, **strange}).status_code == 404
    assert service.client.get("/v1/uploads", headers=strange).json() == {"uploads": []}
    reads = {"authorization": f"Bearer {service.new_key('read')}"}
    assert service.client.post("/v1/uploads", headers={**TUS, **reads, "upload-length": "1"}).status_code == 403
    assert service.client.patch(where, headers={**PIECE, "authorization": "Bearer no"}).status_code == 401
    assert offset_of(service, where) == 0
    # That one tenant has sent a scene is nothing that another one can learn: it sends the bytes like anybody.
    assert piece(service, where, 0, DATA).status_code == 204
    assert service.client.head(f"/v1/scenes/{digest}", headers=strange).status_code == 404
    theirs = start(service, **strange).headers["location"]
    assert (
        service.client.patch(theirs, content=DATA, headers={**PIECE, **strange, "upload-offset": "0"}).status_code
        == 204
    )
    assert service.client.head(f"/v1/scenes/{digest}", headers=strange).status_code == 200


def test_an_upload_ends_by_request_and_by_its_time(service):
    gone, late = (start(service).headers["location"] for _ in range(2))
    for where in (gone, late):
        piece(service, where, 0, DATA[:5])
    assert service.client.delete(gone, headers=TUS).status_code == 204
    assert service.client.head(gone, headers=TUS).status_code == 404
    assert len(left_over(service)) == 1
    with write(service.engine) as tx:
        tx.execute(sa.update(upload).values(expires_at=1.0))
    assert piece(service, late, 5, DATA[5:]).status_code == 404
    state = service.client.app.state.farfield
    orphan, fresh = (resumable.folder_of(state) / name for name in ("orphan", "fresh"))
    half = service.settings.artifacts / "tmp" / "upload-half"
    for file, age_s in ((orphan, 4000), (fresh, 10), (half, 90_000)):
        file.write_bytes(b"x")
        os.utime(file, (time.time() - age_s,) * 2)
    assert resumable.sweep(state) == 3
    assert left_over(service) == ["fresh"]


def test_an_upload_given_up_while_it_waits_to_be_read_is_not_found(service, monkeypatch):
    where = start(service).headers["location"]
    state = service.client.app.state.farfield

    async def after_its_end(*_):
        resumable.forget(state, where.rsplit("/", 1)[1])
        return await accept(*_)

    accept = resumable.accept
    monkeypatch.setattr(resumable, "accept", after_its_end)
    assert piece(service, where, 0, DATA).json()["code"] == "UploadNotFound"
    assert left_over(service) == []


def test_only_so_many_may_be_open(service):
    object.__setattr__(service.settings, "open_uploads", 2)
    ours = [start(service) for _ in range(2)]
    assert (start(service).status_code, start(service).json()["code"]) == (429, "UploadsTooMany")
    piece(service, ours[0].headers["location"], 0, DATA)
    assert start(service).status_code == 201


def test_what_exceeds_the_quota_is_refused_before_its_bytes_are_sent(service):
    where = start(service).headers["location"]
    piece(service, where, 0, DATA)
    object.__setattr__(service.settings, "quota", Quota(max_bytes=len(DATA) + 50_000))
    other = DATA.replace(b"x", b"y")
    assert (start(service, other).status_code, start(service, other).json()["code"]) == (403, "QuotaExceeded")
    assert start(service).status_code == 201  # the tenant has it: it costs nothing


def test_bytes_beyond_what_was_synced_are_written_over(service):
    """A power cut may leave anything there."""
    where = start(service).headers["location"]
    piece(service, where, 0, DATA[:1000])
    (file,) = resumable.folder_of(service.client.app.state.farfield).iterdir()
    with file.open("ab") as opened:
        opened.write(b"rubbish" * 20_000)
    assert offset_of(service, where) == 1000
    assert piece(service, where, 1000, DATA[1000:]).status_code == 204
    file.parent.mkdir(exist_ok=True)
    where = start(service, sha256=False).headers["location"]
    piece(service, where, 0, DATA[:1000])
    next(file.parent.iterdir()).unlink()  # another host has the bytes
    assert piece(service, where, 1000, DATA[1000:]).status_code == 409
    assert offset_of(service, where) == 0
    assert piece(service, where, 0, DATA).status_code == 204


@pytest.mark.parametrize("whole", [False, True])
def test_a_full_disk_is_named_and_leaves_no_part(service, monkeypatch, whole):
    where = start(service).headers["location"]

    def full(*_):
        raise OSError(28, "No space left on device", "/secret/path")

    if whole:
        monkeypatch.setattr("farfield_api.upload._write", full)
        answer = service.client.post("/v1/scenes", content=DATA)
    else:
        monkeypatch.setattr(os, "pwrite", full)
        answer = piece(service, where, 0, DATA)
    assert (answer.status_code, answer.json()["code"]) == (507, "StoreFull")
    assert "secret" not in answer.text
    monkeypatch.undo()
    assert sum(f.stat().st_size for f in resumable.folder_of(service.client.app.state.farfield).iterdir()) == 0
    assert os.listdir(service.settings.artifacts / "tmp") == []
    assert piece(service, where, 0, DATA).status_code == 204
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=9))
    assert (start(service).status_code, start(service).json()["code"]) == (507, "StoreFull")


class Line:
    """A request whose body is what the test says: bytes, or seconds of silence."""

    def __init__(self, *steps):
        self.steps, self.headers = list(steps), {}

    async def receive(self):
        step = self.steps.pop(0)
        while isinstance(step, float):
            await asyncio.sleep(step)
            step = self.steps.pop(0)
        if step is None:
            return {"type": "http.disconnect"}
        return {"type": "http.request", "body": step, "more_body": bool(self.steps)}


class Leaping(asyncio.SelectorEventLoop):
    """A loop whose clock goes only while it waits, and then at once: seconds of silence cost none, a busy machine adds none."""

    def __init__(self):
        super().__init__()
        self.now_s, select = 0.0, self._selector.select

        def leap(timeout):
            self.now_s += timeout or 0.0
            return select(0)

        self._selector.select = leap

    def time(self):
        return self.now_s


def heard(line, stall_s, interrupt_after_s=None):
    async def listen():
        body, found = Body(line, stall_s), []
        if interrupt_after_s is not None:
            asyncio.get_running_loop().call_later(interrupt_after_s, body.interrupt)
        try:
            async for part in body.pieces():
                found.append(part)  # noqa: PERF401 (what came before an error counts)
        except (UploadCut, UploadStalled) as error:
            return found, error.code
        return found, None

    with asyncio.Runner(loop_factory=Leaping) as runner:
        return runner.run(listen())


def test_a_body_must_keep_moving():
    assert heard(Line(b"a", 59.0, b"b"), 60.0) == ([b"a", b"b"], None)
    assert heard(Line(b"a", 61.0, b"b"), 60.0) == ([b"a"], "UploadStalled")
    drips = [step for _ in range(40) for step in (6.0, b"x")]
    assert heard(Line(*drips), 60.0)[1] == "UploadStalled"
    flows = [step for _ in range(20) for step in (6.0, bytes(1 << 16))]
    assert heard(Line(*flows), 60.0)[1] is None
    assert heard(Line(b"a", None), 60.0) == ([b"a"], "UploadCut")
    assert heard(Line(b"a", 60.0, b"b"), 60.0, interrupt_after_s=1.0) == ([b"a"], "UploadCut")


def test_a_cut_line_loses_nothing_and_a_second_request_takes_the_place_of_a_dead_one(service):
    where = start(service).headers["location"]
    state = service.client.app.state.farfield
    row = resumable.uploads.get(service.engine, service.tenant_id, where.rsplit("/", 1)[1])

    async def cut_then_taken_over():
        with pytest.raises(UploadCut):
            await resumable.append(Line(DATA[:1000], None), state, row, 0)
        silent = Line(DATA[1000:3000], 600.0, b"")
        dead = asyncio.create_task(resumable.append(silent, state, row, 1000))
        while len(silent.steps) > 1:  # until it waits for more
            await asyncio.sleep(0.01)
        with pytest.raises(Exception, match="3000 have arrived"):
            await resumable.append(Line(DATA[1000:]), state, row, 1000)
        with pytest.raises(UploadCut):
            await dead
        return await resumable.append(Line(DATA[3000:]), state, row, 3000)

    ended = asyncio.run(cut_then_taken_over())
    assert ended.scene_digest == hashlib.sha256(DATA).hexdigest()
    assert left_over(service) == []
