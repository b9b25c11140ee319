import numpy as np
import pytest
from farfield.errors import SceneIndexOutOfRange, SceneNotFinite, SceneUnreadable
from farfield.scene.read import read_scene
from farfield.settings import Settings
from levels import BOX_CORNERS, BOX_FACES

QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5]], dtype=np.int32)


def read(tmp_path, data, name):
    (tmp_path / name).write_bytes(data)
    return read_scene(tmp_path / name, settings=Settings())


def header(order, n_faces, *, vertex="", face=""):
    return (
        f"ply\nformat {order} 1.0\ncomment made up\nelement vertex 8\nproperty float x\nproperty float y\n"
        f"property float z\n{vertex}element face {n_faces}\nproperty list uchar int vertex_indices\n{face}end_header\n"
    ).encode()


def ascii_faces(*faces):
    return "".join(f"{len(f)} {' '.join(map(str, f))}\n" for f in faces).encode()


def ascii_vertices(extra=""):
    return "".join(f"{x} {y} {z} {extra}\n" for x, y, z in BOX_CORNERS.tolist()).encode()


@pytest.mark.parametrize("order", ["ascii", "<", ">"])
@pytest.mark.parametrize("mixed", [False, True])
def test_ply(tmp_path, order, mixed):
    faces = [*BOX_FACES[:11].tolist(), *(QUADS.tolist() if mixed else [])]
    if order == "ascii":
        data = header("ascii", len(faces)) + ascii_vertices() + ascii_faces(*faces)
    else:
        data = header("binary_little_endian" if order == "<" else "binary_big_endian", len(faces))
        data += BOX_CORNERS.astype(order + "f4").tobytes()
        data += b"".join(bytes([len(f)]) + np.array(f, order + "i4").tobytes() for f in faces)
    s = read(tmp_path, data, "box.ply")
    assert s.object_name == ("box",)
    assert s.object_triangles.tolist() == [15 if mixed else 11]
    np.testing.assert_array_equal(s.object_box[0] + s.origin_m, [[0, 0, 0], [1, 1, 1]])


def test_ply_colours_of_vertices_and_of_faces(tmp_path):
    rgb = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    data = header("ascii", 1, vertex=rgb) + ascii_vertices("255 128 0") + ascii_faces([0, 1, 3])
    s = read(tmp_path, data, "a.ply")
    np.testing.assert_allclose(s.color, [[1, 0.2158605, 0, 1]] * 3, atol=1e-6)
    faces = b"3 0 1 3 255 0 0\n3 0 3 2 0 255 0\n"
    s = read(tmp_path, header("ascii", 2, face=rgb) + ascii_vertices() + faces, "a.ply")
    assert {tuple(c) for c in s.color.tolist()} == {(1, 0, 0, 1), (0, 1, 0, 1)}
    assert len(s.position) == 6


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (header("ascii", 1) + ascii_vertices() + ascii_faces([0, 1, 8]), SceneIndexOutOfRange),
        (header("ascii", 1) + ascii_vertices() + ascii_faces([0, 1, -1]), SceneIndexOutOfRange),
        (header("ascii", 1) + ascii_vertices().replace(b"1.0", b"nan") + ascii_faces([0, 1, 2]), SceneNotFinite),
        (header("ascii", 10**12) + ascii_vertices() + ascii_faces([0, 1, 2]), SceneUnreadable),
        (header("binary_little_endian", 2**40) + BOX_CORNERS.tobytes(), SceneUnreadable),
        (header("ascii", 1).replace(b"t z", b"t w") + ascii_vertices() + ascii_faces([0, 1, 2]), SceneUnreadable),
        (header("morse", 1), SceneUnreadable),
    ],
)  # fmt: skip
def test_ply_that_is_refused(tmp_path, data, error):
    with pytest.raises(error):
        read(tmp_path, data, "a.ply")


def stl(corners):
    rows = np.zeros(len(corners), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    rows["v"] = corners
    return bytes(80) + len(corners).to_bytes(4, "little") + rows.tobytes()


def test_stl_binary_and_ascii(tmp_path):
    corners = BOX_CORNERS[BOX_FACES]
    s = read(tmp_path, stl(corners), "box.stl")
    assert s.object_triangles.tolist() == [12]
    assert len(s.position) == 24  # corners merged, then split by face
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in t) + "endloop\nendfacet\n"
        for t in corners.tolist()
    )
    t = read(tmp_path, f"solid box\n{facets}endsolid box\n".encode(), "box2.stl")
    np.testing.assert_array_equal(s.position, t.position)
    np.testing.assert_array_equal(s.index, t.index)


def test_the_content_says_what_it_is(tmp_path):
    corners = BOX_CORNERS[BOX_FACES]
    assert read(tmp_path, stl(corners), "blob").object_triangles.tolist() == [12]
    data = header("ascii", 1) + ascii_vertices() + ascii_faces([0, 1, 3])
    assert read(tmp_path, data, "blob").object_triangles.tolist() == [1]
    assert read(tmp_path, b"# an OBJ\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "blob").object_triangles.tolist() == [1]
    for junk in (b"", b"hello", bytes(200), b"PK\x03\x04junk", b"%PDF-1.4 v 1 2 3\0"):
        with pytest.raises(SceneUnreadable):
            read(tmp_path, junk, "blob")
