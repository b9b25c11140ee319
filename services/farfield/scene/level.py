"""RawScene -> Level: metres, y up, float32, one pack of columns; nothing degenerate, every vertex with a normal.

Flat normals, as glTF asks, where a file has none: vertices are split where faces of different planes meet. A face
normal is rounded to 2**-14 first, so that the triangles of one plane share their vertices (error below 4e-5 rad).
A mesh that lies far from its own origin (a national grid) is moved there and its matrix moved back in float64: exactly
for float32 files (subtracting a float32 within a factor of two is exact, Sterbenz), by one common offset for text
files, so that neighbours stay without gaps.
"""

import math
from dataclasses import dataclass

import numpy as np

from farfield.errors import SceneEmpty, SceneNotFinite
from farfield.scene import kernels
from farfield.scene.gltf import compose
from farfield.scene.raw import RawMaterial, RawScene, RawTexture

_FAR = 16.0  # scene extents from its own origin at which a mesh is moved
_COARSE = 1e-4  # step of a position over the size of the largest mesh that shows
_NORMAL_STEPS = 2**14
VERTEX_BYTES, TRIANGLE_BYTES = 36, 12


@dataclass(slots=True, kw_only=True)
class Level:
    """Columns as in Scene, but absolute (scene metres), in the file's order and before splitting."""

    position: np.ndarray
    normal: np.ndarray
    uv: np.ndarray
    emissive_uv: np.ndarray
    color: np.ndarray
    index: np.ndarray  # int64
    primitive_triangle: np.ndarray
    primitive_vertex: np.ndarray
    primitive_material: np.ndarray
    mesh_primitive: np.ndarray
    object_mesh: np.ndarray
    object_matrix: np.ndarray
    object_box: np.ndarray
    object_name: list[str]
    object_look: np.ndarray  # of the node and its mesh; materials add theirs at the end
    materials: list[RawMaterial]
    textures: list[RawTexture]
    dropped_triangles: int
    warnings: list[str]
    notice: str

    def mesh_triangles(self) -> np.ndarray:
        """(M+1,) int64: mesh m has triangles [m, m+1)."""
        return self.primitive_triangle[self.mesh_primitive]

    def mesh_vertices(self) -> np.ndarray:
        """(M+1,) int64: mesh m has vertices [m, m+1)."""
        return self.primitive_vertex[self.mesh_primitive]


def build_level(raw: RawScene, *, unit_m: float, up: str) -> Level:
    """Return the packed level; `raw` is used up. Raises SceneEmpty, SceneNotFinite."""
    turn = np.diag([unit_m, unit_m, unit_m, 1.0])
    if up == "z":
        turn[:3, :3] = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]) * unit_m
    raw.meshes = [[p for p in mesh if len(p.index)] for mesh in raw.meshes]
    nodes = [n for n in raw.nodes if raw.meshes[n.mesh]]
    matrices = [compose(turn, n.matrix) for n in nodes]
    placed = np.flatnonzero(_span_planes(np.array(matrices).reshape(-1, 4, 4)[:, :3, :3])).tolist()
    warnings = list(raw.warnings)
    if len(placed) < len(nodes):
        warnings.append(f"{len(nodes) - len(placed)} objects are scaled to a line or a point; they are left out.")
    nodes, matrices = [nodes[i] for i in placed], [matrices[i] for i in placed]
    if not nodes:
        raise SceneEmpty("The scene has no triangles.")
    offsets = _offsets(raw, [n.mesh for n in nodes], matrices)
    warnings += _coarse_steps(raw, offsets, nodes, matrices)
    for n, matrix in zip(nodes, matrices):
        for p in raw.meshes[n.mesh]:
            n.look |= p.look
        if n.mesh in offsets:
            matrix[:3, 3] += (matrix[:3, :3] * offsets[n.mesh]).sum(1)
    level = _pack(raw, {n.mesh for n in nodes}, offsets, warnings)
    _drop_degenerate_and_split_normals(level, np.array([n.mesh for n in nodes], dtype=np.int64), matrices, nodes)
    return level


