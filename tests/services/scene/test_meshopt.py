"""Compressed buffer views: what the encoder packed comes out again, and what is damaged is refused by name."""

import numpy as np
import pytest
from farfield.errors import FarfieldError, SceneIndexOutOfRange, SceneOverLimit, SceneUnreadable
from farfield.scene.meshopt import view_bytes
from farfield.scene.read import read_scene
from farfield.settings import Settings
from levels import BOX_CORNERS, BOX_FACES, Gltf

almeshopt = pytest.importorskip("almeshopt")
NAME = "EXT_meshopt_compression"


def packed(data, count, stride, **more):
    view = {"buffer": 1, "byteLength": count * stride}
    view["extensions"] = {NAME: {"buffer": 0, "byteLength": len(data), "byteStride": stride, "count": count, **more}}
    return view


def unpacked(data, count, stride, **more):
    return view_bytes(packed(data, count, stride, **more), lambda _: data, 1 << 20, "it")


def compressed_box():
    """The box of `levels`, its positions as normalized shorts, everything packed as gltfpack does."""
    level = Gltf()
    level.document["extensionsRequired"] = level.document["extensionsUsed"] = [NAME, "KHR_mesh_quantization"]
    shorts = np.zeros((8, 4), np.uint16)
    shorts[:, :3] = BOX_CORNERS * 65535
    vertices = almeshopt.encode_vertex_buffer(shorts, 2, 0)
    triangles = almeshopt.encode_index_buffer(BOX_FACES.reshape(-1).astype(np.uint32), 8)
    for data, count, stride, more in (
        (vertices, 8, 8, {"mode": "ATTRIBUTES"}),
        (triangles, 36, 2, {"mode": "TRIANGLES"}),
    ):
        view = packed(data, count, stride, byteOffset=len(level.body), **more)
        level.body += data + bytes(-len(data) % 4)
        level.add("bufferViews", view | ({"byteStride": 8} if stride == 8 else {}))
    fallback = {"byteLength": 136, "extensions": {NAME: {"fallback": True}}}
    level.document["buffers"] = [{"byteLength": len(level.body)}, fallback]
    accessor = {"bufferView": 0, "componentType": 5123, "normalized": True, "type": "VEC3", "count": 8}
    position = level.add("accessors", accessor)
    index = level.add("accessors", {"bufferView": 1, "componentType": 5123, "type": "SCALAR", "count": 36})
    level.node(name="box", mesh=level.mesh({"attributes": {"POSITION": position}, "indices": index}))
    return level


def test_a_compressed_level_is_the_level(tmp_path):
    (tmp_path / "a.glb").write_bytes(compressed_box().glb())
    s = read_scene(tmp_path / "a.glb", settings=Settings())
    np.testing.assert_array_equal(s.object_box[0] + s.origin_m, [[0, 0, 0], [1, 1, 1]])
    corner = s.position[s.index].astype(np.float64)
    volume = (corner[:, 0] * np.cross(corner[:, 1], corner[:, 2])).sum() / 6
    assert volume == pytest.approx(1)


def test_every_truncation_and_many_alterations_are_refused_or_read(tmp_path):
    rng = np.random.default_rng(0)
    rows = rng.integers(0, 2**16, (70, 4)).astype(np.uint16)
    data = almeshopt.encode_vertex_buffer(rows, 2, 0)
    assert unpacked(data, 70, 8, mode="ATTRIBUTES") == rows.tobytes()
    for n in range(len(data)):
        with pytest.raises(FarfieldError):
            unpacked(data[:n], 70, 8, mode="ATTRIBUTES")
    faces = rng.integers(0, 50, 90).astype(np.uint32)
    data = almeshopt.encode_index_buffer(faces, 50)
    found = np.frombuffer(unpacked(data, 90, 4, mode="TRIANGLES"), "<u4").reshape(-1, 3)
    for a, b in zip(found, faces.reshape(-1, 3), strict=True):  # the codec turns triangles, keeping their winding
        assert any((np.roll(a, k) == b).all() for k in range(3))
    for n in range(len(data)):
        with pytest.raises(FarfieldError):
            unpacked(data[:n], 90, 4, mode="TRIANGLES")
    for _ in range(300):
        bad = bytearray(data)
        bad[rng.integers(len(bad))] ^= 1 << rng.integers(8)
        try:
            assert len(unpacked(bytes(bad), 90, 4, mode="TRIANGLES")) == 360
        except SceneUnreadable:
            pass


