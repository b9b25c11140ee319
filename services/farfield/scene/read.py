"""Read a level: which format it is, then file -> RawScene -> Level -> Scene.

read      by content, not by name: an artifact in a store has no name (`gltf.py`, `obj.py`, `soup.py`, `files.py`)
level     metres, y up, float32, nothing degenerate, normals everywhere (`level.py`)
suggest   what the settings leave out (`derive.py`)
split     what is larger than two cells (`split.py`)
order     ids: depth-first order on the fixed grid (`order.py`)
"""

import re
import zipfile
from pathlib import Path

import numpy as np

from farfield.errors import SceneFileMissing, SceneOverLimit, SceneUnreadable, SettingsInvalid
from farfield.geometry.cells import cells_about
from farfield.scene.derive import Suggestion, grid_origin, object_counts, suggest, suggest_budgets
from farfield.scene.files import Folder, SceneFiles, Zip
from farfield.scene.gltf import read_gltf
from farfield.scene.level import TRIANGLE_BYTES, VERTEX_BYTES, Level, build_level, measure, repack
from farfield.scene.limits import Limits
from farfield.scene.model import BLEND, BLENDED, KEPT, MASK, Scene
from farfield.scene.obj import read_obj
from farfield.scene.order import object_order
from farfield.scene.raw import RawScene
from farfield.scene.soup import read_ply, read_stl
from farfield.scene.split import split_level
from farfield.settings import Settings

_OBJ_LINE = re.compile(rb"^[ \t]*(v|vn|vt|f|o|g|usemtl|mtllib)[ \t]", re.MULTILINE)


def read_scene(path: str | Path, *, settings: Settings, limits: Limits = Limits()) -> Scene:  # noqa: B008
    """Return the level in `path` (glTF, GLB, OBJ, PLY, STL, or a zip of one) as columns, ids final.

    settings  unit and axis (`scene`), view space and cell size (`view_space`) override what is derived
    limits    refuse larger levels
    Raises SceneUnreadable, SceneEmpty, SceneIndexOutOfRange, SceneNotFinite, SceneUriRefused, SceneFileMissing,
    SceneOverLimit, SettingsInvalid where the view space has too many cells or is too far away.
    """
    return inspect_scene(path, settings=settings, limits=limits)[0]


def inspect_scene(
    path: str | Path,
    *,
    settings: Settings,
    limits: Limits = Limits(),  # noqa: B008
) -> tuple[Scene, Suggestion]:
    """Return the scene as `read_scene` does, and what was derived for it with reasons."""
    raw = _read_raw(Path(path), limits)
    unit_m = settings.scene.unit_m if settings.scene.unit_m is not None else 1.0
    level = build_level(raw, unit_m=unit_m, up=settings.scene.up or "y")
    del raw
    reach_m = float(np.abs(level.object_box).max())
    if reach_m > limits.reach_m:
        raise SceneOverLimit(f"The scene reaches {reach_m:.3g} m from its origin; the limit is {limits.reach_m:.3g} m.")
    suggestion = suggest(level, settings=settings)
    n_cells = cells_about(np.array(suggestion.boxes), suggestion.cell_m)
    if n_cells > limits.cells:
        why = f"cells of {suggestion.cell_m:g} m would be about {n_cells:.3g}; at most {limits.cells} are allowed"
        raise SettingsInvalid("view_space.cell_m", why)
    level.warnings += suggestion.hints
    split_level(level, cell_m=suggestion.cell_m, min_triangles=settings.scene.split_triangles)
    suggestion = suggest_budgets(suggestion, level, settings=settings)
    return _finish(level, suggestion, kept=KEPT[settings.bake.flatten]), suggestion


