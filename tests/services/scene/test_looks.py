"""What no picture taken beforehand can show is found in the file, counted, and stays geometry unless it is flattened."""

import numpy as np
import pytest
from farfield.scene import model
from farfield.scene.read import read_scene
from farfield.settings import from_mapping
from levels import BOX_CORNERS, BOX_FACES, Gltf

PLAIN = {"pbrMetallicRoughness": {"metallicFactor": 0}}


def materials_of(level):
    """Return the materials to use, by name."""
    more = {
        "plain": PLAIN, "metal": {"pbrMetallicRoughness": {}}, "no pbr": {},
        "lacquer": PLAIN | {"extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": 1}}},
        "glass": PLAIN | {"extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}}},
        "smoke": PLAIN | {"alphaMode": "BLEND"},
        "sign": {"pbrMetallicRoughness": {}, "extensions": {"KHR_materials_unlit": {}}, "emissiveFactor": [1, 1, 1]},
    }  # fmt: skip
    return {name: level.add("materials", {"name": name} | row) for name, row in more.items()}


def read(tmp_path, **flatten):
    level = Gltf()
    for name, material in materials_of(level).items():
        level.node(name=name, mesh=level.mesh(level.primitive(BOX_CORNERS, BOX_FACES, material=material)))
    box = level.document["nodes"][0]["mesh"]
    level.node(name="skinned", mesh=box, skin=0)
    targets = level.primitive(BOX_CORNERS, BOX_FACES, material=0) | {"targets": [{}]}
    level.node(name="morphed", mesh=level.mesh(targets))
    child = level.node(name="child", root=False, mesh=box, translation=[3, 0, 0])
    parent = level.node(name="parent", mesh=box, children=[child])
    weighted = level.node(name="weighted", mesh=box)
    channels = [{"target": {"node": parent, "path": "translation"}, "sampler": 0}]
    channels.append({"target": {"node": weighted, "path": "weights"}, "sampler": 0})
    level.add("animations", {"channels": channels, "samplers": []})
    (tmp_path / "a.glb").write_bytes(level.glb())
    return read_scene(tmp_path / "a.glb", settings=from_mapping({"bake": flatten}))


LOOK = {
    "plain": 0, "metal": model.SHINY, "no pbr": 0, "lacquer": model.SHINY, "glass": model.TRANSMISSIVE | model.BLENDED,
    "smoke": model.BLENDED, "sign": 0, "skinned": model.SKINNED, "morphed": model.MORPHED, "parent": model.ANIMATED,
    "child": model.ANIMATED, "weighted": model.MORPHED,
}  # fmt: skip


@pytest.mark.parametrize(
    ("flatten", "kept"),
    [
        ("none", {"metal", "lacquer", "glass", "smoke", "skinned", "morphed", "parent", "child", "weighted"}),
        ("shine", {"glass", "smoke", "skinned", "morphed", "parent", "child", "weighted"}),
        ("all", {"glass", "smoke"}),
    ],
)
def test_looks_are_found_and_kept_as_geometry(tmp_path, flatten, kept):
    s = read(tmp_path, flatten=flatten)
    assert {name: int(look) for name, look in zip(s.object_name, s.object_look, strict=True)} == LOOK
    assert {name for name, may in zip(s.object_name, s.object_replaceable, strict=True) if not may} == kept


def test_an_unlit_material_has_its_colour_and_nothing_else(tmp_path):
    s = read(tmp_path)
    k = s.material_name.index("sign")
    assert s.material_unlit.tolist() == [name == "sign" for name in s.material_name]
    np.testing.assert_array_equal(s.material_emissive[k], 0)


def test_pieces_of_a_split_object_keep_its_look(tmp_path):
    level = Gltf()
    grid = np.stack(np.meshgrid(np.arange(65), [0], np.arange(65), indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    k = (np.arange(64)[:, None] * 65 + np.arange(64)).reshape(-1, 1)
    faces = np.concatenate([k + np.array(c) for c in ([0, 1, 65], [1, 66, 65])]).astype(np.uint32)
    material = level.add("materials", {"pbrMetallicRoughness": {"metallicFactor": 1}})
    level.node(name="sea", mesh=level.mesh(level.primitive(grid, faces, material=material)), skin=0, scale=[4, 1, 4])
    (tmp_path / "a.glb").write_bytes(level.glb())
    s = read_scene(
        tmp_path / "a.glb", settings=from_mapping({"view_space": {"cell_m": 8}, "scene": {"split_triangles": 64}})
    )
    assert s.n_objects > 4
    assert (s.object_look == model.SKINNED | model.SHINY).all()