def _span_planes(linear: np.ndarray) -> np.ndarray:
    """(n,3,3) -> (n,): whether the columns span a plane at least."""
    a, b, c = linear.transpose(2, 0, 1)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.any([np.cross(*pair).any(-1) for pair in ((a, b), (b, c), (c, a))], axis=0)


def _offsets(raw: RawScene, used: list[int], matrices: list[np.ndarray]) -> dict[int, np.ndarray]:
    """Return what to subtract from the positions of a mesh, file units; meshes that stay are not in it."""
    bounds = {
        m: (np.min([p.position.min(0) for p in raw.meshes[m]], 0).astype(np.float64),
            np.max([p.position.max(0) for p in raw.meshes[m]], 0).astype(np.float64))
        for m in set(used)
    }  # fmt: skip
    if next(iter(raw.meshes[used[0]])).position.dtype == np.float64:
        low, high = np.min([b[0] for b in bounds.values()], 0), np.max([b[1] for b in bounds.values()], 0)
        extent, middle = float((high - low).max()), low * 0.5 + high * 0.5
        step = 2.0 ** math.floor(math.log2(extent)) if extent > 0 else 1.0
        offset = np.where(np.abs(middle) > 4 * extent, np.rint(middle / step) * step, 0.0)
        return dict.fromkeys(bounds, offset) if offset.any() else {}
    # World extent of the scene, from the middles and half sides of the meshes' boxes.
    lows, highs = [], []
    with np.errstate(over="ignore", invalid="ignore"):
        for m, matrix in zip(used, matrices):
            low, high = bounds[m]
            middle = (matrix[:3, :3] * (low * 0.5 + high * 0.5)).sum(1) + matrix[:3, 3]
            half = (np.abs(matrix[:3, :3]) * (high * 0.5 - low * 0.5)).sum(1)
            lows.append(middle - half)
            highs.append(middle + half)
        extent = float((np.max(highs, 0) - np.min(lows, 0)).max())
    if not math.isfinite(extent):
        raise SceneNotFinite("The scene has positions that are not finite.")
    found = {}
    for m, matrix in zip(used, matrices):
        middle = np.float32(bounds[m][0] * 0.5 + bounds[m][1] * 0.5).astype(np.float64)
        half = bounds[m][1] * 0.5 - bounds[m][0] * 0.5
        reach = np.abs(matrix[:3, :3]).max(0) * np.abs(middle)
        offset = np.where((reach > _FAR * extent) & (np.abs(middle) > 4 * half), middle, 0.0)
        if m not in found and offset.any():
            found[m] = offset
    return found


def _coarse_steps(raw: RawScene, offsets: dict[int, np.ndarray], nodes: list, matrices: list) -> list[str]:
    """Return a warning where 32-bit numbers far from their origin say positions in steps that show."""
    far = [(n, matrix) for n, matrix in zip(nodes, matrices) if n.mesh in offsets]
    step = reach = size = 0.0
    for n, matrix in far:
        if raw.meshes[n.mesh][0].position.dtype != np.float32:
            return []
        scale = float(np.abs(matrix[:3, :3]).max())
        offset = float(np.abs(offsets[n.mesh]).max())
        extent = max(float((p.position.max(0) - p.position.min(0)).max()) for p in raw.meshes[n.mesh])
        step, reach = max(step, scale * float(np.spacing(np.float32(offset)))), max(reach, scale * offset)
        size = max(size, scale * extent)
    if step <= _COARSE * size:
        return []
    return [
        f"The file has positions about {reach:.3g} m from the origin as 32-bit numbers, in steps of {step:.2g} m; "
        "export the level with its origin nearby, or with the offset in the transforms of its nodes."
    ]


