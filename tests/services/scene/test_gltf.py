import base64
import json

import numpy as np
import pytest
from farfield.errors import (
    SceneEmpty,
    SceneFileMissing,
    SceneIndexOutOfRange,
    SceneNotFinite,
    SceneOverLimit,
    SceneUnreadable,
    SceneUriRefused,
)
from farfield.scene.limits import Limits
from farfield.scene.model import MASK
from farfield.scene.read import read_scene
from farfield.settings import SceneSettings, Settings
from levels import BOX_CORNERS, BOX_FACES, Gltf, box_level, png

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
TRIANGLE = SQUARE[:3]
QUAD = np.array([0, 1, 2, 0, 2, 3], dtype=np.uint16)


def read(tmp_path, data, *, name="a.glb", limits=Limits(), **scene):  # noqa: B008
    path = tmp_path / name
    path.write_bytes(data)
    return read_scene(path, settings=Settings(scene=SceneSettings(**scene)), limits=limits)


def one_mesh(*primitives, level, **node):
    level.node(name="it", mesh=level.mesh(*primitives), **node)
    return level


def placed(scene, o):
    """Corner positions (T,3,3) of object o, scene metres."""
    m = scene.object_mesh[o]
    first, last = scene.primitive_triangle[scene.mesh_primitive[[m, m + 1]]]
    corner = scene.position[scene.index[first:last]].astype(np.float64)
    matrix = scene.object_matrix[o]
    return corner @ matrix[:, :3].T + matrix[:, 3] + scene.origin_m


def by_name(scene, name):
    return scene.object_name.index(name)


def triangle_set(corners):
    """Triangles up to rotation of their corners: winding kept."""
    out = set()
    for t in np.round(np.asarray(corners, dtype=np.float64), 5).tolist():
        t = [tuple(c) for c in t]
        k = t.index(min(t))
        out.add((t[k], t[(k + 1) % 3], t[(k + 2) % 3]))
    return out


def test_the_box_level(tmp_path):
    s = read(tmp_path, box_level().glb())
    assert sorted(s.object_name) == ["house", "leaf", "mirror"]
    house, mirror, leaf = (by_name(s, n) for n in ("house", "mirror", "leaf"))
    assert s.object_mesh[house] == s.object_mesh[mirror] != s.object_mesh[leaf]
    assert s.object_triangles.tolist() == [12 if o != leaf else 2 for o in range(3)]
    np.testing.assert_allclose(s.object_box[house] + s.origin_m, [[3, 0, 0], [4, 1, 1]])
    # Mirrored in x, twice as tall, then a quarter turn about y: x -> -z, z -> x.
    np.testing.assert_allclose(s.object_box[mirror] + s.origin_m, [[0, 0, 0], [1, 2, 1]], atol=1e-12)
    assert np.linalg.det(s.object_matrix[mirror][:, :3]) < 0
    k = s.primitive_material[s.mesh_primitive[s.object_mesh[leaf]]]
    assert (s.material_alpha_mode[k], s.material_alpha_cutoff[k], s.material_double_sided[k]) == (MASK, 0.25, True)
    assert s.material_texture.max() == 0
    assert s.texture_wrap.tolist() == [[33071, 33648]]
    assert not s.texture_linear[0]
    assert s.texture_data.tobytes() == png()
    assert s.object_replaceable.all()
    first, last = s.primitive_vertex[s.mesh_primitive[s.object_mesh[leaf]] + np.array([0, 1])]
    assert {tuple(c) for c in s.color[first:last].tolist()} == {(1, 0, 0, 1), (0, 1, 0, 1), (0, 0, 1, 1), (1, 1, 1, 1)}


def test_flat_normals_where_there_are_none(tmp_path):
    level = Gltf()
    s = read(tmp_path, one_mesh(level.primitive(BOX_CORNERS, BOX_FACES), level=level).glb())
    assert len(s.position) == 24  # four a face: both triangles of a face share them
    assert sorted(map(tuple, np.abs(s.normal).tolist())) == sorted([(1, 0, 0), (0, 1, 0), (0, 0, 1)] * 8)
    corner = s.position[s.index]
    outward = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    np.testing.assert_array_equal(outward, s.normal[s.index[:, 0]])


