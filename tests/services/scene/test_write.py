import dataclasses
import json

import numpy as np
import pytest
from cutout import city_cutout
from farfield.cli.place import load_settings
from farfield.scene.model import Scene
from farfield.scene.read import read_scene
from farfield.scene.write import write_glb
from farfield.settings import Settings, ViewSpaceSettings
from levels import box_level, png
from towns import town


def document_of(data):
    length = int.from_bytes(data[12:16], "little")
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def assert_same(a: Scene, b: Scene, *, leave_out=("warnings", "dropped_triangles", "object_look")):
    for field in dataclasses.fields(Scene):
        if field.name in leave_out:
            continue
        x, y = getattr(a, field.name), getattr(b, field.name)
        if isinstance(x, np.ndarray):
            np.testing.assert_array_equal(x, y, err_msg=field.name)
            assert x.dtype == y.dtype, field.name
        else:
            assert x == y, field.name


def back(tmp_path, scene):
    (tmp_path / "back.glb").write_bytes(write_glb(scene))
    boxes = tuple((tuple(lo), tuple(hi)) for lo, hi in (scene.view_boxes + scene.origin_m).tolist())
    space = ViewSpaceSettings(boxes=boxes, cell_m=scene.cell_m)
    return read_scene(tmp_path / "back.glb", settings=Settings(view_space=space))


def small(tmp_path):
    level = box_level()
    level.document["materials"][0]["emissiveFactor"] = [1, 0.5, 0]
    level.document["materials"][0]["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": 3}}
    (tmp_path / "a.glb").write_bytes(level.glb())
    return read_scene(tmp_path / "a.glb", settings=Settings())


def test_reading_back_gives_the_same_scene(tmp_path):
    scene = small(tmp_path)
    assert_same(scene, back(tmp_path, scene))


def test_reading_back_keeps_what_glows_and_what_no_light_falls_on(tmp_path):
    level = box_level()
    level.add("textures", {"source": 0})
    brick, leaf = level.document["materials"]
    brick |= {"emissiveFactor": [1, 1, 1], "emissiveTexture": {"index": 1, "texCoord": 1}}
    leaf["extensions"] = {"KHR_materials_unlit": {}}
    box = level.document["meshes"][0]["primitives"][0]["attributes"]
    box["TEXCOORD_1"] = level.accessor(np.linspace(0, 1, 16, dtype=np.float32).reshape(8, 2))
    (tmp_path / "a.glb").write_bytes(level.glb())
    scene = read_scene(tmp_path / "a.glb", settings=Settings())
    assert sorted(scene.material_emissive_texture.tolist()) == [-1, 1]
    assert len(np.unique(scene.emissive_uv, axis=0)) >= 8
    assert scene.material_unlit.sum() == 1
    assert_same(scene, back(tmp_path, scene))
    document, _ = document_of(write_glb(scene))
    assert "KHR_materials_unlit" in document["extensionsUsed"]


def test_reading_back_the_city(tmp_path):
    path, settings = city_cutout()
    scene = read_scene(path, settings=load_settings(settings, None))
    assert_same(scene, back(tmp_path, scene))
    assert 350 < scene.n_objects < 450


def test_ids_names_and_matrices_of_the_nodes(tmp_path):
    scene = small(tmp_path)
    document, _ = document_of(write_glb(scene))
    assert [n["extras"]["object"] for n in document["nodes"]] == list(range(scene.n_objects))
    assert tuple(n["name"] for n in document["nodes"]) == scene.object_name
    assert document["scenes"][0]["nodes"] == list(range(scene.n_objects))
    house, mirror = scene.object_name.index("house"), scene.object_name.index("mirror")
    assert document["nodes"][house]["mesh"] == document["nodes"][mirror]["mesh"]
    assert document["nodes"][house]["matrix"][12:] == [3, 0, 0, 1]


@pytest.mark.parametrize("make", [small, lambda _: town(30)])
def test_the_document_keeps_the_rules_of_gltf(tmp_path, make):
    data = write_glb(make(tmp_path))
    document, body = document_of(data)
    assert int.from_bytes(data[8:12], "little") == len(data)
    assert len(data) % 4 == 0
    assert document["buffers"][0]["byteLength"] == len(body)
    sizes = {5123: 2, 5125: 4, 5126: 4}
    widths = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
    for view in document["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
        assert view["byteOffset"] + view["byteLength"] <= len(body)
        assert view["byteLength"] > 0
    for a in document["accessors"]:
        view = document["bufferViews"][a["bufferView"]]
        size = sizes[a["componentType"]] * widths[a["type"]]
        assert a["byteOffset"] % sizes[a["componentType"]] == 0
        assert a["byteOffset"] + size * a["count"] <= view["byteLength"]
        assert view.get("byteStride", size) == size
    for mesh in document["meshes"]:
        for p in mesh["primitives"]:
            position = document["accessors"][p["attributes"]["POSITION"]]
            view = document["bufferViews"][position["bufferView"]]
            rows = np.frombuffer(body, "<f4", 3 * position["count"], view["byteOffset"] + position["byteOffset"])
            np.testing.assert_array_equal(rows.reshape(-1, 3).min(0), position["min"])
            np.testing.assert_array_equal(rows.reshape(-1, 3).max(0), position["max"])
    used = set(document.get("extensionsUsed", []))
    optional = {"KHR_materials_emissive_strength", "KHR_materials_unlit"}
    assert used == set(document.get("extensionsRequired", [])) | (optional & used)
    for key in ("textures", "images", "samplers"):
        assert document.get(key) != []


def test_the_same_scene_gives_the_same_bytes(tmp_path):
    assert write_glb(small(tmp_path)) == write_glb(small(tmp_path))


def test_large_primitives_take_wide_indices_and_webp_its_extension(tmp_path):
    import io

    from PIL import Image

    out = io.BytesIO()
    Image.open(io.BytesIO(png(size=8))).save(out, "WEBP", lossless=True)
    level = box_level()
    level.document["images"][0] = {"bufferView": level.view(out.getvalue()), "mimeType": "image/webp"}
    grid = np.stack(np.meshgrid(np.arange(300), np.arange(300), [0], indexing="ij"), -1).reshape(-1, 3)
    a = (np.arange(299)[:, None] * 300 + np.arange(299)).reshape(-1)
    index = np.stack([a, a + 300, a + 301], 1).astype(np.uint32)
    normal = np.tile(np.float32([0, 0, 1]), (len(grid), 1))
    level.node(name="big", mesh=level.mesh(level.primitive(grid / 300, index, NORMAL=normal)))
    (tmp_path / "a.glb").write_bytes(level.glb())
    scene = read_scene(tmp_path / "a.glb", settings=Settings(view_space=ViewSpaceSettings(cell_m=1024.0)))
    document, _ = document_of(write_glb(scene))
    assert document["extensionsRequired"] == ["EXT_texture_webp"]
    assert {a["componentType"] for a in document["accessors"] if a["type"] == "SCALAR"} == {5123, 5125}
    assert_same(scene, back(tmp_path, scene))
