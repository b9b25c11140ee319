"""Hostile files: whatever the bytes, reading ends with a Scene or a named error."""

import json

import numpy as np
import pytest
from farfield.errors import FarfieldError
from farfield.scene.limits import Limits
from farfield.scene.model import Scene
from farfield.scene.read import read_scene
from farfield.settings import Settings
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from levels import box_level, pack_glb

SMALL = Limits(bytes=2**22, triangles=10_000, vertices=30_000, nodes=1000, image_pixels=2**16, texture_pixels=2**18)


def read_or_refuse(path, data):
    path.write_bytes(data)
    try:
        scene = read_scene(path, settings=Settings(), limits=SMALL)
    except FarfieldError:
        return None
    assert isinstance(scene, Scene)
    assert np.isfinite(scene.object_box).all()
    assert scene.index.min() >= 0
    assert scene.index.max() < len(scene.position)
    return scene


def test_every_truncation_is_refused(tmp_path):
    data = box_level().glb()
    for n in range(0, len(data), 7):
        assert read_or_refuse(tmp_path / "a.glb", data[:n]) is None


@pytest.mark.parametrize("seed", range(60))
def test_flipped_bytes(tmp_path, seed):
    rng = np.random.default_rng(seed)
    data = bytearray(box_level().glb())
    for at in rng.integers(12, len(data), int(rng.integers(1, 12))):
        data[at] = rng.integers(256)
    read_or_refuse(tmp_path / "a.glb", bytes(data))


_VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(allow_nan=False), st.text(max_size=8),
    st.sampled_from([-1, 0, 1, 2, 3, 2**31, 2**63, 1e308, "MASK", "../a", "http://a/b", [], {}, [1], [[]], [{}]]),
)  # fmt: skip


def _spots(value, path=()):
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield from _spots(inner, (*path, key))


@settings(max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_value_anywhere_in_the_json(tmp_path, data):
    level = box_level()
    document = json.loads(json.dumps(level.document))
    document["buffers"] = [{"byteLength": len(level.body)}]
    for _ in range(data.draw(st.integers(1, 3))):
        spot = data.draw(st.sampled_from([s for s in _spots(document) if s]))
        target = document
        for key in spot[:-1]:
            target = target[key]
        if data.draw(st.booleans()):
            target[spot[-1]] = data.draw(_VALUES)
        elif isinstance(target, dict):
            del target[spot[-1]]
    read_or_refuse(tmp_path / "a.glb", pack_glb(json.dumps(document).encode(), bytes(level.body)))


_KEYS = ["v", "vn", "vt", "f", "o", "g", "usemtl", "mtllib", "l", "p", "#", "\\\n", "\t", "\n", "\n", "\n"]
_NUMBERS = ["0", "1", "2", "3", "-1", "-2", "4", "1/1", "1//1", "1/1/1", "//", "nan", "inf", "1e400", "x", "a.mtl"]
_OBJ_WORDS = st.sampled_from(_KEYS + _NUMBERS)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(words=st.lists(_OBJ_WORDS, max_size=60))
def test_any_words_of_an_obj(tmp_path, words):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nf 1 2 3\n" + " ".join(words)
    read_or_refuse(tmp_path / "a.obj", text.encode())


_PLY = (
    "ply\nformat {} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
)


@pytest.mark.parametrize("seed", range(40))
def test_flipped_bytes_of_ply_and_stl(tmp_path, seed):
    rng = np.random.default_rng(seed)
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], dtype="<f4")
    face = b"\3" + np.arange(3, dtype="<i4").tobytes()
    ply = bytearray(_PLY.format("binary_little_endian").encode() + corner.tobytes() + face)
    text = bytearray((_PLY.format("ascii") + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n").encode())
    stl = bytearray(bytes(80) + (1).to_bytes(4, "little") + bytes(12) + corner.tobytes() + bytes(2))
    for name, data in (("a.ply", ply), ("a.ply", text), ("a.stl", stl)):
        assert read_or_refuse(tmp_path / name, bytes(data)) is not None
        for at in rng.integers(0, len(data), 3):
            data[at] = rng.integers(256)
        read_or_refuse(tmp_path / name, bytes(data))


def test_a_broken_header_ends(tmp_path):
    assert read_or_refuse(tmp_path / "a.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n") is None