def test_given_normals_are_kept_and_useless_ones_filled(tmp_path):
    normal = np.array([[0, 3, 4], [0, 0, 1], [0, 0, 0], [np.nan, 0, 1]], dtype=np.float32)
    level = Gltf()
    s = read(tmp_path, one_mesh(level.primitive(SQUARE, QUAD, NORMAL=normal), level=level).glb())
    found = {tuple(p): n for p, n in zip(s.position[:, :2].tolist(), s.normal.tolist())}
    np.testing.assert_allclose(found[0, 0], [0, 0.6, 0.8], atol=1e-7)
    np.testing.assert_allclose([found[1, 0], found[1, 1], found[0, 1]], [[0, 0, 1]] * 3)


@pytest.mark.parametrize(
    ("mode", "index", "expected"),
    [
        (4, [0, 1, 2, 0, 2, 3], [[0, 1, 2], [0, 2, 3]]),
        (5, [0, 1, 3, 2], [[0, 1, 3], [1, 2, 3]]),
        (6, [0, 1, 2, 3], [[1, 2, 0], [2, 3, 0]]),
    ],
)
@pytest.mark.parametrize("indexed", [True, False])
def test_triangles_strips_and_fans(tmp_path, mode, index, expected, indexed):
    level = Gltf()
    if indexed:
        primitive = level.primitive(SQUARE, np.array(index, dtype=np.uint8), mode=mode)
    else:
        primitive = level.primitive(SQUARE[index], mode=mode)
    s = read(tmp_path, one_mesh(primitive, level=level).glb())
    assert triangle_set(placed(s, 0)) == triangle_set(SQUARE[np.array(expected)])


def test_a_long_strip_keeps_its_winding(tmp_path):
    n = 11
    strip = np.array([[i // 2, i % 2, 0] for i in range(n)], dtype=np.float32)
    level = Gltf()
    s = read(tmp_path, one_mesh(level.primitive(strip, mode=5), level=level).glb())
    corner = placed(s, 0)
    up = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2]
    assert len(corner) == n - 2
    assert (up < 0).all()  # the first triangle (0,0), (0,1), (1,0) turns clockwise, and so do all


def test_points_and_lines_are_left_out(tmp_path):
    level = Gltf()
    level.node(name="line", mesh=level.mesh(level.primitive(SQUARE, mode=1)))
    s = read(tmp_path, one_mesh(level.primitive(TRIANGLE), level=level).glb())
    assert s.object_name == ("it",)
    assert any("Points and lines" in w for w in s.warnings)


def test_interleaved_sparse_and_empty_accessors(tmp_path):
    level = Gltf()
    rows = np.zeros(4, dtype=[("p", "<f4", 3), ("uv", "<u2", 2), ("pad", "u1", 4)])
    rows["p"], rows["uv"] = SQUARE, [[0, 0], [65535, 0], [65535, 65535], [0, 65535]]
    view = level.view(rows.tobytes(), byteStride=rows.dtype.itemsize)
    position = level.add("accessors", {"bufferView": view, "componentType": 5126, "type": "VEC3", "count": 4})
    uv = level.add("accessors", {"bufferView": view, "byteOffset": 12, "componentType": 5123, "type": "VEC2",
                                 "count": 4, "normalized": True})  # fmt: skip
    at, values = level.view(np.array([2], "<u2").tobytes()), level.view(np.array([5, 5, 5], "<f4").tobytes())
    sparse = {"count": 1, "indices": {"bufferView": at, "componentType": 5123}, "values": {"bufferView": values}}
    moved = level.add("accessors", {"bufferView": view, "componentType": 5126, "type": "VEC3", "count": 4,
                                    "sparse": sparse})  # fmt: skip
    zeros = level.add("accessors", {"componentType": 5126, "type": "VEC3", "count": 4, "sparse": sparse})
    level.add("textures", {"source": level.add("images", {"bufferView": level.view(png()), "mimeType": "image/png"})})
    level.add("materials", {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}})
    for name, accessor in (("plain", position), ("moved", moved), ("zeros", zeros)):
        row = {"attributes": {"POSITION": accessor, "TEXCOORD_0": uv}, "mode": 6, "material": 0}
        level.node(name=name, mesh=level.mesh(row))
    s = read(tmp_path, level.glb())
    assert sorted(s.object_name) == ["moved", "plain"]  # all but one vertex at 0: no area
    np.testing.assert_array_equal(s.object_box[by_name(s, "plain")][1] + s.origin_m, [1, 1, 0])
    np.testing.assert_array_equal(s.object_box[by_name(s, "moved")][1] + s.origin_m, [5, 5, 5])
    assert {tuple(u) for u in s.uv.tolist()} == {(0, 0), (1, 0), (1, 1), (0, 1)}
    assert s.dropped_triangles == 2


def test_quantized_positions(tmp_path):
    level = Gltf()
    level.document["extensionsRequired"] = ["KHR_mesh_quantization"]
    square = level.accessor(np.array([[0, 0, 0, 0], [127, 0, 0, 0], [127, -127, 0, 0]], np.int8)[:, :3].copy(),
                            normalized=True)  # fmt: skip
    level.node(name="it", mesh=level.mesh({"attributes": {"POSITION": square}}), scale=[8, 8, 8])
    s = read(tmp_path, level.glb())
    np.testing.assert_allclose(s.object_box[0] + s.origin_m, [[0, -8, 0], [8, 0, 0]])


def test_texture_transform_is_baked(tmp_path):
    level = Gltf()
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)
    transform = {"offset": [0.5, 0.25], "rotation": np.pi / 2, "scale": [2, 3], "texCoord": 1}
    level.add("textures", {"source": level.add("images", {"bufferView": level.view(png()), "mimeType": "image/png"})})
    level.add("materials", {"pbrMetallicRoughness": {"baseColorTexture": {
        "index": 0, "extensions": {"KHR_texture_transform": transform}}}})  # fmt: skip
    level.document["extensionsRequired"] = ["KHR_texture_transform"]
    s = read(tmp_path, one_mesh(level.primitive(SQUARE, mode=6, TEXCOORD_1=uv, material=0), level=level).glb())
    found = {tuple(p): u for p, u in zip(s.position[:, :2].tolist(), s.uv.tolist())}
    # Counter-clockwise with v downwards: u -> -v, v -> u; scale first, offset last.
    for (x, y), (u, v) in zip(SQUARE[:, :2].tolist(), uv.tolist()):
        np.testing.assert_allclose(found[x, y], [3 * v + 0.5, -2 * u + 0.25], atol=1e-6)


