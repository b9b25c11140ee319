"""Levels as they come: made-up twins of the development scenes, with what is derived for them, up to the placement."""

import numpy as np
import pytest
from farfield.scene.read import inspect_scene, read_scene
from farfield.scene.write import write_glb
from farfield.settings import from_mapping
from farfield.stability.run import run
from farfield.stages import Stage
from levels import BOX_CORNERS, BOX_FACES, Gltf
from relations import edited

QUICK = {"camera": {"width": 320, "height": 180}, "visibility": {"mode": "off"}, "view_space": {"interval_deg": 22.5}}


def quick(**more):
    """Return settings with view space and cell derived, unless `more` says otherwise, and coarse intervals."""
    values = {**QUICK, **more}
    values["view_space"] = QUICK["view_space"] | more.get("view_space", {})
    return from_mapping(values)


def write(tmp_path, level):
    (tmp_path / "scene.glb").write_bytes(level.glb())
    return tmp_path / "scene.glb"


def solved(found, *, hopeless_share=0.0):
    """Hold that every view meets its target, and that no more than a share of them had to be given up."""
    views, placed, scene = found.get(Stage.VIEWSPACE), found.get(Stage.PLACEMENT), found.get(Stage.SCENE)
    assert len(views.cell) > 0, "nothing to solve: the test shows nothing"
    assert (placed.view_cost <= placed.view_target).all()
    assert placed.hopeless.mean() <= hopeless_share
    assert len(placed.cluster) > 0
    for h in range(len(placed.culprit_row) - 1):
        assert placed.culprit_row[h] < placed.culprit_row[h + 1], "a hopeless view names who is to blame"
    assert scene.n_objects >= placed.culprit.max(initial=0)
    return placed


def plain(level, side, y=0.0):
    corners = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], np.float32) * side / 2 + np.float32([0, y, 0])
    return level.mesh(level.primitive(corners, np.array([0, 2, 1, 0, 3, 2], np.uint16)))


