import numpy as np
import pytest
from farfield.errors import SceneIndexOutOfRange, SceneNotFinite, SceneUnreadable, SceneUriRefused
from farfield.scene.model import BLEND, MASK
from farfield.scene.polygons import triangulate
from farfield.scene.read import read_scene
from farfield.settings import Settings
from hypothesis import given, settings
from hypothesis import strategies as st
from levels import png

QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def read(tmp_path, text, **files):
    for name, data in files.items():
        (tmp_path / name.replace("_", ".")).write_bytes(data if isinstance(data, bytes) else data.encode())
    (tmp_path / "a.obj").write_text(text)
    return read_scene(tmp_path / "a.obj", settings=Settings())


def area(s):
    c = s.position[s.index].astype(np.float64)
    return np.sqrt((np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]) ** 2).sum(1)).sum() / 2


def test_objects_groups_and_materials(tmp_path):
    text = QUAD + (
        "mtllib a.mtl\no house\nusemtl red\nf 1 2 3\nusemtl blue\nf 1 3 4\ng shed\nf 1 2 4\n"
        "o house\nusemtl red\nf 2 3 4\n"
    )
    s = read(tmp_path, text, a_mtl="newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 0.5\nd 0.5\n")
    assert sorted(s.object_name) == ["house", "house/shed"]
    house, shed = s.object_name.index("house"), s.object_name.index("house/shed")
    assert (s.object_calls[house], s.object_triangles[house]) == (2, 3)
    assert (s.object_calls[shed], s.object_triangles[shed]) == (1, 1)
    blue = s.material_name.index("blue")
    np.testing.assert_allclose(s.material_base_color[blue], [0, 0, 0.21404, 0.5], atol=1e-5)
    assert s.material_alpha_mode[blue] == BLEND
    assert not s.object_replaceable.any()


def test_textures_options_and_mask(tmp_path):
    text = "mtllib a.mtl\nusemtl t\n" + QUAD + "vt 0 0\nvt 1 0\nvt 1 1\nf 1/1 2/2 3/3\n"
    mtl = "newmtl t\nmap_Kd -s 2 4 -o 0.5 0.25 -clamp on a.png\nmap_d a.png\nKd 0 0 0\n"
    s = read(tmp_path, text, a_mtl=mtl, a_png=png())
    found = {tuple(p): tuple(u) for p, u in zip(s.position[:, :2].tolist(), s.uv.tolist())}
    assert found == {(0, 0): (0.5, 0.75), (1, 0): (2.5, 0.75), (1, 1): (2.5, -3.25)}
    assert s.texture_wrap.tolist() == [[33071, 33071]]
    assert s.material_alpha_mode.tolist() == [MASK]
    assert s.material_base_color.tolist() == [[1, 1, 1, 1]]


def test_indices_from_the_end_and_mixed_corners(tmp_path):
    s = read(tmp_path, QUAD + "vn 0 0 1\nf -4//1 -3//-1 -2//1\nf 1 3 4\n")
    assert s.object_triangles.tolist() == [2]
    np.testing.assert_array_equal(s.normal, [[0, 0, 1]] * 4)


def test_vertex_colours_are_srgb(tmp_path):
    s = read(tmp_path, "v 0 0 0 1 0.5 0\nv 1 0 0 1 0.5 0\nv 0 1 0 1 0.5 0\nf 1 2 3\n")
    np.testing.assert_allclose(s.color, [[1, 0.21404, 0, 1]] * 3, atol=1e-5)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (QUAD + "f 1 2 5\n", SceneIndexOutOfRange),
        (QUAD + "f 1 2 -5\n", SceneIndexOutOfRange),
        (QUAD + "f 1 2 0\n", SceneIndexOutOfRange),
        (QUAD + "f 1 2 x\n", SceneUnreadable),
        (QUAD + "f 1 2 /3\n", SceneUnreadable),
        ("v 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", SceneUnreadable),
        ("v 0 0 a\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", SceneUnreadable),
        ("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", SceneNotFinite),
        ("mtllib ../a.mtl\n" + QUAD + "f 1 2 3\n", SceneUriRefused),
        ("mtllib http://a/b.mtl\n" + QUAD + "f 1 2 3\n", SceneUriRefused),
    ],
)
def test_refused(tmp_path, text, error):
    with pytest.raises(error):
        read(tmp_path, text)


@pytest.mark.parametrize("name", ["../a.png", "/a.png", "C:/a.png", "https://a/b.png"])
def test_textures_outside_are_refused(tmp_path, name):
    with pytest.raises(SceneUriRefused):
        read(tmp_path, "mtllib a.mtl\nusemtl t\n" + QUAD + "f 1 2 3\n", a_mtl=f"newmtl t\nmap_Kd {name}\n")


def test_missing_files_are_warnings(tmp_path):
    s = read(tmp_path, "mtllib gone.mtl\nusemtl t\n" + QUAD + "f 1 2 3\n")
    assert len(s.warnings) == 2
    s = read(tmp_path, "mtllib a.mtl\nusemtl t\n" + QUAD + "f 1 2 3\n", a_mtl="newmtl t\nmap_Kd gone.png\nKd 1 1 1\n")
    assert any("gone.png" in w for w in s.warnings)


def test_national_grid_coordinates_lose_nothing_that_matters(tmp_path):
    rows = "".join(f"v {84600.123 + x} {447400.456 + y} {z}\n" for x, y, z in [(0, 0, 0), (0.001, 0, 0), (0, 0.001, 0)])
    s = read(tmp_path, rows + "f 1 2 3\n")
    np.testing.assert_allclose(area(s), 0.5e-6, rtol=1e-4)


def star(n, seed):
    """A simple polygon around the origin in a tilted plane, and its area."""
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, n))
    while np.diff(np.append(angle, angle[0] + 2 * np.pi)).max() > 3.0:
        angle = np.sort(rng.uniform(0, 2 * np.pi, n))
    radius = rng.uniform(0.2, 1.0, n)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    size = 0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()
    return np.stack([x, y, 0.3 * x - 0.7 * y], 1), size


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32), n=st.integers(5, 14))
def test_polygons_are_covered_once(seed, n):
    points, size = star(n, seed)
    triangle, owner = triangulate(points, np.arange(n), np.array([n]))
    assert len(triangle) == n - 2
    assert not owner.any()
    c = points[triangle]
    signed = 0.5 * np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0])[:, 2]
    assert (signed >= -1e-12).all()  # none is turned over, and together they are the polygon
    np.testing.assert_allclose(signed.sum(), size, rtol=1e-9)


def test_polygons_of_mixed_sizes_keep_their_order():
    points = np.random.default_rng(0).normal(size=(12, 3))
    _, owner = triangulate(points, np.arange(12), np.array([3, 2, 4, 3]))
    assert owner.tolist() == [0, 2, 2, 3]
