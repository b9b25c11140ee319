import numpy as np
import pytest
from farfield.errors import SettingsInvalid
from farfield.geometry.cells import build_cells, find_cell
from farfield.scene.derive import focus_box, hull_rows, merged_columns
from farfield.scene.describe import describe
from farfield.scene.read import inspect_scene
from farfield.settings import SceneSettings, Settings, ViewSpaceSettings
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


def test_ground_that_jumps_has_a_band_at_each_height_and_none_between(tmp_path):
    """A roof of 40 m in the middle of a plain, without walls or floor below: nobody stands in the air at its edge."""
    level = Gltf()
    h = np.float32(256)
    ring = np.array([[-h, 0, -h], [h, 0, -h], [h, 0, h], [-h, 0, h]]) * 1.0
    inner = ring / 4
    ring_faces = [[i, (i + 1) % 4 + 4, (i + 1) % 4] for i in range(4)] + [[i, i + 4, (i + 1) % 4 + 4] for i in range(4)]
    plain = level.primitive(np.concatenate([ring, inner]), np.array(ring_faces, np.uint16))
    level.node(mesh=level.mesh(plain))
    roof = (inner * 1.01 + [0, 40, 0]).astype(np.float32)
    level.node(mesh=level.mesh(level.primitive(roof, np.array([0, 2, 1, 0, 3, 2], np.uint16))))
    s, found = read(tmp_path, level)
    boxes = np.array(found.boxes)
    np.testing.assert_allclose(boxes[:, 1, 1] - boxes[:, 0, 1], 0.3)
    assert sorted(set(boxes[:, 0, 1].tolist())) == [1.5, 41.5]
    assert build_cells(s.view_boxes, s.cell_m).n_cells < 1.3 * 64 * 64


def test_many_levels_take_larger_cells(tmp_path):
    """Ground of 1 m squares at eight heights: nearly four bands in each of 4,096 columns of 2 m."""
    level = Gltf()
    rng = np.random.default_rng(0)
    x, z = (a.reshape(-1) for a in np.meshgrid(np.arange(128.0), np.arange(128.0)))
    low = np.stack([x, 20.0 * rng.integers(0, 8, len(x)), z], 1)
    corner = (low[:, None] + np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]])).reshape(-1, 3)
    index = (4 * np.arange(len(x), dtype=np.uint32)[:, None] + np.array([0, 2, 1, 0, 3, 2], np.uint32)).reshape(-1, 3)
    level.node(mesh=level.mesh(level.primitive(corner, index)))
    s, found = read(tmp_path, level)
    assert found.cell_m > 2.0 and "the ground has several levels" in found.cell_why
    assert build_cells(s.view_boxes, s.cell_m).n_cells < 6000


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


def test_a_level_that_stands_askew_has_its_ground_all_the_same(tmp_path):
    """A strip of 600 x 60 m at 30 degrees fills a seventh of its box."""
    level = Gltf()
    corners = np.array([[-300, 0, -30], [300, 0, -30], [300, 0, 30], [-300, 0, 30]], np.float32)
    turn = [0, np.sin(np.pi / 12), 0, np.cos(np.pi / 12)]
    level.node(mesh=level.mesh(level.primitive(corners, np.array([0, 2, 1, 0, 3, 2], np.uint16))), rotation=turn)
    house = level.mesh(level.primitive(BOX_CORNERS, BOX_FACES))
    for i in range(40):
        level.node(mesh=house, translation=[(i - 20) * 12.0, 0, -(i - 20) * 7.0], scale=[6, 9, 6])
    _, found = read(tmp_path, level)
    assert "ground, which lies under" in found.boxes_why
    assert len(found.boxes) > 5


def test_roofs_without_a_terrain_are_no_ground(tmp_path):
    level = Gltf()
    house = level.mesh(level.primitive(BOX_CORNERS, BOX_FACES))
    for x in range(8):
        for z in range(8):
            level.node(mesh=house, translation=[30.0 * x, 0, 30.0 * z], scale=[12, 9, 12])
    _, found = read(tmp_path, level)
    assert "whole box" in found.boxes_why