def town(n=120, side=300.0, seed=0, triangles=12):
    """Houses on a plain, thinly around the middle where nobody stands in a house."""
    rng = np.random.default_rng(seed)
    level = Gltf()
    level.node(name="plain", mesh=plain(level, side))
    house = level.mesh(level.primitive(BOX_CORNERS, np.tile(BOX_FACES, (triangles // 12, 1))))
    for i in range(n):
        x, z = (rng.uniform(-0.48, 0.48, 2) * side).tolist()
        level.node(name=f"house {i}", mesh=house, translation=[x, 0, z], scale=rng.uniform(4, 10, 3).tolist())
    return level


def under(level, **node):
    """Put all nodes of a level under one that turns, scales or moves them."""
    roots = level.document["scenes"][0]["nodes"]
    level.document["scenes"][0]["nodes"] = []
    level.node(children=roots, **node)
    return level


def test_a_town_over_terrain_that_is_larger_than_the_view_space(tmp_path):
    found = run(write(tmp_path, town()), quick(budget="80 calls", view_space={"cell_m": 64.0}))
    solved(found)
    views = found.get(Stage.SCENE).view_boxes
    assert (found.get(Stage.SCENE).object_box[:, 1] - found.get(Stage.SCENE).object_box[:, 0]).max() >= 300
    assert views[:, 0, 1].min() == pytest.approx(1.5) and views[:, 1, 1].max() == pytest.approx(1.8)


def test_a_budget_of_triangles_works_as_one_of_calls(tmp_path):
    path = write(tmp_path, town(triangles=240))
    space = {"cell_m": 64.0}
    by_calls = solved(run(path, quick(budget="80 calls", view_space=space)))
    by_triangles = solved(run(path, quick(budget=f"{80 * 240} triangles", view_space=space)))
    # An impostor of one house saves 236 of its 240 triangles, and no call: that one takes several houses.
    assert by_triangles.bytes.sum() < by_calls.bytes.sum()


def test_a_city_in_one_mesh_meets_a_budget_of_triangles(tmp_path):
    rng = np.random.default_rng(1)
    low = rng.uniform(-200, 200, (4000, 3)) * [1, 0, 1]
    corner = np.concatenate([BOX_CORNERS[BOX_FACES].reshape(-1, 3) * rng.uniform(2, 9, 3) + p for p in low])
    level = Gltf()
    index = np.arange(len(corner), dtype=np.uint32).reshape(-1, 3)
    level.node(name="city", mesh=level.mesh(level.primitive(corner.astype(np.float32), index)))
    space = {"cell_m": 16.0, "boxes": [[[-16, 15, -16], [16, 16, 16]]]}
    path = write(tmp_path, level)
    found = run(path, quick(budget="16000 triangles", view_space=space, scene={"split_triangles": 256}))
    solved(found)
    assert found.get(Stage.SCENE).n_objects > 60
    assert any("'city' is" in w for w in found.get(Stage.SCENE).warnings)


def test_the_same_level_in_millimetres_on_its_side_and_far_from_its_origin(tmp_path):
    settings = {"budget": "80 calls", "view_space": {"cell_m": 64.0}}
    here = run(write(tmp_path, town()), quick(**settings), until=Stage.VIEWSPACE).get(Stage.VIEWSPACE)
    half = float(np.sqrt(0.5))
    guises = [
        ({"scale": [1000.0] * 3}, {"unit_m": 0.001, "up": "y"}, 0.02),
        ({"rotation": [half, 0, 0, half]}, {"up": "z"}, 0.02),
        ({"rotation": [half, 0, 0, half], "translation": [84_992.0, 447_488.0, 0.0]}, {"up": "z"}, 0.1),
        ({"translation": [9_999_872.0, 0.0, -9_999_872.0]}, {"up": "y"}, 0.1),
    ]
    for node, scene, apart in guises:
        path = write(tmp_path, under(town(), **node))
        found = run(path, quick(**settings, scene=scene), until=Stage.VIEWSPACE)
        views = found.get(Stage.VIEWSPACE)
        assert len(views.cell) == pytest.approx(len(here.cell), rel=apart), node
        assert found.get(Stage.SCENE).warnings == ()
        assert np.abs(found.get(Stage.SCENE).object_box).max() < 600


def test_positions_in_steps_that_show_are_warned_of(tmp_path):
    level = Gltf()
    rng = np.random.default_rng(0)
    for p in rng.uniform(0, 300, (30, 3)) * [1, 0, 1]:
        level.node(mesh=level.mesh(level.primitive(BOX_CORNERS * 9 + p + [1e7, 0, 1e7], BOX_FACES)))
    s = read_scene(write(tmp_path, level), settings=quick())
    assert any("32-bit numbers, in steps of 1 m" in w for w in s.warnings)


def test_a_toy_city_of_instances(tmp_path):
    """A tile a unit: nobody of 1.65 m stands in it, and every cell is a fraction of a unit."""
    level = Gltf()
    rng = np.random.default_rng(5)
    kinds = []
    for k in range(6):
        corner = np.concatenate([BOX_CORNERS * [0.95, 0.05, 0.95], BOX_CORNERS * [0.4, 0.3 + 0.2 * k, 0.4] + 0.2])
        kinds.append(level.mesh(level.primitive(corner, np.concatenate([BOX_FACES, BOX_FACES + 8]))))
    for x in range(11):
        for z in range(11):
            level.node(mesh=kinds[rng.integers(6)], translation=[float(x), 0.0, float(z)])
    path = write(tmp_path, level)
    _, found = inspect_scene(path, settings=quick())
    assert "too small for a person" in found.boxes_why and found.cell_m == 0.25
    placed = run(path, quick(budget="60 calls", view_space={"cell_m": 2.0}))
    solved(placed, hopeless_share=0.2)
    assert placed.get(Stage.SCENE).n_objects == 121
    assert len(placed.get(Stage.SCENE).mesh_primitive) <= 7


def flat(parts=30):
    """A furnished room in one node: a primitive a material, all of it around the camera, some of it glass."""
    rng = np.random.default_rng(7)
    level = Gltf()
    primitives = []
    for k in range(parts):
        alpha = {"alphaMode": "BLEND"} if k == 3 else {}
        level.add("materials", {"name": f"m{k}", **alpha, "doubleSided": True})
        spots = rng.uniform(0, 1, (60, 3)) * [10, 2.4, 8]
        corner = np.concatenate([BOX_CORNERS * rng.uniform(0.02, 0.2, 3) + p for p in spots])
        index = np.concatenate([BOX_FACES.astype(np.uint32) + 8 * i for i in range(60)])
        primitives.append(level.primitive(corner, index, material=k))
    shell = np.array([[0, 0, 0], [10, 0, 0], [10, 0, 8], [0, 0, 8]], np.float32)
    primitives.append(level.primitive(shell, np.array([0, 2, 1, 0, 3, 2], np.uint16), material=0))
    level.node(name="flat", mesh=level.mesh(*primitives))
    return level


def test_a_furnished_flat_in_one_node(tmp_path):
    path = write(tmp_path, flat())
    s, found = inspect_scene(path, settings=quick())
    assert s.n_objects == 30 and (s.object_calls == 1).all()
    assert (~s.object_replaceable).sum() == 1
    assert "1.5 to 1.8 m above the ground" in found.boxes_why and found.cell_m == 0.25
    # Everything surrounds the camera: no impostor is valid, and the report has to say so instead of giving up.
    placed = run(path, quick(budget="20 calls", view_space={"cell_m": 2.0}))
    views = placed.get(Stage.PLACEMENT)
    assert views.hopeless.any() and len(views.culprit) > 0
    assert views.smallest_budget > 20
    assert (views.view_cost[~views.hopeless] <= 20).all()


def test_what_was_written_is_placed_alike(tmp_path):
    path = write(tmp_path, town(60))
    settings = quick(budget="45 calls", view_space={"cell_m": 64.0})
    first = run(path, settings)
    solved(first)
    (tmp_path / "again.glb").write_bytes(edited(write_glb(first.get(Stage.SCENE)), lambda document: None))
    assert run(tmp_path / "again.glb", settings).artifacts[Stage.PLACEMENT] == first.artifacts[Stage.PLACEMENT]
