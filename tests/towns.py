"""A small made-up town as a Scene, for tests that need objects rather than a file: boxes on streets, seeded."""

import numpy as np
from farfield.scene.model import Scene
from farfield.scene.order import object_order

_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]], dtype=np.int32)  # fmt: skip


def town(
    n: int = 400,
    *,
    seed: int = 0,
    block_m: float = 12.0,
    cell_m: float = 16.0,
    view_m: float = 64.0,
    triangles: int = 12,
) -> Scene:
    """Return a Scene of n axis-aligned houses on a square raster of blocks, the view space a 2 m band over its middle.

    `triangles` a house is 12 times a whole number: the twelve faces repeated, so that triangle budgets have something
    to spend on.
    """
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(n)))
    raster = np.stack(np.meshgrid(np.arange(side), np.arange(side), indexing="ij"), -1).reshape(-1, 2)[:n]
    size = np.stack([rng.uniform(4, 8, n), rng.uniform(4, 25, n), rng.uniform(4, 8, n)], -1)
    low = np.zeros((n, 3))
    low[:, [0, 2]] = (raster - side / 2) * block_m + rng.uniform(0, 3, (n, 2))
    ones = np.ones(n, dtype=np.int64)
    boxes = np.stack([low, low + size.astype(np.float32)], 1)
    order = object_order(boxes, triangles=ones, calls=ones, origin_m=np.zeros(3), cell_m=cell_m)
    low, size = low[order], size[order]
    faces = np.tile(_FACES, (max(1, triangles // 12), 1))
    position = np.concatenate([_CORNERS * s for s in size]).astype(np.float32)
    index = np.concatenate([faces + 8 * i for i in range(n)]).astype(np.int32)
    normal = np.tile(((_CORNERS - 0.5) / np.sqrt(0.75)).astype(np.float32), (n, 1))
    matrix = np.zeros((n, 3, 4))
    matrix[:, :, :3], matrix[:, :, 3] = np.eye(3), low
    corners = position.reshape(n, 8, 3).astype(np.float64) + low[:, None]
    t = np.full(n, len(faces), dtype=np.int64)
    v = view_m / 2
    return Scene(
        origin_m=np.zeros(3), cell_m=cell_m, view_boxes=np.array([[[-v, 1.0, -v], [v, 3.0, v]]]),
        position=position, normal=normal, uv=np.zeros((8 * n, 2), np.float32), color=np.ones((8 * n, 4), np.float32),
        index=index, primitive_triangle=np.arange(n + 1, dtype=np.int64) * len(faces),
        primitive_vertex=np.arange(n + 1, dtype=np.int64) * 8, primitive_material=np.arange(n, dtype=np.int32) % 3,
        mesh_primitive=np.arange(n + 1, dtype=np.int64), object_mesh=np.arange(n, dtype=np.int32), object_matrix=matrix,
        object_box=np.stack([corners.min(1), corners.max(1)], 1), object_triangles=t, object_calls=np.ones(n, np.int64),
        object_bytes=36 * 8 + 12 * t, object_replaceable=np.ones(n, bool),
        object_name=tuple(f"house {i}" for i in range(n)),
        material_base_color=np.array([[0.8, 0.7, 0.6, 1], [0.6, 0.3, 0.2, 1], [0.5, 0.5, 0.55, 1]], np.float32),
        material_emissive=np.zeros((3, 3), np.float32), emissive_uv=np.zeros((0, 2), np.float32),
        object_look=np.zeros(n, np.uint8), material_unlit=np.zeros(3, bool),
        material_emissive_texture=np.full(3, -1, np.int32), texture_smooth=np.zeros(0, bool),
        material_alpha_mode=np.zeros(3, np.uint8),
        material_alpha_cutoff=np.full(3, 0.5, np.float32), material_double_sided=np.ones(3, bool),
        material_texture=np.full(3, -1, np.int32), material_name=("plaster", "brick", "concrete"),
        texture_byte=np.zeros(1, np.int64), texture_data=np.zeros(0, np.uint8), texture_wrap=np.zeros((0, 2), np.int32),
        texture_linear=np.zeros(0, bool), dropped_triangles=0, warnings=(),
    )  # fmt: skip