def _read_raw(path: Path, limits: Limits) -> RawScene:
    if not path.is_file():
        links = (
            "is a symbolic link to nothing that can be read"
            if path.is_symlink()
            else "is not there, or is no plain file"
        )
        raise SceneFileMissing(f"{path.name} {links}.")
    try:
        zipped = zipfile.is_zipfile(path) and path.open("rb").read(2) == b"PK"
        files: SceneFiles = Zip(path, limits) if zipped else Folder(path, limits)
        data = files.read(files.name)
        return _reader(data, files.name if zipped else path.name)(data, files, limits)
    except MemoryError as error:
        raise SceneOverLimit(f"Reading {path.name} takes more memory than there is.") from error
    except (OSError, RecursionError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else "it is nested too deeply"
        raise SceneUnreadable(f"{path.name} cannot be read: {why}.") from error


def _reader(data: bytes, name: str):  # type: ignore[no-untyped-def]
    """Return the reader of the format that the bytes are, or that their name says where bytes do not tell."""
    suffix = Path(name).suffix.lower()
    head = data[:65536].lstrip(b"\xef\xbb\xbf \t\r\n")
    if data[:4] == b"glTF" or head[:1] == b"{" or suffix in (".glb", ".gltf"):
        return read_gltf
    if re.match(rb"ply[ \t]*\r?\n", data[:16]) or suffix == ".ply":
        return read_ply
    triangles = int.from_bytes(data[80:84], "little")
    if suffix == ".stl" or (len(data) >= 84 and len(data) == 84 + 50 * triangles) or head[:6].lower() == b"solid ":
        return read_stl
    if suffix == ".obj" or (_OBJ_LINE.search(head) and b"\0" not in head):
        return read_obj
    raise SceneUnreadable(f"{Path(name).name} is in no format that is read.")


def _finish(level: Level, suggestion: Suggestion, *, kept: int) -> Scene:
    """Fix the ids and freeze the columns relative to the origin; level is used up. kept: looks that stay geometry."""
    origin = grid_origin(level, suggestion.cell_m)
    level.object_matrix[:, :, 3] -= origin
    measure(level)
    calls, triangles = object_counts(level)
    rank = {name: i for i, name in enumerate(sorted(set(level.object_name)))}
    extra = [np.array([rank[n] for n in level.object_name]), *level.object_matrix.reshape(-1, 12).T]
    order = object_order(
        level.object_box, triangles=triangles, calls=calls, origin_m=origin, cell_m=suggestion.cell_m, extra=extra
    )
    # Meshes, materials and textures in the order in which objects first use them: the file's order leaves no trace.
    meshes = _first_uses(level.object_mesh[order])
    primitives = [p for m in meshes.tolist() for p in range(level.mesh_primitive[m], level.mesh_primitive[m + 1])]
    mesh_primitive = np.concatenate([[0], np.cumsum(np.diff(level.mesh_primitive)[meshes])])
    ends = level.primitive_triangle
    triangle = np.concatenate([np.arange(ends[p], ends[p + 1]) for p in primitives])
    repack(level, triangle, np.concatenate([[0], np.cumsum(np.diff(ends)[primitives])]))
    material = level.primitive_material[primitives]
    materials = _first_uses(material)
    rows = [level.materials[k] for k in materials.tolist()]
    used = np.array([(r.texture, r.emissive_texture) for r in rows], dtype=np.int64)
    textures = _first_uses(used[used >= 0])
    images = [level.textures[x] for x in textures.tolist()]
    mesh = _renumbered(level.object_mesh[order], meshes)
    vertices = np.diff(level.primitive_vertex[mesh_primitive])[mesh]
    look = np.array([r.look | (BLENDED if r.alpha_mode == BLEND else 0) for r in rows], dtype=np.uint8)
    mesh_look = np.bitwise_or.reduceat(look[_renumbered(material, materials)], mesh_primitive[:-1])
    object_look = level.object_look[order] | mesh_look[mesh]
    f32 = lambda values, width: np.array(values, dtype=np.float32).reshape(-1, width)  # noqa: E731
    return Scene(
        origin_m=origin, cell_m=float(suggestion.cell_m),
        view_boxes=np.array(suggestion.boxes, dtype=np.float64).reshape(-1, 2, 3) - origin,
        position=level.position, normal=level.normal, uv=level.uv, emissive_uv=level.emissive_uv, color=level.color,
        index=level.index.astype(np.int32), primitive_triangle=level.primitive_triangle.astype(np.int64),
        primitive_vertex=level.primitive_vertex.astype(np.int64), primitive_material=_renumbered(material, materials),
        mesh_primitive=mesh_primitive.astype(np.int64), object_mesh=mesh,
        object_matrix=np.ascontiguousarray(level.object_matrix[order]), object_box=level.object_box[order],
        object_triangles=triangles[order], object_calls=calls[order],
        object_bytes=(VERTEX_BYTES * vertices + TRIANGLE_BYTES * triangles[order]).astype(np.int64),
        object_replaceable=object_look & kept == 0, object_look=object_look,
        object_name=tuple(level.object_name[o] for o in order.tolist()),
        material_base_color=f32([r.base_color for r in rows], 4), material_emissive=f32([r.emissive for r in rows], 3),
        material_unlit=np.array([r.unlit for r in rows], dtype=np.bool_),
        material_alpha_mode=np.array([r.alpha_mode for r in rows], dtype=np.uint8),
        material_alpha_cutoff=np.array([r.alpha_cutoff if r.alpha_mode == MASK else 0.5 for r in rows], np.float32),
        material_double_sided=np.array([r.double_sided for r in rows], dtype=np.bool_),
        material_texture=_renumbered(used[:, 0], textures),
        material_emissive_texture=_renumbered(used[:, 1], textures), material_name=tuple(r.name for r in rows),
        texture_byte=np.concatenate([[0], np.cumsum([len(i.data) for i in images], dtype=np.int64)]).astype(np.int64),
        texture_data=np.frombuffer(b"".join(i.data for i in images), dtype=np.uint8),
        texture_wrap=np.array([i.wrap for i in images], dtype=np.int32).reshape(-1, 2),
        texture_linear=np.array([i.linear for i in images], dtype=np.bool_),
        texture_smooth=np.array([i.smooth for i in images], dtype=np.bool_),
        dropped_triangles=level.dropped_triangles, warnings=tuple(level.warnings), notice=level.notice,
    )  # fmt: skip


def _first_uses(values: np.ndarray) -> np.ndarray:
    """Return the distinct values in order of their first occurrence."""
    distinct, first = np.unique(values, return_index=True)
    return distinct[np.argsort(first)]


def _renumbered(values: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Return each value's place in `order` as int32, -1 where it is -1."""
    place = np.full(int(max(values.max(initial=-1), order.max(initial=-1))) + 2, -1, dtype=np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    return place[values]
