"""Colours: the lighting formula, sRGB, mip levels, bleeding and crops."""

import dataclasses

import numpy as np
import pytest
from farfield.bake.bake import bake_batch
from farfield.bake.crop import _extent, bleed, crop, polygon
from farfield.bake.shade import DECODE, LIGHTING, encode_srgb, light
from farfield.bake.textures import decode
from farfield.candidates.model import BOX
from farfield.errors import SceneUnreadable
from farfield.hierarchy.build import build_hierarchy
from farfield.rendertime.cost import build_cost_model
from farfield.settings import from_mapping
from naive import bake as naive_bake
from naive.bleed import bleed as naive_bleed
from panels import Panel, box_cell, chosen, panel_scene

SETTINGS = from_mapping({"camera": {"width": 320, "height": 180}})
CELL = box_cell((-0.1, 4.9, -0.1), (0.1, 5.1, 0.1))


def bake(scene):
    hierarchy, model = build_hierarchy(scene), build_cost_model(scene, settings=SETTINGS)
    return bake_batch(
        scene, hierarchy, model, chosen([0], BOX, CELL), settings=SETTINGS, impostors=(0, 1), renderer="numba"
    )


def test_srgb_bytes_survive_decoding_and_encoding():
    np.testing.assert_array_equal(encode_srgb(DECODE), np.arange(256))
    np.testing.assert_array_equal(encode_srgb(np.array([-1.0, 0, 1, 7])), [0, 0, 255, 255])


def test_the_sun_is_a_unit_vector_and_nothing_white_clips_much():
    assert np.linalg.norm(LIGHTING["sun_direction"]) == pytest.approx(1)
    assert light(np.eye(3)).max() < 1.3


@pytest.mark.parametrize("turned", [False, True])
def test_a_wall_has_the_colour_of_the_formula(turned):
    """Also from behind, where the normal of a double-sided material is turned round; and in a turned object."""
    wall = Panel(low=(-10, 0, -40), u=(20, 0, -3), v=(0, 10, 0))
    if turned:
        wall = Panel(low=(10, 0, -43), u=(-20, 0, 3), v=(0, 10, 0))
    scene = panel_scene([wall], base_color=[(0.5, 0.3, 0.2, 1)])
    scene = dataclasses.replace(scene, material_emissive=np.array([[0.05, 0.0, 0.1]], np.float32))
    normal = np.cross(wall.u, wall.v) / np.linalg.norm(np.cross(wall.u, wall.v))
    normal = -normal if turned else normal
    expected = encode_srgb(np.array([0.5, 0.3, 0.2]) * light(normal) + [0.05, 0, 0.1])
    texels = naive_bake.layer_texels(bake(scene), 0)
    assert (np.abs(texels[texels[..., 3] > 0][:, :3].astype(int) - expected) <= 1).all()


@pytest.mark.parametrize("up", [True, False])
@pytest.mark.parametrize("height", [4.95, 5.05])
def test_a_face_across_the_view_cell_shows_its_front(height, up):
    """Wherever the eye lies: of closed bodies nobody sees the back, though the eye may be on its side."""
    roof = Panel(low=(-10, height, -40), u=(20, 0, 0), v=(0, 0, -20))
    if not up:
        roof = Panel(low=(10, height, -40), u=(-20, 0, 0), v=(0, 0, -20))
    normal = np.array([0.0, 1 if up else -1, 0])
    baked = bake(panel_scene([roof], base_color=[(0.5, 0.3, 0.2, 1)]))
    texels = np.concatenate([naive_bake.layer_texels(baked, k).reshape(-1, 4) for k in range(len(baked.plane))])
    expected = encode_srgb(np.array([0.5, 0.3, 0.2]) * light(normal))
    assert (np.abs(texels[texels[:, 3] > 0][:, :3].astype(int) - expected) <= 1).all()


