import io
import struct
import zipfile

import numpy as np
import pytest
from farfield.errors import SceneFileMissing, SceneOverLimit, SceneUnreadable, SceneUriRefused
from farfield.scene.files import relative_name
from farfield.scene.limits import Limits
from farfield.scene.read import read_scene
from farfield.settings import Settings
from levels import box_level, png


def zipped(tmp_path, entries, name="a.zip", compression=zipfile.ZIP_DEFLATED):
    path = tmp_path / name
    with zipfile.ZipFile(path, "w", compression) as z:
        for entry, data in entries.items():
            z.writestr(entry, data)
    return path


def read(path, limits=Limits()):  # noqa: B008
    return read_scene(path, settings=Settings(), limits=limits)


def test_a_zip_is_read_like_its_folder(tmp_path):
    level = box_level()
    level.document["images"][0] = {"uri": "../textures/a.png"}
    entries = {"level/scene/a.gltf": level.gltf("b/body.bin"), "level/scene/b/body.bin": bytes(level.body),
               "level/textures/a.png": png(), "__MACOSX/level/scene/._a.gltf": b"junk", "readme.txt": b""}  # fmt: skip
    s = read(zipped(tmp_path, entries, name="upload"))
    whole = tmp_path / "whole.glb"
    whole.write_bytes(box_level().glb())
    np.testing.assert_array_equal(s.position, read(whole).position)
    assert s.texture_data.tobytes() == png()


@pytest.mark.parametrize(
    ("entries", "error"),
    [
        ({"a.txt": b""}, SceneUnreadable),
        ({"a.glb": b"", "b.glb": b""}, SceneUnreadable),
        ({"a.gltf": box_level().gltf("gone.bin")}, SceneFileMissing),
        ({"in/a.gltf": box_level().gltf("../../b.bin"), "b.bin": b""}, SceneUriRefused),
        ({"a.gltf": box_level().gltf("/b.bin"), "b.bin": b""}, SceneUriRefused),
    ],
)
def test_zips_that_are_refused(tmp_path, entries, error):
    with pytest.raises(error):
        read(zipped(tmp_path, entries))


def test_limits_of_a_zip(tmp_path):
    bomb = zipped(tmp_path, {"a.obj": b"v 0 0 0\n" * 1_000_000})
    assert bomb.stat().st_size < 100_000
    with pytest.raises(SceneOverLimit, match="unpacked"):
        read(bomb, Limits(unpacked_bytes=10**6))
    many = zipped(tmp_path, {f"{i}.txt": b"" for i in range(50)})
    with pytest.raises(SceneOverLimit, match="files"):
        read(many, Limits(files=10))


def test_a_zip_that_lies_about_a_size_is_refused(tmp_path):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as z:
        z.writestr("a.obj", b"v 0 0 0\n" * 100_000)
    data = bytearray(out.getvalue())
    for signature, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        at = data.index(signature) + offset
        data[at : at + 4] = struct.pack("<I", 16)
    (tmp_path / "a.zip").write_bytes(data)
    with pytest.raises(SceneUnreadable):
        read(tmp_path / "a.zip")


def test_damaged_zips(tmp_path):
    data = bytearray(zipped(tmp_path, {"a.glb": box_level().glb()}).read_bytes())
    rng = np.random.default_rng(0)
    for _ in range(60):
        changed = data.copy()
        for at in rng.integers(0, len(data), 4):
            changed[at] = rng.integers(256)
        (tmp_path / "b.zip").write_bytes(changed)
        try:
            read(tmp_path / "b.zip")
        except Exception as error:
            assert type(error).__module__ == "farfield.errors", repr(error)  # noqa: PT017


@pytest.mark.parametrize(
    ("uri", "base", "expected"),
    [("a.bin", "", "a.bin"), ("b/../a.bin", "", "a.bin"), ("a%20b.bin", "x", "x/a b.bin"),
     ("m\\t\\a.png", "", "m/t/a.png"), ("../a.bin", "x", "a.bin"), ("./a", "x/y", "x/y/a")],
)  # fmt: skip
def test_relative_names(uri, base, expected):
    assert relative_name(uri, base=base) == expected


@pytest.mark.parametrize(
    "uri", ["", " ", "..", "../a", "/a", "a/../../b", "http://a", "data2:x", "C:a", "a\0b", "%2e%2e/a"]
)
def test_names_that_are_refused(uri):
    with pytest.raises(SceneUriRefused):
        relative_name(uri)


def test_what_is_no_plain_file(tmp_path):
    with pytest.raises(SceneFileMissing):
        read(tmp_path)
    with pytest.raises(SceneFileMissing):
        read(tmp_path / "gone.glb")
    (tmp_path / "a.gltf").write_bytes(box_level().gltf("folder"))
    (tmp_path / "folder").mkdir()
    with pytest.raises(SceneFileMissing):
        read(tmp_path / "a.gltf")


def test_a_scene_may_be_a_link_and_what_it_names_lies_beside_the_file(tmp_path):
    (tmp_path / "store").mkdir()
    level = box_level()
    (tmp_path / "store" / "a.gltf").write_bytes(level.gltf("body.bin"))
    (tmp_path / "store" / "body.bin").write_bytes(bytes(level.body))
    link = tmp_path / "level.gltf"
    link.symlink_to("store/a.gltf")
    assert read(link).n_objects == read(tmp_path / "store" / "a.gltf").n_objects
    broken = tmp_path / "broken.glb"
    broken.symlink_to("none.glb")
    with pytest.raises(SceneFileMissing, match=r"broken\.glb is a symbolic link to nothing"):
        read(broken)


def test_a_thousand_warnings_are_not_said_one_by_one(tmp_path):
    lines = "".join(f"usemtl none{i}\nf 1 2 3\n" for i in range(1000))
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{lines}")
    told = read(tmp_path / "a.obj").warnings
    assert "There are 800 more warnings." in told
    assert len(told) < 210