def test_external_files_and_data_addresses(tmp_path):
    level = box_level()
    (tmp_path / "my buffer.bin").write_bytes(level.body)
    (tmp_path / "tex").mkdir()
    (tmp_path / "tex" / "a.png").write_bytes(png())
    level.document["images"][0] = {"uri": "tex/a.png"}
    outside = read(tmp_path, level.gltf("my%20buffer.bin"), name="a.gltf")
    level.document["images"][0] = {"uri": "data:image/png;base64," + base64.b64encode(png()).decode()}
    inside = read(tmp_path, level.gltf(), name="b.gltf")
    whole = read(tmp_path, box_level().glb())
    for s in (outside, inside):
        np.testing.assert_array_equal(s.position, whole.position)
        assert s.texture_data.tobytes() == whole.texture_data.tobytes()


def test_a_missing_or_broken_texture_is_a_warning(tmp_path):
    level = box_level()
    level.document["images"][0] = {"uri": "gone.png"}
    s = read(tmp_path, level.glb())
    assert s.material_texture.tolist() == [-1, -1]
    assert any("gone.png" in w for w in s.warnings)
    (tmp_path / "gone.png").write_bytes(png()[:40])
    s = read(tmp_path, level.glb())
    assert s.material_texture.tolist() == [-1, -1]
    assert any("images[0]" in w for w in s.warnings)


@pytest.mark.parametrize(
    "uri",
    [
        "../a.bin",
        "/etc/passwd",
        "http://x/a.bin",
        "file:///a.bin",
        "C:\\a.bin",
        "a/../../b.bin",
        "..%2Fa.bin",
        "\\\\host\\a",
    ],
)
@pytest.mark.parametrize("what", ["buffer", "image"])
def test_addresses_that_are_refused(tmp_path, uri, what):
    level = box_level()
    if what == "image":
        level.document["images"][0] = {"uri": uri}
        data = level.glb()
    else:
        data = level.gltf(uri)
    with pytest.raises(SceneUriRefused):
        read(tmp_path, data, name="a.gltf")