def test_a_turned_object_turns_its_normals():
    """The same wall, lying in its own frame and put upright by a matrix that also stretches it."""
    flat = Panel(low=(-5, 0, 0), u=(10, 0, 0), v=(0, 0, -5))
    scene = panel_scene([flat])
    matrix = np.array([[[2, 0, 0, 0], [0, 0, -2, 0], [0, 1, 0, -40.0]]])  # y -> z, z -> -2 y
    scene = dataclasses.replace(
        scene, object_matrix=matrix, object_box=np.array([[[-10, 0, -40], [10, 10, -40.0]]])
    )  # fmt: skip
    texels = naive_bake.layer_texels(bake(scene), 0)
    expected = encode_srgb(0.8 * light(np.array([0.0, 0, 1])))
    assert (np.abs(texels[texels[..., 3] > 0][:, :3].astype(int) - expected) <= 1).all()


def test_no_light_falls_on_an_unlit_wall():
    wall = Panel(low=(-10, 0, -40), u=(20, 0, -3), v=(0, 10, 0))
    scene = panel_scene([wall], base_color=[(0.5, 0.3, 0.2, 1)])
    texels = naive_bake.layer_texels(bake(dataclasses.replace(scene, material_unlit=np.array([True]))), 0)
    assert (texels[texels[..., 3] > 0][:, :3] == encode_srgb(np.array([0.5, 0.3, 0.2]))).all()
    assert (naive_bake.layer_texels(bake(scene), 0)[..., :3] != texels[..., :3]).any()


def test_an_emissive_texture_glows_where_its_own_coordinates_put_it():
    """Black and white halves, laid on across: the upper half of the wall glows, the lower is only lit."""
    wall = Panel(low=(-8, 0, -40), u=(16, 0, 0), v=(0, 16, 0))
    image = np.zeros((4, 4, 4), np.uint8)
    image[:, 2:, :3], image[..., 3] = 255, 255
    scene = panel_scene([wall], base_color=[(0.5, 0.5, 0.5, 1)], texture=[-1], images=[image], linear=False)
    scene = dataclasses.replace(
        scene, material_emissive=np.array([[0.0, 0.0, 0.25]], np.float32), material_emissive_texture=np.array([0], np.int32),
        emissive_uv=np.array([[0, 0], [0, 1], [1, 1], [1, 0]], np.float32),
    )  # fmt: skip
    texels = naive_bake.layer_texels(bake(scene), 0)
    lit = 0.5 * light(np.array([0.0, 0, 1]))
    third = len(texels) // 3
    for rows, glow in ((texels[:third], 0.0), (texels[-third:], 0.25)):
        shown = rows[rows[..., 3] > 0][:, :3].astype(int)
        assert len(shown) > 100
        assert (np.abs(shown - encode_srgb(lit + np.array([0, 0, glow]))) <= 1).all()


def test_mip_levels_average_light_not_bytes():
    image = np.zeros((6, 10, 4), np.uint8)
    image[:, 0::2, :3], image[..., 3] = 255, 255
    scene = panel_scene([Panel(low=(0, 0, 0), u=(1, 0, 0), v=(0, 1, 0))], texture=[0], images=[image])
    pyramids = decode(scene, np.array([0]))
    np.testing.assert_array_equal(pyramids.level_size, [[10, 6], [5, 3], [3, 2], [2, 1], [1, 1]])
    second = pyramids.texel[pyramids.level_byte[1] :][: 5 * 3 * 4].reshape(3, 5, 4)
    assert (second[..., :3] == encode_srgb(np.array(0.5))).all()
    assert (second[..., 3] == 255).all()
    assert len(decode(scene, np.zeros(0, int)).texel) == 0


def test_a_distant_texture_shows_its_mean():
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, (512, 512, 4)).astype(np.uint8)
    image[..., 3] = 255
    scene = panel_scene([Panel(low=(-2, 0, -90), u=(4, 0, 0), v=(0, 4, 0))], texture=[0], images=[image],
                        base_color=[(1, 1, 1, 1)])  # fmt: skip
    texels = naive_bake.layer_texels(bake(scene), 0)
    inner = texels[2:-2, 2:-2, :3].astype(float)
    mean = encode_srgb(DECODE[image[..., :3]].mean((0, 1)) * light(np.array([0, 0, 1.0])))
    assert np.abs(inner - mean).max() < 12


