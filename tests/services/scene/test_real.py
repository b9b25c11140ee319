"""Scenes that others made, and the demo city; each test skips visibly where its files are not there."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from cutout import ROOT, city_cutout, demo_city
from farfield.cli.main import main
from farfield.cli.place import load_settings
from farfield.errors import FarfieldError
from farfield.scene.read import read_scene
from farfield.settings import SceneSettings, Settings

SCENES = Path(os.environ.get("FARFIELD_SCENES", ROOT.parent / "shared" / "scenes"))
BAD = sorted(
    p for p in SCENES.glob("bad-input-examples/**/*") if p.suffix in (".gltf", ".glb", ".obj", ".ply", ".stl")
) or [SCENES / "bad-input-examples" / "missing"]

pytestmark = pytest.mark.scenes


def need(path):
    if not path.exists():
        pytest.skip(f"{path.name} of the development scenes is not there (FARFIELD_SCENES)")
    return path


@pytest.mark.parametrize("path", BAD, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_bad_input_loads_or_is_refused_by_name(path):
    need(path)
    try:
        scene = read_scene(path, settings=Settings())
    except FarfieldError as error:
        assert error.advice  # noqa: PT017
        return
    assert scene.n_objects > 0
    assert scene.object_triangles.min() > 0


@pytest.mark.parametrize(
    ("name", "objects", "triangles", "materials", "textures"),
    [
        ("folio2025-world/scene.glb", 905, None, 31, 14),
        ("kenney-city/scene.glb", 121, None, 1, 1),
        ("delft-3dfier/delft.gltf", 570, 21_801, 7, 0),
        ("schependomlaan-bim/scene.glb", 2203, 135_022, 28, 0),
        ("low-poly-jungle/scene.gltf", 16, 18_515, 16, 16),
        ("dream-apartment/scene.glb", 1, 177_934, 67, 0),
    ],
)
def test_real_scenes(name, objects, triangles, materials, textures):
    s = read_scene(need(SCENES / name), settings=Settings())
    pieces = [n for n in s.object_name if n.endswith("]") and " [" in n]
    assert s.n_objects - len(pieces) + len({n.rpartition(" [")[0] for n in pieces}) == objects
    if triangles is not None:
        assert s.object_triangles.sum() + s.dropped_triangles == triangles
    assert len(s.material_name) == materials
    assert len(s.texture_wrap) == textures
    length = np.sqrt((s.normal.astype(np.float64) ** 2).sum(1))
    np.testing.assert_allclose(length, 1, atol=1e-5)
    assert np.abs(s.object_box).max() < 2 * (s.object_box[:, 1].max(0) - s.object_box[:, 0].min(0)).max()


def test_delft_lies_near_its_own_origin():
    path = need(SCENES / "delft-3dfier" / "delft.gltf")
    s = read_scene(path, settings=Settings(scene=SceneSettings(up="z")))
    assert np.abs(s.position).max() < 1000
    assert np.abs(s.origin_m[[0, 2]]).tolist() == pytest.approx([84_600, 447_400], abs=600)
    assert s.object_box[:, 1].max(0)[1] - s.object_box[:, 0].min(0)[1] < 20


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    demo = demo_city()
    try:
        demo.folder()
    except demo.WheelMissing as error:
        pytest.skip(str(error))
    folder = tmp_path_factory.mktemp("city")
    demo.build(folder / "city.glb", folder / "city.toml")
    return folder


def test_the_demo_city_is_the_development_scene(city):
    settings = load_settings(city / "city.toml", None)
    s = read_scene(city / "city.glb", settings=settings)
    names = {n.rpartition(" [")[0] or n for n in s.object_name}
    assert len(names) == 4735
    assert s.object_triangles.sum() == 268_041
    assert set(s.material_name) == {"wall", "roof", "ground"}
    assert settings.budget == "1300 calls"
    boxes = s.view_boxes + s.origin_m
    assert len(boxes) == 520
    np.testing.assert_allclose(np.mod(boxes[:, :, [0, 2]], 23.0), 0)
    assert ((boxes[:, 1] - boxes[:, 0])[:, 1] >= 0.29).all()
    assert ((boxes[:, 1] - boxes[:, 0])[:, 1] < 23).all()
    other = read_scene(need(SCENES / "san-francisco-osm" / "scene.glb"), settings=settings)
    assert s.object_name == other.object_name
    np.testing.assert_array_equal(s.object_box, other.object_box)
    np.testing.assert_array_equal(s.object_triangles, other.object_triangles)


def test_inspect_prints_one_document(capsys):
    scene, settings = city_cutout()
    assert main(["inspect", str(scene), "--settings", str(settings), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [o["id"] for o in document["objects"]] == list(range(len(document["objects"])))
    assert set(document["objects"][0]) >= {"id", "name", "box", "triangles", "calls"}
    assert document["triangles"] == sum(o["triangles"] for o in document["objects"])
    assert any("Terrain" in w for w in document["warnings"])
    assert document["suggested"]["view_space"]["cell_m"] == 23.0
    assert main(["inspect", str(scene)]) == 0
    assert f"{len(document['objects']):,} of" in capsys.readouterr().out


def test_inspect_refuses_with_exit_code_3(tmp_path, capsys):
    (tmp_path / "a.glb").write_bytes(b"glTF junk")
    assert main(["inspect", str(tmp_path / "a.glb")]) == 3
    assert "SceneUnreadable" in capsys.readouterr().err
