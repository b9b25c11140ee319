import io

import numpy as np
import pytest
from farfield.errors import SceneOverLimit
from farfield.scene import picture
from farfield.scene.ear_kernels import clip_ears
from farfield.scene.picture import picture_from_above
from farfield.scene.picture_kernels import draw_from_above
from farfield.scene.polygons import triangulate
from farfield.scene.read import read_scene
from farfield.settings import Settings
from levels import BOX_CORNERS, BOX_FACES, Gltf
from naive.ears import clip_ears as clip_ears_naively
from naive.picture import heights_from_above
from PIL import Image


@pytest.mark.parametrize("seed", range(5))
def test_the_highest_surface_is_drawn(seed):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (8, 3, 3))
    low, scale, shape = np.array([-1.0, 0.0, -1.0]), 8.0, (16, 16)
    height, image = np.full(shape, -np.inf), np.zeros((*shape, 3))
    index = np.arange(24, dtype=np.int32).reshape(-1, 3)
    position = corners.reshape(-1, 3).astype(np.float32)
    colors = np.ones((8, 3), dtype=np.float32)
    span, matrix = np.array([0, 8]), np.eye(4)[:3].copy()
    arguments = (position, index, span, matrix, colors, low[0], low[2], scale)
    looked = draw_from_above(*arguments, height, image, 10**6)
    told = heights_from_above(position.reshape(-1, 3, 3).astype(np.float64), low=low, scale=scale, shape=shape)
    np.testing.assert_array_equal(np.isfinite(height), np.isfinite(told))
    np.testing.assert_allclose(height[np.isfinite(told)], told[np.isfinite(told)], atol=1e-9)
    assert (image[np.isfinite(told)] > 0).all()
    assert np.isfinite(told).sum() <= looked <= 8 * 16 * 16
    assert draw_from_above(*arguments, np.full(shape, -np.inf), image, looked - 1) == -1


def test_a_red_box_north_of_a_blue_one(tmp_path, monkeypatch):
    level = Gltf()
    for k, (color, z) in enumerate((([1, 0, 0, 1], -3), ([0, 0, 1, 1], 3))):
        level.add("materials", {"pbrMetallicRoughness": {"baseColorFactor": color}})
        mesh = level.mesh(level.primitive(BOX_CORNERS, BOX_FACES, material=k))
        level.node(mesh=mesh, translation=[0, 0, z])
    (tmp_path / "a.glb").write_bytes(level.glb())
    scene = read_scene(tmp_path / "a.glb", settings=Settings())
    image = np.asarray(Image.open(io.BytesIO(picture_from_above(scene))))
    assert image.shape == (512, 74, 3)
    assert (image[10, 37] // 100).tolist() == [2, 0, 0]
    assert (image[-10, 37] // 100).tolist() == [0, 0, 2]
    assert len(set(image[256, 37].tolist())) == 1
    monkeypatch.setattr(picture, "MOST_LOOKED", 1000)
    assert picture_from_above(scene) is None


@pytest.mark.parametrize("seed", range(30))
def test_ears_are_cut_as_in_the_book(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 14))
    if seed % 3:  # a star around the middle, else a polygon that crosses itself; on a grid, so that points coincide
        angle = np.sort(rng.uniform(0, 2 * np.pi, n))
        flat = np.stack([np.cos(angle), np.sin(angle)], 1) * rng.uniform(0.2, 1, (n, 1))
    else:
        flat = rng.integers(0, 4, (n, 2)).astype(np.float64)
    found = np.empty((n - 2, 3), dtype=np.int64)
    assert clip_ears(flat, 10**6, found) <= 10**6
    assert [tuple(t) for t in found.tolist()] == clip_ears_naively([tuple(p) for p in flat.tolist()])


def test_a_polygon_that_would_take_for_ever_is_refused(monkeypatch):
    monkeypatch.setattr("farfield.scene.polygons.MOST_TESTS", 1000)
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    star = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1) * (1 + np.arange(200) % 2)[:, None]
    with pytest.raises(SceneOverLimit, match="concave"):
        triangulate(star, np.arange(200), np.array([200]))
