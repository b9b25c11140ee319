import numpy as np
import pytest
from farfield.scene.model import BLEND
from farfield.scene.read import read_scene
from farfield.scene.write import write_glb
from farfield.settings import SceneSettings, Settings, ViewSpaceSettings
from levels import BOX_CORNERS, BOX_FACES, Gltf

CELL_M = 16.0
MIN_TRIANGLES = SceneSettings().split_triangles


def read(path, cell_m=CELL_M, boxes=None, least=MIN_TRIANGLES):
    settings = Settings(
        view_space=ViewSpaceSettings(cell_m=cell_m, boxes=boxes), scene=SceneSettings(split_triangles=least)
    )
    return read_scene(path, settings=settings)


def terrain(n, side_m, *, seed=0):
    """A height field of 2 n^2 triangles, side_m wide, its middle at the origin."""
    rng = np.random.default_rng(seed)
    x, z = np.meshgrid(np.linspace(-0.5, 0.5, n + 1) * side_m, np.linspace(-0.5, 0.5, n + 1) * side_m, indexing="ij")
    position = np.stack([x, rng.uniform(0, 2, x.shape), z], -1).reshape(-1, 3).astype(np.float32)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1)
    index = np.concatenate([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
    return position, index.astype(np.uint32)


def placed_triangles(s):
    """All triangles of all objects in scene metres, as a sorted array (T,9): which object draws them does not count."""
    rows = []
    for o, m in enumerate(s.object_mesh):
        first, last = s.primitive_triangle[s.mesh_primitive[[m, m + 1]]]
        c = s.position[s.index[first:last]].astype(np.float64)
        rows.append((c @ s.object_matrix[o][:, :3].T + s.object_matrix[o][:, 3] + s.origin_m).reshape(-1, 9))
    rows = np.concatenate(rows)
    return rows[np.lexsort(rows.T)]


def test_a_terrain_is_cut_into_compact_objects_of_enough_triangles(tmp_path):
    level = Gltf()
    position, index = terrain(120, 240.0)
    level.node(name="ground", mesh=level.mesh(level.primitive(position, index)), translation=[3, 0, -5])
    level.node(name="house", mesh=level.mesh(level.primitive(BOX_CORNERS, BOX_FACES)))
    (tmp_path / "a.glb").write_bytes(level.glb())
    s, whole = read(tmp_path / "a.glb"), read(tmp_path / "a.glb", cell_m=1000.0)
    assert whole.n_objects == 2
    np.testing.assert_array_equal(placed_triangles(s), placed_triangles(whole))
    pieces = np.array([n.startswith("ground") for n in s.object_name])
    assert 6 < pieces.sum() < 16
    assert (s.object_calls == 1).all()
    assert s.object_triangles[pieces].mean() > MIN_TRIANGLES
    assert s.object_triangles[pieces].min() > MIN_TRIANGLES / 2
    assert (s.object_triangles[pieces] < 2 * MIN_TRIANGLES).all()
    sides = (s.object_box[pieces, 1] - s.object_box[pieces, 0])[:, [0, 2]].max(1)
    assert np.median(sides) < 0.6 * 240
    assert any("'ground'" in w and f"{pieces.sum()} objects" in w for w in s.warnings)
    assert len({s.object_mesh[o] for o in np.flatnonzero(pieces)}) == pieces.sum()


def test_few_triangles_or_small_objects_stay_whole(tmp_path):
    level = Gltf()
    few = terrain(31, 500.0)
    level.node(name="few", mesh=level.mesh(level.primitive(*few)))
    small = terrain(80, 30.0)
    level.node(name="small", mesh=level.mesh(level.primitive(*small)))
    (tmp_path / "a.glb").write_bytes(level.glb())
    s = read(tmp_path / "a.glb")
    assert sorted(s.object_name) == ["few", "small"]
    assert s.warnings == ()


def test_materials_come_apart_first_and_cost_no_call(tmp_path):
    level = Gltf()
    level.add("materials", {"name": "stone"})
    level.add("materials", {"name": "glass", "alphaMode": "BLEND"})
    position, index = terrain(40, 300.0)
    boxes = np.concatenate([BOX_CORNERS + np.float32([30 * i - 100, 5, 0]) for i in range(8)])
    faces = np.concatenate([BOX_FACES + 8 * i for i in range(8)]).astype(np.uint16)
    mesh = level.mesh(level.primitive(position, index, material=0), level.primitive(boxes, faces, material=1))
    level.node(name="level", mesh=mesh)
    (tmp_path / "a.glb").write_bytes(level.glb())
    s = read(tmp_path / "a.glb")
    assert s.n_objects == 2
    assert s.object_calls.tolist() == [1, 1]
    glass = int(np.flatnonzero(~s.object_replaceable)[0])
    assert s.object_triangles[glass] == 96
    assert s.material_alpha_mode[s.primitive_material[s.mesh_primitive[s.object_mesh[glass]]]] == BLEND


def test_components_stay_whole_and_large_triangles_stay_apart(tmp_path):
    level = Gltf()
    rng = np.random.default_rng(2)
    spots = rng.uniform(-200, 200, (800, 3)).astype(np.float32)
    position = np.concatenate([BOX_CORNERS * np.float32(3) + p for p in spots])
    index = np.concatenate([BOX_FACES.astype(np.uint32) + 8 * i for i in range(len(spots))])
    sky = np.array([[-900, 300, -900], [900, 300, -900], [0, 300, 900]], dtype=np.float32)
    position = np.concatenate([position, sky])
    index = np.concatenate([index, [[8 * len(spots) + k for k in range(3)]]]).astype(np.uint32)
    level.node(name="all", mesh=level.mesh(level.primitive(position, index)))
    (tmp_path / "a.glb").write_bytes(level.glb())
    s = read(tmp_path / "a.glb", boxes=(((-8.0, 0.0, -8.0), (8.0, 2.0, 8.0)),))
    assert s.n_objects >= 4
    assert 1 in s.object_triangles.tolist()  # the sky alone
    others = s.object_triangles[s.object_triangles > 1]
    assert (others % 12 == 0).all()  # no box is cut


@pytest.mark.parametrize("offset", [0.0, 8.0, -123.0])
def test_cutting_what_was_cut_changes_nothing(tmp_path, offset):
    level = Gltf()
    position, index = terrain(110, 400.0, seed=3)
    level.node(name="ground", mesh=level.mesh(level.primitive(position, index)), translation=[offset, 0, 0])
    (tmp_path / "a.glb").write_bytes(level.glb())
    first = read(tmp_path / "a.glb")
    (tmp_path / "b.glb").write_bytes(write_glb(first))
    second = read(tmp_path / "b.glb")
    assert first.object_name == second.object_name
    np.testing.assert_array_equal(first.object_triangles, second.object_triangles)
    assert second.warnings == ()


def test_an_instance_that_is_split_leaves_the_others_alone(tmp_path):
    level = Gltf()
    mesh = level.mesh(level.primitive(*terrain(60, 20.0)))
    level.node(name="model", mesh=mesh)
    level.node(name="copy", mesh=mesh, translation=[40, 0, 0])
    level.node(name="giant", mesh=mesh, scale=[20, 20, 20])
    (tmp_path / "a.glb").write_bytes(level.glb())
    s = read(tmp_path / "a.glb")
    by = dict(zip(s.object_name, s.object_mesh.tolist(), strict=True))
    assert by["model"] == by["copy"]
    assert sum(n.startswith("giant [") for n in s.object_name) >= 2


def test_instances_that_are_split_share_their_pieces(tmp_path):
    level = Gltf()
    mesh = level.mesh(level.primitive(*terrain(70, 60.0)))
    for i in range(50):
        turn = [0, np.sin(i), 0, np.cos(i)]
        level.node(name=f"hill {i}", mesh=mesh, translation=[70.0 * i, 0, 3.0 * i], rotation=turn)
    level.node(name="model", mesh=mesh, scale=[0.1, 0.1, 0.1], translation=[0, 20, 0])
    (tmp_path / "a.glb").write_bytes(level.glb())
    s = read(tmp_path / "a.glb")
    whole = read(tmp_path / "a.glb", cell_m=1000.0)
    kinds = {n.rpartition(" [")[2]: set() for n in s.object_name}
    for name, m in zip(s.object_name, s.object_mesh.tolist()):
        kinds[name.rpartition(" [")[2]].add(m)
    assert len(kinds) > 2
    assert all(len(meshes) == 1 for meshes in kinds.values()), "each piece is one mesh, however many instances"
    assert len(s.index) == 2 * len(whole.index), "the whole is kept for the small one, and its pieces once"
    np.testing.assert_array_equal(placed_triangles(s), placed_triangles(whole))
    assert len(write_glb(s)) < 2.2 * len(write_glb(whole))
    (tmp_path / "b.glb").write_bytes(write_glb(s))
    again = read(tmp_path / "b.glb")
    assert again.object_name == s.object_name
    assert sum("hill" in w for w in s.warnings) == 16 and any("34 more objects" in w for w in s.warnings)


def test_thousands_of_instances_stay_instances(tmp_path):
    level = Gltf()
    mesh = level.mesh(level.primitive(*terrain(25, 5.0)))
    rng = np.random.default_rng(0)
    for i, (x, z) in enumerate(rng.uniform(-400, 400, (4000, 2)).tolist()):
        level.node(name=f"tree {i}", mesh=mesh, translation=[x, 0, z])
    (tmp_path / "a.glb").write_bytes(level.glb())
    s = read(tmp_path / "a.glb")
    assert s.n_objects == 4000 and len(s.mesh_primitive) == 2 and len(s.index) == 1250
    assert s.object_triangles.sum() == 5_000_000
    assert len(write_glb(s)) < 4000 * 400 + 100_000


def test_a_level_in_one_mesh_comes_apart_where_it_is_near(tmp_path):
    """A soup without shared vertices, as a power plant's: pipes and thousands of small parts, one material, one node."""
    rng = np.random.default_rng(3)
    parts = rng.uniform(-60, 60, (3000, 3)) * [1, 0.3, 1]
    corner = np.concatenate([BOX_CORNERS[BOX_FACES].reshape(-1, 3) * rng.uniform(0.2, 2, 3) + p for p in parts])
    pipes = np.concatenate(
        [
            BOX_CORNERS[BOX_FACES].reshape(-1, 3) * [120, 0.3, 0.3] + [-60, y, z]
            for y, z in rng.uniform(-18, 18, (40, 2))
        ]
    )
    position = np.concatenate([corner, pipes]).astype(np.float32)
    level = Gltf()
    index = np.arange(len(position), dtype=np.uint32).reshape(-1, 3)
    level.node(name="plant", mesh=level.mesh(level.primitive(position, index)))
    (tmp_path / "a.glb").write_bytes(level.glb())
    space = (((-50.0, 0.0, -50.0), (50.0, 2.0, 50.0)),)
    coarse, fine = (
        read(tmp_path / "a.glb", cell_m=4.0, boxes=space),
        read(tmp_path / "a.glb", cell_m=4.0, boxes=space, least=128),
    )
    assert 8 < coarse.n_objects < 30 < 80 < fine.n_objects < 400
    for s in (coarse, fine):
        assert s.object_triangles.sum() == len(index)
        side = (s.object_box[:, 1] - s.object_box[:, 0]).max(1)
        large = s.object_triangles[side > 100].sum()
        assert large <= 2 * 12 * 40, "the pipes stay in inner nodes, and take nothing small with them"
        assert any("'plant' is" in w for w in s.warnings)
    # A piece may only be large where the level holds few triangles: 128 of them lie within 25 m here.
    side = (fine.object_box[:, 1] - fine.object_box[:, 0]).max(1)
    assert np.median(side) < 30