def test_hull_rows_hold_what_a_hull_holds():
    rng = np.random.default_rng(4)
    for _ in range(50):
        n = int(rng.integers(3, 40))
        points = np.stack([rng.integers(0, 30, n), rng.uniform(-5, 25, n)], 1)
        reach = np.stack([np.full(30, np.inf), np.full(30, -np.inf)], 1)
        for row, z in points:
            reach[int(row)] = [min(reach[int(row), 0], z), max(reach[int(row), 1], z)]
        inside = hull_rows(reach, z0=-10.0, step=0.5, n=80)
        for i in range(30):
            for k in range(80):
                p = np.array([i, -10.0 + 0.5 * k])
                assert (inside[i, 0] <= k < inside[i, 1]) == _in_hull(p, points), (i, k)


def _in_hull(p, points):
    """No line through p has all points strictly on one side."""
    angle = np.arctan2(points[:, 1] - p[1], points[:, 0] - p[0])
    if (points == p).all(1).any():
        return True
    turned = np.sort(angle)
    gaps = np.diff(np.append(turned, turned[0] + 2 * np.pi))
    return bool(gaps.max() <= np.pi + 1e-9)


def side_by_side(scale=1.0, up="y"):
    """Forty houses on a plain of 400 m, in other units, or lying on its side."""
    level = ground_and_houses(400.0)
    for node in level.document["nodes"]:
        node["name"] = node.get("name", "")
    half = np.sqrt(0.5)
    root = {"children": list(range(len(level.document["nodes"]))), "scale": [scale] * 3}
    if up == "z":  # y up is turned to z up
        root["rotation"] = [half, 0, 0, half]
    level.document["scenes"][0]["nodes"] = []
    level.node(**root)
    return level


def test_a_level_in_millimetres_or_on_its_side_is_hinted_at(tmp_path):
    s, found = read(tmp_path, side_by_side())
    assert found.hints == () and s.warnings == ()
    s, _ = read(tmp_path, side_by_side(scale=1000.0))
    assert any("set scene.unit_m: 0.001 for millimetres" in w for w in s.warnings)
    s, _ = read(tmp_path, side_by_side(up="z"))
    assert any('set scene.up = "z"' in w and "deep" in w for w in s.warnings)
    for scale, up in ((1000.0, "y"), (1.0, "z")):
        (tmp_path / "b.glb").write_bytes(side_by_side(scale=scale, up=up).glb())
        right = Settings(scene=SceneSettings(unit_m=1 / scale, up=up))
        s, mended = inspect_scene(tmp_path / "b.glb", settings=right)
        assert s.warnings == ()
        assert "band 1.5 to 1.8 m above the ground" in mended.boxes_why
        assert mended.cell_m == 8.0


def test_budgets_are_those_of_the_level_as_it_is_drawn(tmp_path):
    """A city in one mesh is no budget of one call: it is split first."""
    level = Gltf()
    rng = np.random.default_rng(0)
    parts = np.concatenate([BOX_CORNERS[BOX_FACES].reshape(-1, 3) * 9 + p for p in rng.uniform(-300, 300, (2000, 3))])
    index = np.arange(len(parts), dtype=np.uint32).reshape(-1, 3)
    level.node(name="city", mesh=level.mesh(level.primitive(parts, index)))
    s, found = read(tmp_path, level, cell_m=16.0)
    calls, triangles = (int(b.split()[0]) for b in found.budgets[:2])
    assert 1 < calls < s.n_objects and triangles < 0.4 * s.object_triangles.sum() + 1


def test_inspect_says_how_much_work_there_is(tmp_path):
    s, found = read(tmp_path, ground_and_houses(512.0))
    work = describe(s, found)["suggested"]["work"]
    assert work["cells"] == build_cells(s.view_boxes, s.cell_m).n_cells
    assert work["views"] == work["cells"] * 384
    assert work["seconds"] == pytest.approx(work["views"] * (5e-6 + 41 * 2.5e-8), rel=0.05)


def test_columns_of_equal_height_are_joined():
    columns = np.array([[[i, 0, k], [i + 1, 1 + (i == 3), k + 1]] for i in range(5) for k in range(4)], dtype=float)
    boxes = np.array(merged_columns(columns[np.random.default_rng(0).permutation(20)]))
    assert len(boxes) == 3
    volume = lambda b: np.prod(b[:, 1] - b[:, 0], axis=1).sum()  # noqa: E731
    assert volume(boxes) == volume(columns)
