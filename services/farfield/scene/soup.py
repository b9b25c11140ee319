"""PLY and STL -> RawScene: one object each.

STL goes through trimesh. PLY has its own reader: trimesh reads polygons of mixed size in binary files as noise, and
does not return from a header that breaks off. A PLY's colours are sRGB; a texture it names is left out with a warning.
"""

import io
import posixpath
from dataclasses import dataclass

import numpy as np
import trimesh.exchange.stl

from farfield.errors import SceneIndexOutOfRange, SceneNotFinite, SceneUnreadable
from farfield.scene.files import SceneFiles
from farfield.scene.limits import Limits, need
from farfield.scene.polygons import triangulate
from farfield.scene.raw import RawNode, RawPrimitive, RawScene, linear_from_srgb

_HEADER_BYTES = 65536
_STL_TRIANGLE_BYTES = 50
_SCALARS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip


def read_stl(data: bytes, files: SceneFiles, limits: Limits) -> RawScene:
    """Return the level of a binary or ASCII STL file: all its solids as one object. Raises SceneError."""
    need(len(data) // _STL_TRIANGLE_BYTES, limits.triangles, "triangles")
    try:
        loaded = trimesh.exchange.stl.load_stl(io.BytesIO(data))
        solids = loaded["geometry"].values() if "geometry" in loaded else [loaded]
        position = np.concatenate([np.zeros((0, 3)), *(np.asarray(s["vertices"], np.float64) for s in solids)])
        index = np.arange(len(position), dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # a parser of untrusted text may raise anything
        raise SceneUnreadable(f"The STL cannot be read: {error}.") from error
    return _one_object(RawPrimitive(position=position, index=index, material=-1), files)


def _one_object(primitive: RawPrimitive, files: SceneFiles) -> RawScene:
    if not np.isfinite(primitive.position).all():
        raise SceneNotFinite("A vertex position is not finite.")
    # Soups repeat their corners: merge equal ones, so that faces of one plane share them again.
    if primitive.normal is None and primitive.uv is None and primitive.color is None:
        primitive.position, inverse = np.unique(primitive.position + 0.0, axis=0, return_inverse=True)
        primitive.index = inverse.reshape(-1)[primitive.index]
    scene = RawScene(default_double_sided=True)
    scene.meshes.append([primitive])
    scene.nodes.append(RawNode(posixpath.splitext(posixpath.basename(files.name))[0], 0, np.eye(4)))
    return scene


@dataclass
class _Element:
    name: str
    count: int
    properties: list[tuple[str, str, str | None]]  # name, type, type of the list's length


def read_ply(data: bytes, files: SceneFiles, limits: Limits) -> RawScene:
    """Return the level of an ASCII or binary PLY file. Raises SceneError."""
    try:
        order, elements, start, texture = _header(data)
        tables = _tables(data, start, elements, order)
    except (ValueError, KeyError, IndexError, OverflowError, TypeError) as error:
        raise SceneUnreadable(f"The PLY cannot be read: {error}.") from error
    vertex, face = tables.get("vertex", {}), tables.get("face", {})
    if not all(axis in vertex for axis in "xyz"):
        raise SceneUnreadable("The PLY has no vertices with x, y and z.")
    position = np.stack([vertex[axis] for axis in "xyz"], 1).astype(np.float64)
    corner, size = next(
        (face[n] for n in ("vertex_indices", "vertex_index") if isinstance(face.get(n), tuple)),
        (np.zeros(0, np.int64), np.zeros(0, np.int64)),
    )
    corner = corner.astype(np.int64)
    if len(corner) and not 0 <= corner.min() <= corner.max() < len(position):
        raise SceneIndexOutOfRange(f"A face refers to a vertex outside 0..{len(position) - 1}.")
    need(int((size - 2).clip(0).sum()), limits.triangles, "triangles")
    if not np.isfinite(position).all():
        raise SceneNotFinite("A vertex position is not finite.")
    rows, owner = triangulate(position, corner, size)
    primitive = RawPrimitive(position=position, index=corner[rows].reshape(-1, 3), material=-1)
    if all(n in vertex for n in ("nx", "ny", "nz")):
        primitive.normal = np.stack([vertex[n] for n in ("nx", "ny", "nz")], 1).astype(np.float32)
    color = _colors(vertex)
    if color is None and (of_face := _colors(face)) is not None:
        primitive.position = position[primitive.index].reshape(-1, 3)
        if primitive.normal is not None:
            primitive.normal = primitive.normal[primitive.index].reshape(-1, 3)
        primitive.index = np.arange(3 * len(owner), dtype=np.int64).reshape(-1, 3)
        color = np.repeat(of_face[owner], 3, axis=0)
    primitive.color = color
    scene = _one_object(primitive, files)
    if texture:
        scene.warnings.append("The texture of the PLY is left out: it keeps its colour.")
    return scene


def _colors(table: dict) -> np.ndarray | None:
    """(n,4) f32 linear, of integer columns 0..255 or real ones 0..1."""
    if not all(isinstance(table.get(n), np.ndarray) for n in ("red", "green", "blue")):
        return None
    columns = [table[n] for n in ("red", "green", "blue")]
    scale = 1.0 if columns[0].dtype.kind == "f" and (not len(columns[0]) or np.nanmax(columns[0]) <= 1.0) else 255.0
    rgba = np.ones((len(columns[0]), 4), dtype=np.float32)
    rgba[:, :3] = linear_from_srgb(np.stack(columns, 1) / scale)
    return rgba


def _header(data: bytes) -> tuple[str, list[_Element], int, bool]:
    end = data.find(b"end_header", 0, _HEADER_BYTES)
    if end < 0:
        raise ValueError("its header does not end")
    newline = data.find(b"\n", end)
    start = newline + 1 if newline >= 0 else len(data)
    order, texture = "", False
    elements: list[_Element] = []
    for line in data[:end].decode("ascii", "replace").splitlines()[1:]:
        words = line.split()
        if not words:
            continue
        if words[0] == "format":
            order = {"ascii": "ascii", "binary_little_endian": "<", "binary_big_endian": ">"}[words[1]]
        elif words[0] == "comment" and len(words) > 1 and words[1].lower() == "texturefile":
            texture = True
        elif words[0] == "element":
            elements.append(_Element(words[1], int(words[2]), []))
            if elements[-1].count < 0:
                raise ValueError(f"element {words[1]} has a negative count")
        elif words[0] == "property" and words[1] == "list":
            elements[-1].properties.append((words[4], _SCALARS[words[3]], _SCALARS[words[2]]))
        elif words[0] == "property":
            elements[-1].properties.append((words[2], _SCALARS[words[1]], None))
    if not order:
        raise ValueError("its header names no format")
    return order, elements, start, texture


def _tables(data: bytes, start: int, elements: list[_Element], order: str) -> dict[str, dict]:
    """Return, per element, its columns: arrays, and (values, lengths) for lists."""
    if order == "ascii":
        data, start, order = np.array(data[start:].split(), dtype=np.float64).tobytes(), 0, "="
        for e in elements:
            e.properties = [(n, "f8", None if length is None else "f8") for n, _, length in e.properties]
    tables: dict[str, dict] = {}
    for e in elements:
        if e.properties and e.count:
            tables[e.name], start = _table(data, start, e, order)
    return tables


def _table(data: bytes, at: int, element: _Element, order: str) -> tuple[dict, int]:
    """Read one element: at once where its lists are all as long as the first ones, else row by row."""
    fields: list[tuple] = []
    first = at
    for k, (_, kind, length) in enumerate(element.properties):
        if length is None:
            fields.append((f"{k}", order + kind))
            first += np.dtype(kind).itemsize
        else:
            n = int(np.frombuffer(data, order + length, 1, first)[0])
            if n < 0:
                raise ValueError("a list has a negative length")
            fields += [(f"{k}n", order + length), (f"{k}", order + kind, (n,))]
            first += np.dtype(length).itemsize + n * np.dtype(kind).itemsize
    dtype = np.dtype(fields)
    lists = [k for k, (_, _, length) in enumerate(element.properties) if length is not None]
    if at + element.count * dtype.itemsize <= len(data):
        rows = np.frombuffer(data, dtype, element.count, at)
        if all((rows[f"{k}n"] == rows[f"{k}n"][0]).all() for k in lists):
            columns: dict = {}
            for k, (name, _, length) in enumerate(element.properties):
                column = rows[f"{k}"]
                columns[name] = column if length is None else (column.reshape(-1), rows[f"{k}n"].astype(np.int64))
            return columns, at + element.count * dtype.itemsize
    if not lists:
        raise ValueError(f"it ends within the element {element.name}")
    return _rows(data, at, element, order)


def _rows(data: bytes, at: int, element: _Element, order: str) -> tuple[dict, int]:
    values: list[list] = [[] for _ in element.properties]
    sizes: list[list[int]] = [[] for _ in element.properties]
    types = [np.dtype(order + kind) for _, kind, _ in element.properties]
    counts = [None if length is None else np.dtype(order + length) for _, _, length in element.properties]
    for _ in range(element.count):
        for k, (dtype, count) in enumerate(zip(types, counts)):
            n = 1
            if count is not None:
                n = int(np.frombuffer(data, count, 1, at)[0])
                at += count.itemsize
            if n < 0 or at + n * dtype.itemsize > len(data):
                raise ValueError(f"it ends within the element {element.name}")
            values[k].append(np.frombuffer(data, dtype, n, at))
            sizes[k].append(n)
            at += n * dtype.itemsize
    columns: dict = {}
    for k, (name, _, length) in enumerate(element.properties):
        flat = np.concatenate(values[k])
        columns[name] = flat if length is None else (flat, np.array(sizes[k], dtype=np.int64))
    return columns, at