def _pack(raw: RawScene, used: set[int], offsets: dict[int, np.ndarray], warnings: list[str]) -> Level:
    """Move the primitives of the meshes in use into columns; they leave `raw`, so that nothing is held twice."""
    materials = list(raw.materials)
    in_use = [p for m, mesh in enumerate(raw.meshes) if m in used for p in mesh]
    count = lambda sizes: np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)  # noqa: E731
    primitive_triangle = count([len(p.index) for p in in_use])
    primitive_vertex = count([len(p.position) for p in in_use])
    primitive_material = np.empty(len(in_use), dtype=np.int32)
    n = int(primitive_vertex[-1])
    position, normal, uv = np.empty((n, 3), np.float32), np.zeros((n, 3), np.float32), np.zeros((n, 2), np.float32)
    color, index = np.ones((n, 4), np.float32), np.empty((primitive_triangle[-1], 3), dtype=np.int64)
    apart = any(p.emissive_uv is not None for p in in_use)
    emissive_uv = np.zeros((n if apart else 0, 2), np.float32)
    del in_use
    mesh_primitive = np.zeros(len(raw.meshes) + 1, dtype=np.int64)
    k = 0
    for m in range(len(raw.meshes)):
        for p in raw.meshes[m] if m in used else []:
            here = slice(primitive_vertex[k], primitive_vertex[k + 1])
            if p.material < 0:
                if len(materials) == len(raw.materials):
                    materials.append(RawMaterial(name="default", double_sided=raw.default_double_sided))
                p.material = len(materials) - 1
            moved = p.position if m not in offsets else p.position.astype(np.float64) - offsets[m]
            with np.errstate(over="ignore"):
                position[here] = moved.astype(np.float32)
            if p.normal is not None:
                normal[here] = _unit(p.normal)
            material = materials[p.material]
            if p.uv is not None and max(material.texture, material.emissive_texture) >= 0:
                uv[here] = _cleaned(p.uv, 0.0, "texture coordinates", warnings)
            if len(emissive_uv):
                emissive_uv[here] = (
                    uv[here] if p.emissive_uv is None else _cleaned(p.emissive_uv, 0.0, "texture coordinates", warnings)
                )
            if p.color is not None:
                color[here] = np.clip(_cleaned(p.color, 1.0, "vertex colours", warnings), 0.0, 1.0)
            np.add(p.index, primitive_vertex[k], out=index[primitive_triangle[k] : primitive_triangle[k + 1]])
            primitive_material[k] = p.material
            k += 1
        mesh_primitive[m + 1] = k
        raw.meshes[m] = []
    if not np.isfinite(position).all():
        raise SceneNotFinite("A vertex position is too large for a 32-bit number.")
    return Level(
        position=position, normal=normal, uv=uv, emissive_uv=emissive_uv, color=color, index=index,
        primitive_triangle=primitive_triangle,
        primitive_vertex=primitive_vertex, primitive_material=primitive_material, mesh_primitive=mesh_primitive,
        object_mesh=np.zeros(0, np.int32), object_matrix=np.zeros((0, 3, 4)), object_box=np.zeros((0, 2, 3)),
        object_name=[], object_look=np.zeros(0, np.uint8), materials=materials, textures=list(raw.textures),
        dropped_triangles=raw.dropped_triangles,
        warnings=warnings, notice=raw.notice,
    )  # fmt: skip