def test_a_link_that_leaves_the_folder_is_refused(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.bin").write_bytes(box_level().body)
    (tmp_path / "in" / "a.bin").symlink_to(tmp_path / "secret.bin")
    with pytest.raises(SceneUriRefused):
        read(tmp_path / "in", box_level().gltf("a.bin"), name="a.gltf")


def broken(change):
    level = box_level()
    change(level.document, level)
    return level


BROKEN = {
    "buffer file is missing": (lambda d, g: d.update(buffers=[{"byteLength": 4, "uri": "b.bin"}]), SceneFileMissing),
    "buffer is too short": (lambda d, g: d.update(buffers=[{"byteLength": 10**6}]), SceneUnreadable),
    "view past buffer": (lambda d, g: d["bufferViews"][1].update(byteLength=10**9), SceneIndexOutOfRange),
    "accessor past view": (lambda d, g: d["accessors"][0].update(count=10**7), SceneIndexOutOfRange),
    "stride too small": (lambda d, g: [v.update(byteStride=4) for v in d["bufferViews"]], SceneUnreadable),
    "index past vertices": (lambda d, g: d["accessors"][0].update(count=3), SceneIndexOutOfRange),
    "mesh that is not there": (lambda d, g: d["nodes"][0].update(mesh=9), SceneIndexOutOfRange),
    "negative count": (lambda d, g: d["accessors"][0].update(count=-1), SceneUnreadable),
    "attribute of other length": (lambda d, g: d["meshes"][0]["primitives"][0]["attributes"].update(
        TEXCOORD_0=g.accessor(np.zeros((3, 2), np.float32))), SceneUnreadable),
    "own ancestor": (lambda d, g: d["nodes"][1].update(children=[2]), SceneUnreadable),
    "two parents": (lambda d, g: d["nodes"][0].update(children=[1]), SceneUnreadable),
    "scale not finite": (lambda d, g: d["nodes"][0].update(scale=[1, 10**400, 1]), SceneNotFinite),
    "product not finite": (lambda d, g: [d["nodes"][i].update(scale=[1e200] * 3) for i in (1, 2)], SceneNotFinite),
    "position too large": (lambda d, g: d["nodes"][0].update(scale=[1e300] * 3), SceneOverLimit),
    "box not finite": (lambda d, g: d["nodes"][0].update(scale=[1e308] * 3, translation=[1e308] * 3), SceneNotFinite),
    "projective matrix": (lambda d, g: d["nodes"].__setitem__(0, {"mesh": 0, "matrix": [1] * 16}), SceneUnreadable),
    "draco": (lambda d, g: d.update(extensionsRequired=["KHR_draco_mesh_compression"]), SceneUnreadable),
    "version 1": (lambda d, g: d.update(asset={"version": "1.0"}), SceneUnreadable),
    "unknown mode": (lambda d, g: d["meshes"][0]["primitives"][0].update(mode=17), SceneUnreadable),
    "empty scene": (lambda d, g: d["scenes"][0].update(nodes=[]), SceneEmpty),
}  # fmt: skip


@pytest.mark.parametrize("what", BROKEN)
def test_broken_documents_are_refused_by_name(tmp_path, what):
    change, error = BROKEN[what]
    with pytest.raises(error) as caught:
        read(tmp_path, broken(change).glb())
    assert caught.value.advice


def test_required_extension_is_named(tmp_path):
    with pytest.raises(SceneUnreadable, match="KHR_draco_mesh_compression"):
        read(tmp_path, broken(BROKEN["draco"][0]).glb())


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_positions_that_are_not_finite(tmp_path, value):
    level = Gltf()
    bad = TRIANGLE.copy()
    bad[1, 1] = value
    with pytest.raises(SceneNotFinite):
        read(tmp_path, one_mesh(level.primitive(bad), level=level).glb())


def test_only_degenerate_triangles(tmp_path):
    level = Gltf()
    line = np.array([[0, 0, 0], [1, 1, 1], [3, 3, 3]], dtype=np.float32)
    with pytest.raises(SceneEmpty):
        read(tmp_path, one_mesh(level.primitive(line), level=level).glb())


@pytest.mark.parametrize(
    "limits",
    [{"bytes": 100}, {"triangles": 3}, {"vertices": 5}, {"nodes": 2}, {"node_depth": 1}, {"image_pixels": 15},
     {"texture_pixels": 15}, {"json_bytes": 50}],
)  # fmt: skip
def test_limits(tmp_path, limits):
    with pytest.raises(SceneOverLimit):
        read(tmp_path, box_level().glb(), limits=Limits(**limits))


def test_a_zero_filled_accessor_does_not_allocate_beyond_the_limit(tmp_path):
    level = Gltf()
    huge = level.add("accessors", {"componentType": 5126, "type": "VEC3", "count": 10**12})
    level.node(mesh=level.mesh({"attributes": {"POSITION": huge}}))
    with pytest.raises(SceneOverLimit):
        read(tmp_path, level.glb())


def test_one_accessor_drawn_many_times_counts_each_time(tmp_path):
    level = Gltf()
    primitive = level.primitive(np.tile(TRIANGLE, (1000, 1)))
    level.node(mesh=level.mesh(*[primitive] * 100))
    with pytest.raises(SceneOverLimit):
        read(tmp_path, level.glb(), limits=Limits(triangles=50_000))


def test_deep_nesting_is_refused_and_does_not_overflow(tmp_path):
    level = Gltf()
    mesh = level.mesh(level.primitive(TRIANGLE))
    level.node(children=[1])
    for i in range(1, 5000):
        level.node(root=False, children=[i + 1])
    level.node(root=False, mesh=mesh)
    with pytest.raises(SceneOverLimit):
        read(tmp_path, level.glb())
    with pytest.raises(SceneUnreadable):
        read(tmp_path, b"[" * 200_000, name="a.gltf")


def test_units_and_axes(tmp_path):
    level = Gltf()
    one_mesh(level.primitive([[0, 0, 0], [2, 0, 0], [0, 3, 5]]), level=level)
    s = read(tmp_path, level.glb(), unit_m=0.01, up="z")
    np.testing.assert_allclose(s.object_box[0] + s.origin_m, [[0, 0, -0.03], [0.02, 0.05, 0]], atol=1e-9)


def test_a_mesh_far_from_its_origin_is_moved_there_exactly(tmp_path):
    level = Gltf()
    offset = np.array([84_600.25, 447_400.5, 3.0], dtype=np.float32)
    far = (SQUARE * np.float32(7.75) + offset).astype(np.float32)
    one_mesh(level.primitive(far, mode=6), level=level)
    s = read(tmp_path, level.glb())
    assert np.abs(s.position).max() < 16
    np.testing.assert_array_equal(np.unique(placed(s, 0).reshape(-1, 3), axis=0), np.unique(far.astype(float), axis=0))
    assert np.abs(s.object_box).max() < 32
    assert (s.origin_m / s.cell_m == np.rint(s.origin_m / s.cell_m)).all()


def test_the_files_order_leaves_no_trace(tmp_path):
    def level(order):
        g = Gltf()
        for i in order:
            corners = BOX_CORNERS * (i + 1) + np.float32(5 * i)
            g.node(name=f"n{i}", mesh=g.mesh(g.primitive(corners, BOX_FACES)), translation=[7 * (i % 3), 0, 0])
        return g.glb()

    a, b = read(tmp_path, level(range(9))), read(tmp_path, level([4, 8, 0, 2, 7, 1, 5, 3, 6]))
    assert a.object_name == b.object_name
    for field in ("position", "normal", "index", "object_box", "object_matrix", "object_mesh", "primitive_vertex"):
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field))


