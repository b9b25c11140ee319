"""Scene -> scene.glb: what viewer and `verify` read, a node per object in id order.

Node i has `extras.object` = i, its name, and its matrix from the mesh to scene metres (origin_m included, float64).
Shared meshes stay shared; a glTF primitive per primitive; vertex colours where they are not white, texture coordinates
where the material has textures (a second set where it addresses its two apart); textures embedded as they are. The same
scene gives the same bytes.

Coarser levels of a mesh are meshes that no node names: `extras.levels` of the mesh lists them, finer first. A level has
the mesh's primitives in their order, on the same attribute accessors, with indices of its own.
"""

import json
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from farfield.scene.images import mime_type
from farfield.scene.model import BLEND, MASK, Scene

_FLOAT, _USHORT, _UINT = 5126, 5123, 5125
_ARRAY, _ELEMENT = 34962, 34963


# For each mesh its coarser levels, for each level the triangles (T,3) i32 of each primitive.
MeshLevels = Sequence[Sequence[Sequence[np.ndarray]]]


def write_glb(scene: Scene, levels: MeshLevels = ()) -> bytes:
    """Return the bytes of a glTF 2.0 binary file; `read_scene` returns the same scene from them.

    levels  of every mesh, or () for none: the same bytes as if no mesh had any
    """
    buffer = _Buffer()
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "farfield", **({"copyright": scene.notice} if scene.notice else {})},
        "scene": 0,
        "scenes": [{"nodes": list(range(scene.n_objects))}],
        "nodes": _nodes(scene),
        "meshes": _with_levels(scene, _meshes(scene, buffer), levels, buffer),
        "materials": _materials(scene),
    }
    if len(scene.texture_wrap):
        _add_textures(scene, document, buffer)
    bright = ["KHR_materials_emissive_strength"] if (scene.material_emissive > 1.0).any() else []
    unlit = ["KHR_materials_unlit"] if scene.material_unlit.any() else []
    if used := document.get("extensionsRequired", []) + bright + unlit:
        document["extensionsUsed"] = used
    document["accessors"] = buffer.accessors
    document["bufferViews"] = buffer.views
    document["buffers"] = [{"byteLength": len(buffer.data)}]
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    body = bytes(buffer.data)
    total = 12 + 8 + len(text) + 8 + len(body)
    word = lambda n: n.to_bytes(4, "little")  # noqa: E731
    return b"glTF" + word(2) + word(total) + word(len(text)) + b"JSON" + text + word(len(body)) + b"BIN\0" + body


