import numpy as np
import pytest
from farfield.errors import SettingsInvalid
from farfield.geometry.cells import build_cells, find_cell
from farfield.scene.derive import focus_box, merged_columns
from farfield.scene.read import inspect_scene
from farfield.settings import Settings, ViewSpaceSettings
from levels import BOX_CORNERS, BOX_FACES, Gltf


def ground_and_houses(side_m, *, slope=0.0, houses=40, flip=False):
    level = Gltf()
    h = np.float32(side_m / 2)
    corners = np.array([[-h, -h * slope, -h], [h, h * slope, -h], [h, h * slope, h], [-h, -h * slope, h]], np.float32)
    index = np.array([0, 1, 2, 0, 2, 3] if flip else [0, 2, 1, 0, 3, 2], dtype=np.uint16)
    level.node(name="ground", mesh=level.mesh(level.primitive(corners, index)))
    box = level.mesh(level.primitive(BOX_CORNERS, BOX_FACES))
    rng = np.random.default_rng(0)
    for i in range(houses):
        x, z = (rng.uniform(-0.45, 0.45, 2) * side_m).tolist()
        level.node(name=f"h{i}", mesh=box, translation=[x, x * slope, z], scale=[8, 10, 8])
    return level


def read(tmp_path, level, **view_space):
    (tmp_path / "a.glb").write_bytes(level.glb())
    return inspect_scene(tmp_path / "a.glb", settings=Settings(view_space=ViewSpaceSettings(**view_space)))


@pytest.mark.parametrize("flip", [False, True])
def test_flat_ground_gives_one_band(tmp_path, flip):
    s, found = read(tmp_path, ground_and_houses(512.0, flip=flip))
    assert found.cell_m == s.cell_m == 8.0
    assert len(found.boxes) == 1
    (low, high) = found.boxes[0]
    assert (low[1], high[1]) == (1.5, 1.8)
    assert low[0] <= -248
    assert high[0] >= 248
    assert "ground" in found.boxes_why
    np.testing.assert_array_equal(s.view_boxes + s.origin_m, np.array(found.boxes))
    assert found.budgets[0].endswith("calls")


def test_the_band_follows_a_slope_on_the_grid(tmp_path):
    s, found = read(tmp_path, ground_and_houses(512.0, slope=0.2))
    boxes = np.array(found.boxes)
    np.testing.assert_allclose(np.mod(boxes[:, :, [0, 2]], s.cell_m), 0)
    middle = boxes[:, :, 0].mean(1)
    inside = np.abs(middle) < 240
    assert (boxes[inside, 0, 1] > middle[inside] * 0.2 - 0.2 * s.cell_m + 1.4).all()
    assert (boxes[inside, 1, 1] < middle[inside] * 0.2 + 0.2 * s.cell_m + 1.9).all()
    tree = build_cells(s.view_boxes, s.cell_m)
    assert tree.n_cells < 6000
    eye = np.array([100.0, 20.0 + 1.65, 30.0])
    assert find_cell(tree, s.view_boxes, eye - s.origin_m) >= 0


def test_without_ground_the_whole_box(tmp_path):
    level = Gltf()
    box = level.mesh(level.primitive(BOX_CORNERS, BOX_FACES))
    for i in range(20):
        level.node(mesh=box, translation=[7.0 * i, 11.0 * (i % 3), 5.0 * (i % 7)])
    s, found = read(tmp_path, level)
    assert len(found.boxes) == 1
    bounds = np.stack([s.object_box[:, 0].min(0), s.object_box[:, 1].max(0)]) + s.origin_m
    np.testing.assert_allclose(found.boxes[0], bounds)
    assert "whole box" in found.boxes_why


def test_settings_win(tmp_path):
    boxes = (((0.0, 1.0, 0.0), (5.0, 2.0, 5.0)),)
    s, found = read(tmp_path, ground_and_houses(512.0), boxes=boxes, cell_m=23.0)
    assert (found.boxes, found.cell_m, s.cell_m) == (boxes, 23.0, 23.0)
    assert found.boxes_why == found.cell_why == "as set"
    assert (s.origin_m / 23.0 == np.rint(s.origin_m / 23.0)).all()
    np.testing.assert_array_equal(s.view_boxes + s.origin_m, np.array(boxes))


def test_a_tiny_cell_in_a_large_level_allocates_no_more(tmp_path):
    with pytest.raises(SettingsInvalid, match=r"view_space\.cell_m: cells of 0\.001 m would be about"):
        read(tmp_path, ground_and_houses(10_000.0), cell_m=0.001)


def test_a_cell_larger_than_the_level_still_has_a_band_in_it(tmp_path):
    s, found = read(tmp_path, ground_and_houses(512.0), cell_m=4096.0)
    assert s.cell_m == 4096.0
    assert found.boxes[0][0][1] == 1.5


def test_a_toy_gets_eyes_of_its_size(tmp_path):
    level = ground_and_houses(1.0, houses=0)
    level.node(mesh=level.mesh(level.primitive(BOX_CORNERS, BOX_FACES)), scale=[0.1, 0.2, 0.1])
    _, found = read(tmp_path, level)
    assert found.boxes[0][1][1] < 0.05
    assert "too small for a person" in found.boxes_why


def test_a_sky_dome_is_not_the_focus():
    town = np.array([[[x, 0, z], [x + 5, 8, z + 5]] for x in range(0, 100, 10) for z in range(0, 100, 10)], dtype=float)
    sky = np.array([[[-5000, -200, -5000], [5000, 5000, 5000]]], dtype=float)
    low, high = focus_box(np.concatenate([sky, town, sky * 30]))
    np.testing.assert_array_equal([low, high], [[0, 0, 0], [95, 8, 95]])


def test_columns_of_equal_height_are_joined():
    columns = np.array([[[i, 0, k], [i + 1, 1 + (i == 3), k + 1]] for i in range(5) for k in range(4)], dtype=float)
    boxes = np.array(merged_columns(columns[np.random.default_rng(0).permutation(20)]))
    assert len(boxes) == 3
    volume = lambda b: np.prod(b[:, 1] - b[:, 0], axis=1).sum()  # noqa: E731
    assert volume(boxes) == volume(columns)
