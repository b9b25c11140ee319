"""Cut the level itself into pages: what a viewer fetches where it is seen, nearest first, and drops when it is far.

Problem  A level may be larger than memory. Of `scene.glb` a viewer needs all or nothing; here it needs what its cell sees,
         at the levels of detail that the cell draws.
Method   A *model* is a mesh at one level, with the vertices of that level only. Models stand on pages in the order of the
         first object that shows them: objects are in Morton order, so a page is a place. Meshes that several objects
         share have pages of their own, and so has each level of detail: a far cell does not fetch near meshes.
         Values are those of `scene.glb`, bit for bit; `squeeze` makes them small without loss. Textures are files apart.
         Until a page is here its objects are drawn as their boxes, in `object_color`.
"""

import io
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from PIL import Image

from farfield.detail.model import Levels
from farfield.placementdb.layout import GEOMETRY_INDEX, GEOMETRY_PAGE, cast
from farfield.scene.images import mime_type
from farfield.scene.model import Scene
from farfield.scene.picture import srgb_bytes, triangle_colors
from farfield.scene.raw import linear_from_srgb

PAGE_BYTES = 1 << 20  # of a page's models in video memory; a larger model has a page of its own
SHORT_VERTICES = 1 << 16  # a page with no more needs two bytes an index
_SUFFIX = {"image/png": ".png", "image/jpeg": ".jpg", "image/webp": ".webp"}
_SMALL_PX = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class GeometryPage:
    columns: dict[str, np.ndarray]
    memory: int  # bytes that its buffers take in video memory


@dataclass(frozen=True, slots=True, kw_only=True)
class Texture:
    content: bytes
    suffix: str
    width: int
    height: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Geometry:
    """The level in pages. Textures are distinct files; `index` says which texture takes which."""

    index: dict[str, np.ndarray]
    pages: list[GeometryPage]
    textures: list[Texture]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Model:
    """Vertices (rows of the scene's arrays) and triangles (into them) of each part of a mesh at one level."""

    vertices: list[np.ndarray]
    triangles: list[np.ndarray]


def build_geometry(scene: Scene, levels: Levels) -> Geometry:
    """Return the level in pages: every mesh that an object shows, at each of its levels."""
    n_meshes = len(scene.mesh_primitive) - 1
    coarse = np.diff(levels.row) if len(levels.row) else np.zeros(n_meshes, np.int64)
    first_model = np.concatenate([[0], np.cumsum(1 + coarse)])
    mesh_of = np.repeat(np.arange(n_meshes), 1 + coarse)
    level_of = np.arange(first_model[-1]) - first_model[mesh_of]
    users = np.bincount(scene.object_mesh, minlength=n_meshes)
    first_user = np.full(n_meshes, scene.n_objects)
    np.minimum.at(first_user, scene.object_mesh, np.arange(scene.n_objects))
    # Pages of one kind hold models of one level, shared or not: a page is needed for one reason.
    order = np.lexsort((mesh_of, first_user[mesh_of], users[mesh_of] <= 1, level_of))
    order = order[users[mesh_of[order]] > 0]
    kind = 2 * level_of + (users[mesh_of] <= 1)

    page_of, slot_of = np.full(len(mesh_of), -1), np.full(len(mesh_of), -1)
    pages: list[GeometryPage] = []
    held: list[_Model] = []

    def close() -> None:
        if held:
            pages.append(_page(scene, held))
            held.clear()

    size = vertices = 0
    before = -1
    of_meshes = levels.of_meshes()
    for q in order.tolist():
        model = _model(scene, of_meshes, int(mesh_of[q]), int(level_of[q]))
        n, t = sum(map(len, model.vertices)), sum(map(len, model.triangles))
        need = 24 * n + 6 * t
        if kind[q] != before or size + need > PAGE_BYTES or vertices + n > SHORT_VERTICES:
            close()
            size = vertices = 0
        page_of[q], slot_of[q] = len(pages), len(held)
        held.append(model)
        size, vertices, before = size + need, vertices + n, int(kind[q])
    close()
    files, texture_file, texture_color = _textures(scene)
    apart = len(scene.emissive_uv) > 0
    index = {
        "object_mesh": scene.object_mesh, "object_matrix": scene.object_matrix, "object_color": _object_colors(scene),
        "mesh_primitive": scene.mesh_primitive, "primitive_material": scene.primitive_material,
        "mesh_model": first_model, "model_page": page_of, "model_slot": slot_of,
        "material_base_color": scene.material_base_color, "material_emissive": scene.material_emissive,
        "material_alpha": scene.material_alpha_mode, "material_cutoff": scene.material_alpha_cutoff,
        "material_unlit": scene.material_unlit, "material_two_sided": scene.material_double_sided,
        "material_texture": scene.material_texture, "material_glow": scene.material_emissive_texture,
        "material_glow_apart": (scene.material_texture >= 0) & (scene.material_emissive_texture >= 0) & apart,
        "texture_file": texture_file, "texture_wrap": scene.texture_wrap, "texture_linear": scene.texture_linear,
        "texture_smooth": scene.texture_smooth, "texture_color": texture_color,
    }  # fmt: skip
    return Geometry(index=cast(index, GEOMETRY_INDEX), pages=pages, textures=files)