@pytest.mark.parametrize("factor", [2.0**-7, 2.0, 2.0**12])
def test_scaling_by_a_power_of_two_keeps_ids(tmp_path, factor):
    rng = np.random.default_rng(1)
    spots = rng.uniform(-300, 300, (60, 3))

    def level(scale):
        g = Gltf()
        mesh = g.mesh(g.primitive(BOX_CORNERS, BOX_FACES))
        for i, p in enumerate(spots):
            g.node(name=f"{i}", mesh=mesh, translation=(p * scale).tolist(), scale=[3 * scale] * 3)
        return g.glb()

    a, b = read(tmp_path, level(1.0)), read(tmp_path, level(factor))
    assert a.object_name == b.object_name
    assert b.cell_m == a.cell_m * factor
    np.testing.assert_array_equal(a.object_box * factor, b.object_box)


@pytest.mark.parametrize("value", [[], {}, 5126.0, True, None])
def test_a_component_type_or_an_extension_of_another_json_type_is_refused(tmp_path, value):
    level = {
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"componentType": value, "type": "VEC3", "count": 3}],
    }  # fmt: skip
    path = tmp_path / "level.gltf"
    path.write_text(json.dumps(level))
    with pytest.raises(SceneUnreadable):
        read_scene(path, settings=Settings())
    path.write_text(json.dumps(level | {"extensionsRequired": [value]}))
    with pytest.raises(SceneUnreadable, match="extension"):
        read_scene(path, settings=Settings())
    path.write_text(json.dumps(level | {"extensionsUsed": [value]}))
    with pytest.raises(SceneUnreadable):
        read_scene(path, settings=Settings())
