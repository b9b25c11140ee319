"""Made-up Scenes from a list of meshes, for tests of occlusion: blocks, walls, sheets, each an object of its own."""

from itertools import pairwise

import numpy as np
from farfield.scene.model import Scene

_SIDES = {
    "floor": [[0, 1, 5], [0, 5, 4]],
    "roof": [[2, 6, 7], [2, 7, 3]],
    "walls": [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]],
}


def block(low, high, *, turn=0.0, without=()):
    """Return (position (8,3) f32, index (T,3)) of a box, turned about y by `turn` radians, fronts outwards."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * (high - low) + low
    return turned(corner, turn), np.array(
        [f[::-1] for name, faces in _SIDES.items() if name not in without for f in faces], dtype=np.int32
    )


def sheet(*corners):
    """Return one convex polygon as a fan."""
    n = len(corners)
    return np.array(corners, dtype=np.float32), np.array([[0, k, k + 1] for k in range(1, n - 1)], dtype=np.int32)


def turned(points, turn):
    c, s = np.cos(turn), np.sin(turn)
    x, y, z = np.asarray(points, float).T
    return np.stack([c * x + s * z, y, c * z - s * x], 1).astype(np.float32)


def scene(meshes, *, view, cell_m, double_sided=True, matrix=None, alpha=None, scale=1.0):
    """Return a Scene with an object a mesh, in the order given. `matrix` (3,4) f64 places all; alpha: mode of each."""
    n = len(meshes)
    m = np.concatenate([np.eye(3), np.zeros((3, 1))], 1) if matrix is None else np.asarray(matrix, float)
    m = np.concatenate([m[:, :3], m[:, 3:] * scale], 1)
    position = np.concatenate([p for p, _ in meshes]).astype(np.float32) * np.float32(scale)
    vertex = np.concatenate([[0], np.cumsum([len(p) for p, _ in meshes])]).astype(np.int64)
    triangle = np.concatenate([[0], np.cumsum([len(i) for _, i in meshes])]).astype(np.int64)
    index = np.concatenate([i + v for (_, i), v in zip(meshes, vertex, strict=False)]).astype(np.int32)
    placed = np.stack([((m[a, 0] * position[:, 0].astype(float) + m[a, 1] * position[:, 1].astype(float))
                        + m[a, 2] * position[:, 2].astype(float)) + m[a, 3] for a in range(3)], 1)  # fmt: skip
    boxes = np.array([[placed[a:b].min(0), placed[a:b].max(0)] for a, b in pairwise(vertex)])
    counts = np.diff(triangle)
    modes = np.zeros(n, np.uint8) if alpha is None else np.array(alpha, np.uint8)
    return Scene(
        origin_m=np.zeros(3), cell_m=cell_m * scale, view_boxes=np.asarray(view, float).reshape(-1, 2, 3) * scale,
        position=position, normal=np.tile(np.array([[0, 1, 0]], np.float32), (len(position), 1)),
        uv=np.zeros((len(position), 2), np.float32), color=np.ones((len(position), 4), np.float32), index=index,
        primitive_triangle=triangle, primitive_vertex=vertex, primitive_material=np.arange(n, dtype=np.int32),
        mesh_primitive=np.arange(n + 1, dtype=np.int64), object_mesh=np.arange(n, dtype=np.int32),
        object_matrix=np.tile(m, (n, 1, 1)), object_box=boxes, object_triangles=counts,
        object_calls=np.ones(n, np.int64), object_bytes=36 * np.diff(vertex) + 12 * counts,
        object_replaceable=np.ones(n, bool), object_name=tuple(f"object {i}" for i in range(n)),
        material_base_color=np.ones((n, 4), np.float32), material_emissive=np.zeros((n, 3), np.float32),
        emissive_uv=np.zeros((0, 2), np.float32), object_look=np.zeros(n, np.uint8), material_unlit=np.zeros(n, bool),
        material_emissive_texture=np.full(n, -1, np.int32), texture_smooth=np.zeros(0, bool),
        material_alpha_mode=modes, material_alpha_cutoff=np.full(n, 0.5, np.float32),
        material_double_sided=np.full(n, double_sided) if np.isscalar(double_sided) else np.array(double_sided),
        material_texture=np.full(n, -1, np.int32), material_name=tuple(f"m{i}" for i in range(n)),
        texture_byte=np.zeros(1, np.int64), texture_data=np.zeros(0, np.uint8), texture_wrap=np.zeros((0, 2), np.int32),
        texture_linear=np.zeros(0, bool), dropped_triangles=0, warnings=(),
    )  # fmt: skip