def _model(scene: Scene, of_meshes: list[list[list[np.ndarray]]], mesh: int, level: int) -> _Model:
    vertices, triangles = [], []
    for k, p in enumerate(range(*scene.mesh_primitive[mesh : mesh + 2])):
        if level:
            used, triangle = np.unique(of_meshes[mesh][level - 1][k], return_inverse=True)
            triangle = triangle.reshape(-1, 3)
        else:
            used = np.arange(*scene.primitive_vertex[p : p + 2])
            triangle = scene.index[slice(*scene.primitive_triangle[p : p + 2])] - used[0]
        vertices.append(used)
        triangles.append(triangle)
    return _Model(vertices=vertices, triangles=triangles)


def _page(scene: Scene, models: list[_Model]) -> GeometryPage:
    parts = [(v, t) for model in models for v, t in zip(model.vertices, model.triangles, strict=True)]
    rows = np.concatenate([v for v, _ in parts])
    starts = np.concatenate([[0], np.cumsum([len(v) for v, _ in parts])])
    index = np.concatenate([t + first for (_, t), first in zip(parts, starts.tolist(), strict=False)])
    gathered = {
        "uv": scene.uv[rows], "glow_uv": scene.emissive_uv[rows] if len(scene.emissive_uv) else scene.emissive_uv,
        "color": scene.color[rows],
    }  # fmt: skip
    plain = {"uv": 0.0, "glow_uv": 0.0, "color": 1.0}  # a column that says nothing is left empty
    gathered = {name: a if (a != plain[name]).any() else a[:0] for name, a in gathered.items()}
    columns = {
        "model_part": np.concatenate([[0], np.cumsum([len(model.vertices) for model in models])]),
        "part_triangle": np.concatenate([[0], np.cumsum([len(t) for _, t in parts])]),
        "position": scene.position[rows], "normal": scene.normal[rows], "index": index, **gathered,
    }  # fmt: skip
    columns = cast(columns, GEOMETRY_PAGE)
    short = len(rows) <= SHORT_VERTICES
    memory = sum(columns[name].nbytes for name in ("position", "normal", "uv", "glow_uv", "color"))
    return GeometryPage(columns=columns, memory=memory + columns["index"].size * (2 if short else 4))


def _textures(scene: Scene) -> tuple[list[Texture], np.ndarray, np.ndarray]:
    """Return distinct files, the file of each texture, and (X,3) u1 sRGB means."""
    known: dict[bytes, int] = {}
    files: list[Texture] = []
    means: list[np.ndarray] = []
    of = np.zeros(len(scene.texture_wrap), np.int32)
    for x, (a, b) in enumerate(pairwise(scene.texture_byte.tolist())):
        content = scene.texture_data[a:b].tobytes()
        if content not in known:
            known[content] = len(files)
            with Image.open(io.BytesIO(content)) as image:
                width, height = image.size
                image.draft("RGB", (_SMALL_PX, _SMALL_PX))
                small = image.convert("RGBA").resize((_SMALL_PX, _SMALL_PX), Image.Resampling.BOX)
            texels = np.asarray(small, dtype=np.float64).reshape(-1, 4) / 255
            weight = texels[:, 3] + 1e-9
            means.append((linear_from_srgb(texels[:, :3]) * weight[:, None]).sum(0) / weight.sum())
            files.append(Texture(content=content, suffix=_SUFFIX[mime_type(content)], width=width, height=height))
        of[x] = known[content]
    colors = srgb_bytes(np.array(means).reshape(-1, 3))[of]
    return files, of, colors


def _object_colors(scene: Scene) -> np.ndarray:
    """(N,3) u1 sRGB: the mean colour of each object's surface, by area, before any light."""
    position = scene.position.astype(np.float64)
    a, b, c = (position[scene.index[:, k]] for k in range(3))
    u, v = b - a, c - a
    cross = np.stack([u[:, 1] * v[:, 2] - u[:, 2] * v[:, 1], u[:, 2] * v[:, 0] - u[:, 0] * v[:, 2],
                      u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]], -1)  # fmt: skip
    area = np.sqrt((cross * cross).sum(1)) + 1e-30
    ends = scene.primitive_triangle[scene.mesh_primitive]
    mesh = np.repeat(np.arange(len(ends) - 1), np.diff(ends))
    total = np.bincount(mesh, area, len(ends) - 1)
    colors = triangle_colors(scene)
    mean = [np.bincount(mesh, area * colors[:, k], len(ends) - 1) / np.maximum(total, 1e-30) for k in range(3)]
    return srgb_bytes(np.stack(mean, -1).reshape(-1, 3))[scene.object_mesh]
