"""Scenes of a few rectangles with materials and textures, and placements made by hand, for tests of the bake."""

import dataclasses
import io

import numpy as np
from farfield.placement.model import Placement
from farfield.scene.model import OPAQUE, Scene
from PIL import Image


@dataclasses.dataclass(frozen=True, kw_only=True)
class Panel:
    """A parallelogram low + [0, 1] u + [0, 1] v, counter-clockwise seen from u x v; texture (0, 1) at low."""

    low: tuple[float, float, float]
    u: tuple[float, float, float]
    v: tuple[float, float, float]
    material: int = 0


def panel_scene(
    panels: list[Panel],
    *,
    base_color: list[tuple[float, float, float, float]] | None = None,
    alpha_mode: list[int] | None = None,
    double_sided: list[bool] | None = None,
    texture: list[int] | None = None,
    images: list[np.ndarray] | None = None,
    linear: bool = True,
) -> Scene:
    """Return a Scene of one object a panel, in the given order; one entry a material in the lists."""
    colors = base_color or [(0.8, 0.8, 0.8, 1.0)]
    n, k = len(panels), len(colors)
    position, normal = [], []
    for p in panels:
        low, u, v = (np.array(x, float) for x in (p.low, p.u, p.v))
        position.append([low, low + u, low + u + v, low + v])
        across = np.cross(u, v)
        normal.append([across / np.linalg.norm(across)] * 4)
    corners = np.array(position).astype(np.float32)
    files = []
    for image in images or []:
        data = io.BytesIO()
        Image.fromarray(image).save(data, "PNG")
        files.append(np.frombuffer(data.getvalue(), np.uint8))
    matrix = np.zeros((n, 3, 4))
    matrix[:, :, :3] = np.eye(3)
    row = np.arange(n + 1, dtype=np.int64)
    return Scene(
        origin_m=np.zeros(3), cell_m=4.0, view_boxes=np.array([[[-2.0, 0, -2], [2, 2, 2]]]),
        position=corners.reshape(-1, 3), normal=np.array(normal, np.float32).reshape(-1, 3),
        uv=np.tile(np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32), (n, 1)), color=np.ones((4 * n, 4),
        np.float32), index=np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * i for i in
        range(n)]).astype(np.int32), primitive_triangle=2 * row, primitive_vertex=4 * row,
        primitive_material=np.array([p.material for p in panels], np.int32), mesh_primitive=row,
        object_mesh=np.arange(n, dtype=np.int32), object_matrix=matrix, object_box=np.stack([corners.min(1),
        corners.max(1)], 1).astype(np.float64), object_triangles=np.full(n, 2, np.int64), object_calls=np.ones(n,
        np.int64), object_bytes=np.full(n, 168, np.int64), object_replaceable=np.ones(n, bool),
        object_name=tuple(f"panel {i}" for i in range(n)), material_base_color=np.array(colors, np.float32),
        material_emissive=np.zeros((k, 3), np.float32), material_alpha_mode=np.array(alpha_mode or [OPAQUE] * k,
        np.uint8), material_alpha_cutoff=np.full(k, 0.5, np.float32), material_double_sided=np.array(double_sided or
        [True] * k), material_texture=np.array(texture or [-1] * k, np.int32), material_name=tuple(f"material {i}" for i
        in range(k)), texture_byte=np.concatenate([[0], np.cumsum([len(f) for f in files])]).astype(np.int64),
        texture_data=np.concatenate(files) if files else np.zeros(0, np.uint8),
        texture_wrap=np.full((len(files), 2), 10497, np.int32), texture_linear=np.full(len(files), linear),
        texture_smooth=np.full(len(files), linear), emissive_uv=np.zeros((0, 2), np.float32),
        object_look=np.zeros(n, np.uint8), material_unlit=np.zeros(k, bool),
        material_emissive_texture=np.full(k, -1, np.int32),
        dropped_triangles=0, warnings=(),
    )  # fmt: skip


def chosen(clusters: list[int], kind: int, view_cells: np.ndarray, sizes: list[int] | None = None) -> Placement:
    """Return a Placement of these impostors that serves no view: what the bake reads, and nothing else."""
    n, none = len(clusters), np.zeros(0, np.int64)
    return Placement(
        cluster=np.array(clusters, np.int32), kind=np.full(n, kind, np.uint8),
        view_cell=np.broadcast_to(np.asarray(view_cells, float).reshape(-1, 9), (n, 9)).copy(),
        bytes=np.array(sizes or [1 << 20] * n, np.int64), layers=np.ones(n, np.int32), cost=np.ones(n, np.int64),
        serve_row=np.zeros(1, np.int64), serve=np.zeros(0, np.int32), view_cost=none, view_target=none, view_best=none,
        hopeless=np.zeros(0, bool), culprit_row=np.zeros(1, np.int64), culprit=np.zeros(0, np.int32), smallest_budget=0,
        curve_budget=none, curve_bytes=none, curve_over=none, stopped=False,
    )  # fmt: skip


def box_cell(low: tuple[float, float, float], high: tuple[float, float, float]) -> np.ndarray:
    """Return the view_cell columns of a BOX."""
    return np.array([*low, *high, 0, 0, 0], float)


def field(n):
    """Return a scene of one object: a rough height field of 2 n^2 triangles, 40 m to 60 m away."""
    flat = panel_scene([Panel(low=(-10.0, 0.0, -40.0), u=(20.0, 0.0, 0.0), v=(0.0, 0.0, -20.0))])
    x, z = np.meshgrid(np.linspace(-10, 10, n + 1), np.linspace(-40, -60, n + 1))
    y = np.random.default_rng(1).uniform(-1, 1, x.shape) + (-40 - z) / 4
    position = np.stack([x, y, z], -1).reshape(-1, 3).astype(np.float32)
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1)
    index = np.stack([first, first + 1, first + n + 2, first, first + n + 2, first + n + 1], 1).reshape(-1, 3)
    up = np.tile(np.array([0, 1, 0], np.float32), (len(position), 1))
    return dataclasses.replace(
        flat, position=position, normal=up, uv=np.zeros((len(position), 2), np.float32),
        color=np.ones((len(position), 4), np.float32), index=index.astype(np.int32),
        primitive_triangle=np.array([0, len(index)]), primitive_vertex=np.array([0, len(position)]),
        object_triangles=np.array([len(index)]),
        object_box=np.array([[position.min(0), position.max(0)]], np.float64), material_double_sided=np.ones(1, bool),
    )  # fmt: skip