def test_a_texture_that_does_not_decode_is_named():
    panel = Panel(low=(0, 0, 0), u=(1, 0, 0), v=(0, 1, 0))
    scene = panel_scene([panel], texture=[0], images=[np.zeros((4, 4, 4), np.uint8)])
    scene = dataclasses.replace(scene, texture_data=scene.texture_data[::-1].copy())
    with pytest.raises(SceneUnreadable, match="texture 0"):
        decode(scene, np.array([0]))


def test_bleeding_spreads_as_the_slow_version_does():
    rng = np.random.default_rng(2)
    for _ in range(40):
        rgba = rng.integers(0, 256, (*rng.integers(1, 14, 2), 4)).astype(np.uint8)
        rgba[rng.random(rgba.shape[:2]) < 0.85] = 0
        found = rgba.copy()
        bleed(found, 2)
        np.testing.assert_array_equal(found, naive_bleed(rgba, 2))
        np.testing.assert_array_equal(found[..., 3], rgba[..., 3])


def test_a_crop_is_tight_and_its_polygon_convex_and_small():
    rng = np.random.default_rng(3)
    for _ in range(300):
        rgba = np.zeros((24, 31, 4), np.uint8)
        kind = rng.integers(3)
        if kind == 0:
            rgba[rng.integers(24), rng.integers(31)] = 9
        elif kind == 1:  # a diagonal band: all four cuts or two
            k = np.arange(18)
            rgba[k + 3, k + 7] = 9
        else:
            rgba[rng.random((24, 31)) < rng.random() ** 4] = 9
        found = crop(rgba)
        if not found:
            assert not rgba.any()
            continue
        seen = np.zeros(rgba.shape[:2], int)
        assert sum(len(corners) - 2 for _, _, corners in found) <= 6
        for tile, (x, y), corners in found:
            part = rgba[y : y + tile.shape[0], x : x + tile.shape[1], 3]
            np.testing.assert_array_equal(part, tile[..., 3])
            seen[y : y + tile.shape[0], x : x + tile.shape[1]] += 1
            assert tile[..., 3].any(0)[[0, -1]].all()
            assert tile[..., 3].any(1)[[0, -1]].all()
            assert 3 <= len(corners) <= 8
            edge = np.roll(corners, -1, 0) - corners
            following = np.roll(edge, -1, 0)
            assert (edge[:, 0] * following[:, 1] - edge[:, 1] * following[:, 0] > 0).all()
            assert ((corners >= [x, y]) & (corners <= [x + tile.shape[1], y + tile.shape[0]])).all()
            j, i = np.nonzero(part)
            for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
                p = np.stack([i + dx + x, j + dy + y], -1)[:, None] - corners
                # Corners where prolonged edges meet are rounded: to some 1e-14 of the layer.
                assert (edge[:, 0] * p[..., 1] - edge[:, 1] * p[..., 0] >= -1e-9).all()
        assert (seen[rgba[..., 3] > 0] > 0).all()


def test_the_polygon_of_a_slanted_roof_follows_it():
    """Slopes that no cut at 45 degrees meets: half of the octagon is empty, the hull is tight but for its steps."""
    for wide, high in ((60, 20), (20, 60), (40, 40), (64, 9)):
        rgba = np.zeros((high, wide, 4), np.uint8)
        for j in range(high):
            rgba[j, : max(1, wide * (high - j) // high), 3] = 9
        ((_, _, corners),) = crop(rgba, 1)
        area = (corners[:, 0] * np.roll(corners[:, 1], -1) - np.roll(corners[:, 0], -1) * corners[:, 1]).sum() / 2
        assert area <= (rgba[..., 3] > 0).sum() + wide + high
        extent = np.empty(8, np.int64)
        _extent(rgba, extent)
        octagon = polygon(extent)
        full = (octagon[:, 0] * np.roll(octagon[:, 1], -1) - np.roll(octagon[:, 0], -1) * octagon[:, 1]).sum() / 2
        assert area <= full


def test_a_diagonal_is_cut_and_a_full_rectangle_is_not():
    assert len(polygon(np.array([0, 10, 0, 10, 0, 20, -10, 10]))) == 4
    band = polygon(np.array([0, 10, 0, 10, 0, 20, -1, 1]))
    assert len(band) == 6
    area = (band[:, 0] * np.roll(band[:, 1], -1) - np.roll(band[:, 0], -1) * band[:, 1]).sum() / 2
    assert area == 19