def _unit(normal: np.ndarray) -> np.ndarray:
    """Unit normals, zero where the file has none that can be used."""
    wide = normal.astype(np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        length = np.sqrt(wide[:, 0] * wide[:, 0] + wide[:, 1] * wide[:, 1] + wide[:, 2] * wide[:, 2])
    useless = np.logical_not(np.isfinite(length) & (length > 1e-12))
    # What is unit up to float32 stays as it is: reading back what was written changes nothing.
    length = np.where(useless | (np.abs(length - 1.0) < 1e-6), 1.0, length)
    return np.where(useless[:, None], 0.0, wide / length[:, None]).astype(np.float32)


def _cleaned(array: np.ndarray, default: float, what: str, warnings: list[str]) -> np.ndarray:
    if np.isfinite(array).all():
        return array
    text = f"Some {what} are not finite; they count as {default:g}."
    if text not in warnings:
        warnings.append(text)
    return np.where(np.isfinite(array), array, np.float32(default)).astype(np.float32)


def _drop_degenerate_and_split_normals(level: Level, mesh: np.ndarray, matrices: list, nodes: list) -> None:
    """Drop triangles without area and unused vertices, fill in flat normals, then place the objects that are left."""
    keep = np.zeros(len(level.index), dtype=np.bool_)
    kernels.solid_triangles(level.position, level.index, keep)
    level.dropped_triangles += int(len(keep) - keep.sum())
    if not keep.any():
        raise SceneEmpty("The scene has no triangles with an area.")
    index = level.index[keep]
    primitive = np.repeat(np.arange(len(level.primitive_material)), np.diff(level.primitive_triangle))[keep]
    missing = np.logical_not((level.normal != 0).any(1))
    flat, of_face = np.zeros((1, 3), dtype=np.float32), np.zeros(len(index), dtype=np.int32)
    turned = np.flatnonzero(missing.take(index).any(1)) if missing.any() else np.zeros(0, dtype=np.int64)
    if len(turned):
        flat_normal = np.empty((len(turned), 3))
        kernels.face_normals(level.position, index[turned], flat_normal)
        steps = np.rint(flat_normal * _NORMAL_STEPS).astype(np.int64)
        shifted = steps + _NORMAL_STEPS
        key = (shifted[:, 0] << 32) | (shifted[:, 1] << 16) | shifted[:, 2]
        _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
        wide = steps[first].astype(np.float64)
        wide /= np.sqrt((wide * wide).sum(1))[:, None]
        flat = np.concatenate([flat, wide.astype(np.float32)])
        of_face[turned] = inverse.reshape(-1) + 1
    level.index = np.empty_like(index)
    source, side = kernels.corner_vertices(index, missing, of_face, level.index)
    _take(level, source)
    level.normal[side > 0] = flat[side[side > 0]]

    counts = np.bincount(primitive, minlength=len(level.primitive_material))
    full = np.flatnonzero(counts)
    level.primitive_triangle = np.concatenate([[0], np.cumsum(counts[full])])
    level.primitive_vertex = np.searchsorted(source, level.primitive_vertex[np.append(full, len(counts))])
    level.primitive_material = level.primitive_material[full]
    mesh_primitive = np.searchsorted(full, level.mesh_primitive)
    full_mesh = np.flatnonzero(np.diff(mesh_primitive))
    level.mesh_primitive = np.append(mesh_primitive[full_mesh], mesh_primitive[-1])
    number = np.full(len(mesh_primitive) - 1, -1)
    number[full_mesh] = np.arange(len(full_mesh))
    placed = np.flatnonzero(number[mesh] >= 0)
    level.object_mesh = number[mesh[placed]].astype(np.int32)
    level.object_matrix = np.array([matrices[i][:3] for i in placed.tolist()])
    level.object_name = [nodes[i].name for i in placed.tolist()]
    level.object_look = np.array([nodes[i].look for i in placed.tolist()], dtype=np.uint8)
    measure(level)


def measure(level: Level) -> None:
    """Compute object_box from vertices and matrices. Raises SceneNotFinite."""
    ends = level.mesh_vertices()
    level.object_box = np.empty((len(level.object_mesh), 2, 3))
    kernels.object_boxes(
        level.position,
        ends[:-1],
        ends[1:],
        level.object_mesh,
        np.ascontiguousarray(level.object_matrix),
        level.object_box,
    )
    if not np.isfinite(level.object_box).all():
        bad = int(np.flatnonzero(~np.isfinite(level.object_box).all((1, 2)))[0])
        raise SceneNotFinite(f"The object {level.object_name[bad]!r:.80} has positions that are not finite.")


def repack(level: Level, triangle: np.ndarray, primitive_triangle: np.ndarray) -> None:
    """Make primitives of the given triangles: primitive p takes level.index[triangle[p]..]; vertices follow, in order.

    triangle            (T',) int64 triangles of the level; one may occur in several primitives
    primitive_triangle  (P'+1,) int64 ranges of it
    Materials, meshes and objects stay to be set by the caller.
    """
    corner, ends = np.empty((len(triangle), 3), dtype=np.int64), np.empty(len(primitive_triangle), dtype=np.int64)
    source = kernels.own_vertices(level.index, triangle, primitive_triangle, len(level.position), corner, ends)
    level.index = corner
    _take(level, source)
    level.primitive_triangle, level.primitive_vertex = primitive_triangle, ends


def _take(level: Level, source: np.ndarray) -> None:
    """Make vertices of copies of old ones; one column after the other, and `take`, which is twice as fast as an index."""
    for name in ("position", "normal", "uv", "emissive_uv", "color"):
        if len(column := getattr(level, name)):
            setattr(level, name, column.take(source, axis=0))
