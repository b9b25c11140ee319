"""Uploads: hashed, limited, read before they are accepted."""

import hashlib
import json
import os

import pytest


def _send(service, content, name="toy.glb"):
    return service.client.post(
        "/v1/scenes", content=content, headers={"content-disposition": f'attachment; filename="{name}"'}
    )


def _left_over(service):
    return os.listdir(service.settings.artifacts / "tmp")


def test_an_upload_is_known_by_its_digest(service):
    data = json.dumps({"a": 1}).encode()
    digest = hashlib.sha256(data).hexdigest()
    assert service.client.head(f"/v1/scenes/{digest}").status_code == 404
    first, second = _send(service, data), _send(service, data, "again.glb")
    assert (first.status_code, second.status_code) == (201, 200)
    assert first.json() == second.json()
    assert first.json()["digest"] == digest
    assert first.headers["location"] == f"/v1/scenes/{digest}"
    assert service.client.head(f"/v1/scenes/{digest}").status_code == 200
    found = service.client.get(f"/v1/scenes/{digest}").json()
    assert (found["objects"], found["triangles"], found["name"], found["bytes"]) == (1, 12, "toy.glb", len(data))
    assert service.client.get(f"/v1/scenes/{digest}/objects").json()["objects"] == [{"id": 0}]
    assert _left_over(service) == []


def test_a_form_carries_the_same_bytes(service):
    data = json.dumps({"padding": "x" * 50_000}).encode()
    answer = service.client.post("/v1/scenes", files={"file": ("level ü.glb", data)}, data={"note": "hello"})
    assert answer.status_code == 201, answer.text
    assert answer.json()["digest"] == hashlib.sha256(data).hexdigest()
    assert answer.json()["name"] == "level ü.glb"


def test_the_name_of_a_file_is_never_a_path(service):
    answer = _send(service, b'{"b": 1}', "../../etc/..\\\\toy.glb")
    assert answer.json()["name"] == "toy.glb"


@pytest.mark.parametrize(
    "content", [b"x" * 100_001, iter([b"x" * 60_000, b"x" * 60_000])], ids=["announced", "streamed"]
)
def test_an_upload_over_the_limit_is_refused_by_name(service, content):
    answer = _send(service, content)
    assert (answer.status_code, answer.json()["code"]) == (413, "UploadTooLarge")
    assert _left_over(service) == []


def test_a_scene_that_cannot_be_read_is_refused_under_the_readers_name(service):
    answer = _send(service, b"no json", "bad.glb")
    assert answer.status_code == 422
    told = answer.json()
    assert (told["code"], told["detail"]) == ("SceneUnreadable", "bad.glb is not a scene")
    assert told["advice"]
    assert _left_over(service) == []


def test_a_reader_that_wants_too_much_memory_costs_only_itself(service):
    answer = _send(service, b'{"greedy": true}')
    assert (answer.status_code, answer.json()["code"]) == (422, "SceneOverLimit")


def test_a_reader_that_takes_too_long_is_ended(tmp_path, service):
    object.__setattr__(service.settings, "inspect_seconds", 1)
    answer = _send(service, b'{"slow": 30}')
    assert (answer.status_code, answer.json()["code"]) == (422, "SceneOverLimit")


@pytest.mark.parametrize("name, content, code", [("a.exe", b"MZ", "SceneUnreadable"), ("a.glb", b"", "UploadAltered")])
def test_what_is_no_scene_at_all(service, name, content, code):
    assert _send(service, content, name).json()["code"] == code


def test_a_damaged_form(service):
    kind = {"content-type": "multipart/form-data; boundary=xyz"}
    for body in (b"--xyz\r\nContent-Dispo", b"--xyz--\r\n", b"rubbish"):
        assert service.client.post("/v1/scenes", content=body, headers=kind).json()["code"] == "UploadAltered"
    kind = {"content-type": f"multipart/form-data; boundary={'x' * 300}"}
    assert service.client.post("/v1/scenes", content=b"--", headers=kind).json()["code"] == "UploadAltered"


@pytest.mark.parametrize(
    "name", ["idna''%FFtoy.glb", "unicode_escape''%5Cud800toy.glb", "none''toy.glb", "UTF-8''%FF%00toy.glb"]
)
def test_a_name_in_an_odd_charset_is_no_failure_of_the_service(service, name):
    headers = {"content-disposition": f"attachment; filename*={name}"}
    answer = service.client.post("/v1/scenes", content=b'{"c": "' + name.encode() + b'"}', headers=headers)
    assert answer.status_code < 500, answer.text