class _Buffer:
    """One buffer, with views of one kind of data each; every view starts at a multiple of 4."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add_view(self, data: bytes | memoryview, **more: Any) -> int:
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more})
        self.data += data
        self.data += bytes(-len(self.data) % 4)
        return len(self.views) - 1

    def add_accessor(self, view: int, offset: int, component: int, kind: str, count: int, **more: Any) -> int:
        row = {"bufferView": view, "byteOffset": offset, "componentType": component, "type": kind, "count": count}
        self.accessors.append(row | more)
        return len(self.accessors) - 1


def _nodes(scene: Scene) -> list[dict[str, Any]]:
    matrix = np.zeros((scene.n_objects, 4, 4))
    matrix[:, :3] = scene.object_matrix
    matrix[:, :3, 3] += scene.origin_m
    matrix[:, 3, 3] = 1.0
    columns = matrix.transpose(0, 2, 1).reshape(-1, 16).tolist()
    identity = np.eye(4).reshape(16).tolist()
    nodes = []
    for i, (name, mesh, m) in enumerate(zip(scene.object_name, scene.object_mesh.tolist(), columns)):
        node = {"name": name, "mesh": mesh, "extras": {"object": i}}
        nodes.append(node if m == identity else node | {"matrix": m})
    return nodes


def _meshes(scene: Scene, buffer: _Buffer) -> list[dict[str, Any]]:
    n = len(scene.primitive_material)
    vertex, triangle = scene.primitive_vertex.tolist(), scene.primitive_triangle.tolist()
    materials = scene.primitive_material.tolist()
    base, glow = (
        column[scene.primitive_material] >= 0 for column in (scene.material_texture, scene.material_emissive_texture)
    )
    textured, apart = (base | glow).tolist(), (base & glow & (len(scene.emissive_uv) > 0)).tolist()
    colored = np.zeros(n, dtype=np.bool_)
    if n:
        colored = np.logical_or.reduceat((scene.color != 1.0).any(1), scene.primitive_vertex[:-1])
    # Indices count from the primitive's first vertex, two bytes each where that is enough (65535 is reserved).
    short = [vertex[p + 1] - vertex[p] <= 65535 for p in range(n)]
    local = scene.index - np.repeat(scene.primitive_vertex[:-1], np.diff(scene.primitive_triangle))[:, None]
    index_data: dict[bool, bytearray] = {True: bytearray(), False: bytearray()}
    index_at = []
    for p in range(n):
        data = index_data[short[p]]
        index_at.append(len(data))
        data += local[triangle[p] : triangle[p + 1]].astype("<u2" if short[p] else "<u4").tobytes()
    f32 = lambda a: np.ascontiguousarray(a, dtype="<f4").tobytes()  # noqa: E731
    position = buffer.add_view(f32(scene.position), byteStride=12, target=_ARRAY)
    normal = buffer.add_view(f32(scene.normal), byteStride=12, target=_ARRAY)
    uv_rows = [p for p in range(n) if textured[p]]
    glow_rows = [p for p in range(n) if apart[p]]
    color_rows = [p for p in range(n) if colored[p]]
    gather = lambda a, rows: np.concatenate([a[vertex[p] : vertex[p + 1]] for p in rows])  # noqa: E731
    uv = buffer.add_view(f32(gather(scene.uv, uv_rows)), byteStride=8, target=_ARRAY) if uv_rows else -1
    glow_uv = (
        buffer.add_view(f32(gather(scene.emissive_uv, glow_rows)), byteStride=8, target=_ARRAY) if glow_rows else -1
    )
    color = buffer.add_view(f32(gather(scene.color, color_rows)), byteStride=16, target=_ARRAY) if color_rows else -1
    index_view = {s: buffer.add_view(memoryview(d), target=_ELEMENT) for s, d in index_data.items() if d}
    low = np.minimum.reduceat(scene.position, scene.primitive_vertex[:-1]).astype(np.float64).tolist() if n else []
    high = np.maximum.reduceat(scene.position, scene.primitive_vertex[:-1]).astype(np.float64).tolist() if n else []
    uv_at = glow_at = color_at = 0
    primitives = []
    for p in range(n):
        start, count = vertex[p], vertex[p + 1] - vertex[p]
        attributes = {
            "POSITION": buffer.add_accessor(position, 12 * start, _FLOAT, "VEC3", count, min=low[p], max=high[p]),
            "NORMAL": buffer.add_accessor(normal, 12 * start, _FLOAT, "VEC3", count),
        }
        if textured[p]:
            attributes["TEXCOORD_0"] = buffer.add_accessor(uv, uv_at, _FLOAT, "VEC2", count)
            uv_at += 8 * count
        if apart[p]:
            attributes["TEXCOORD_1"] = buffer.add_accessor(glow_uv, glow_at, _FLOAT, "VEC2", count)
            glow_at += 8 * count
        if colored[p]:
            attributes["COLOR_0"] = buffer.add_accessor(color, color_at, _FLOAT, "VEC4", count)
            color_at += 16 * count
        kind = _USHORT if short[p] else _UINT
        corners = 3 * (triangle[p + 1] - triangle[p])
        indices = buffer.add_accessor(index_view[short[p]], index_at[p], kind, "SCALAR", corners)
        primitives.append({"attributes": attributes, "indices": indices, "material": materials[p]})
    ends = scene.mesh_primitive.tolist()
    return [{"primitives": primitives[a:b]} for a, b in pairwise(ends)]


def _with_levels(
    scene: Scene, meshes: list[dict[str, Any]], levels: MeshLevels, buffer: _Buffer
) -> list[dict[str, Any]]:
    """Return the meshes, and behind them their levels."""
    assert len(levels) in (0, len(meshes))
    vertex = scene.primitive_vertex.tolist()
    coarse: list[dict[str, Any]] = []
    data, rows = {_USHORT: bytearray(), _UINT: bytearray()}, []
    for m, of_mesh in enumerate(levels):
        if of_mesh:
            meshes[m]["extras"] = {"levels": [len(meshes) + len(coarse) + k for k in range(len(of_mesh))]}
        for parts in of_mesh:
            primitives = []
            for p, triangles in zip(range(*scene.mesh_primitive[m : m + 2]), parts, strict=True):
                of = meshes[m]["primitives"][p - int(scene.mesh_primitive[m])]
                kind = _USHORT if vertex[p + 1] - vertex[p] <= 65535 else _UINT
                primitives.append({"attributes": of["attributes"], "material": of["material"]})
                rows.append((primitives[-1], kind, len(data[kind]), 3 * len(triangles)))
                data[kind] += (triangles - vertex[p]).astype("<u2" if kind == _USHORT else "<u4").tobytes()
            coarse.append({"primitives": primitives})
    view = {kind: buffer.add_view(memoryview(d), target=_ELEMENT) for kind, d in data.items() if d}
    for primitive, kind, at, count in rows:
        primitive["indices"] = buffer.add_accessor(view[kind], at, kind, "SCALAR", count)
    return meshes + coarse


def _materials(scene: Scene) -> list[dict[str, Any]]:
    rows = []
    for k, name in enumerate(scene.material_name):
        pbr: dict[str, Any] = {
            "baseColorFactor": scene.material_base_color[k].astype(np.float64).tolist(),
            "metallicFactor": 0.0,
            "roughnessFactor": 1.0,
        }
        if scene.material_texture[k] >= 0:
            pbr["baseColorTexture"] = {"index": int(scene.material_texture[k])}
        row: dict[str, Any] = {"name": name, "pbrMetallicRoughness": pbr}
        emissive = scene.material_emissive[k].astype(np.float64)
        if emissive.any():
            # Factors end at 1; what shines brighter says so by the extension.
            strength = max(1.0, float(emissive.max()))
            row["emissiveFactor"] = (emissive / strength).tolist()
            if strength > 1.0:
                row["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
        if scene.material_emissive_texture[k] >= 0:
            row["emissiveTexture"] = {"index": int(scene.material_emissive_texture[k])}
            if scene.material_texture[k] >= 0 and len(scene.emissive_uv):
                row["emissiveTexture"]["texCoord"] = 1
        if scene.material_unlit[k]:
            row.setdefault("extensions", {})["KHR_materials_unlit"] = {}
        if scene.material_alpha_mode[k] == MASK:
            row |= {"alphaMode": "MASK", "alphaCutoff": float(scene.material_alpha_cutoff[k])}
        elif scene.material_alpha_mode[k] == BLEND:
            row["alphaMode"] = "BLEND"
        if scene.material_double_sided[k]:
            row["doubleSided"] = True
        rows.append(row)
    return rows


def _add_textures(scene: Scene, document: dict[str, Any], buffer: _Buffer) -> None:
    ends = scene.texture_byte.tolist()
    images: dict[bytes, int] = {}
    document["images"], document["samplers"], document["textures"] = [], [], []
    for x in range(len(scene.texture_wrap)):
        data = scene.texture_data[ends[x] : ends[x + 1]].tobytes()
        mime = mime_type(data)
        if data not in images:
            images[data] = len(document["images"])
            document["images"].append({"bufferView": buffer.add_view(data), "mimeType": mime})
        wrap_s, wrap_t = scene.texture_wrap[x].tolist()
        sampler = {
            "wrapS": wrap_s, "wrapT": wrap_t, "magFilter": 9729 if scene.texture_linear[x] else 9728,
            "minFilter": 9987 if scene.texture_smooth[x] else 9984,
        }  # fmt: skip
        if sampler not in document["samplers"]:
            document["samplers"].append(sampler)
        texture: dict[str, Any] = {"sampler": document["samplers"].index(sampler)}
        if mime == "image/webp":
            texture["extensions"] = {"EXT_texture_webp": {"source": images[data]}}
            document["extensionsRequired"] = ["EXT_texture_webp"]
        else:
            texture["source"] = images[data]
        document["textures"].append(texture)