def sequence(index):
    """Encode as the specification writes it, with the nearer of the two bases."""
    out, last = bytearray(b"\xd1"), [0, 0]
    for i in index:
        base = int(abs(i - last[1]) < abs(i - last[0]))
        d = i - last[base]
        value = (((d << 1) ^ (d >> 63)) << 1) | base
        last[base] = i
        while value > 127:
            out.append(value & 127 | 128)
            value >>= 7
        out.append(value)
    return bytes(out) + bytes(4)


def test_a_sequence_of_indices():
    rng = np.random.default_rng(1)
    index = [0, 1, 2, 100000, 3, 100001, *rng.integers(0, 2**20, 200).tolist()]
    data = sequence(index)
    assert np.frombuffer(unpacked(data, len(index), 4, mode="INDICES"), "<u4").tolist() == index
    for bad in (data[:-1], data[:40], b"\xe1" + data[1:], b"\xd1" + b"\xff" * len(data)):
        with pytest.raises(SceneUnreadable):
            unpacked(bad, len(index), 4, mode="INDICES")
    with pytest.raises(SceneUnreadable, match="2 bytes"):
        unpacked(data, len(index), 2, mode="INDICES")


def attributes(rows, kind):
    rows = np.ascontiguousarray(rows)
    data = almeshopt.encode_vertex_buffer(rows, 2, 0)
    return unpacked(data, len(rows), rows.shape[1] * rows.itemsize, mode="ATTRIBUTES", filter=kind)


def test_octahedral_normals_are_unit_vectors_where_they_were():
    rng = np.random.default_rng(2)
    n = rng.normal(size=(400, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    p = n / np.abs(n).sum(1, keepdims=True)
    folded = np.where(p[:, 2:] < 0, (1 - np.abs(p[:, 1::-1])) * np.where(p[:, :2] >= 0, 1, -1), p[:, :2])
    for dtype, error in ((np.int8, 0.02), (np.int16, 1e-4)):
        one = np.iinfo(dtype).max
        rows = np.concatenate([np.rint(folded * one), np.full((400, 1), one), np.full((400, 1), 5)], 1).astype(dtype)
        found = np.frombuffer(attributes(rows, "OCTAHEDRAL"), dtype).reshape(-1, 4)
        assert (found[:, 3] == 5).all()
        assert np.abs(found[:, :3] / one - n).max() < error


def test_quaternions_and_exponents():
    rng = np.random.default_rng(3)
    q = rng.normal(size=(300, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    largest = np.abs(q).argmax(1)
    q *= np.sign(q[np.arange(300), largest])[:, None]
    one = 2047
    rest = np.stack([q[np.arange(300), (largest + k) % 4] for k in (1, 2, 3)], 1)
    rows = np.concatenate([np.rint(rest * np.sqrt(2) * one), (one & ~3 | largest)[:, None]], 1).astype(np.int16)
    found = np.frombuffer(attributes(rows, "QUATERNION"), np.int16).reshape(-1, 4) / 32767
    assert np.abs(found - q).max() < 2e-3
    mantissa, exponent = rng.integers(-(2**23), 2**23, 300), rng.integers(-90, 90, 300)
    stored = ((exponent.astype(np.int64) << 24) | (mantissa & 0xFFFFFF)).astype(np.uint32).reshape(-1, 3)
    found = np.frombuffer(attributes(stored, "EXPONENTIAL"), np.float32)
    np.testing.assert_array_equal(found, np.ldexp(mantissa.astype(np.float64), exponent).astype(np.float32))


@pytest.mark.parametrize(
    "more",
    [
        {"mode": "ATTRIBUTES", "byteStride": 6}, {"mode": "ATTRIBUTES", "byteStride": 0}, {"mode": "SOMETHING"},
        {"mode": "ATTRIBUTES", "filter": "COLOUR"}, {"mode": "TRIANGLES", "filter": "EXPONENTIAL"}, {"count": 7},
        {"mode": "ATTRIBUTES", "byteLength": 10**9}, {"mode": "TRIANGLES"}, {"count": 10**12, "mode": "ATTRIBUTES"},
    ],
)  # fmt: skip
def test_what_does_not_add_up_is_refused(more):
    data = almeshopt.encode_vertex_buffer(np.zeros((8, 4), np.uint16), 2, 0)
    view = packed(data, 8, 8, mode="ATTRIBUTES")
    view["extensions"][NAME] |= more
    row = view["extensions"][NAME]
    if "byteStride" in more or "count" in more:
        view["byteLength"] = row["count"] * row["byteStride"] + (1 if more.get("count") == 7 else 0)
    with pytest.raises(SceneOverLimit if more.get("count") == 10**12 else (SceneUnreadable, SceneIndexOutOfRange)):
        view_bytes(view, lambda _: data, 1 << 20, "it")
