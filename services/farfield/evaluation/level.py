"""Read from scene.glb the boxes of the objects and the triangles of their levels: only what `verify` needs, in its own code.

`farfield place` writes one node per object, its id in `extras.object`; positions are float32 in the binary chunk.
"""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from farfield.errors import ColumnsAltered, ColumnsTruncated, NotColumns, PlacementFileMissing

_INDEX_TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4"}


def read_boxes(path: Path) -> dict[int, np.ndarray]:
    """Return object id -> (2,3) f64 box in scene metres: the transformed float32 vertices, computed in float64.

    Raises PlacementFileMissing, NotColumns, ColumnsTruncated, ColumnsAltered, each naming the file.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PlacementFileMissing(str(path)) from error
    if len(content) < 20 or content[:4] != b"glTF":
        raise NotColumns(path.name)
    if len(content) < (total := int.from_bytes(content[8:12], "little")):
        raise ColumnsTruncated(path.name, len(content), total)
    try:
        return _boxes(content)
    except (KeyError, IndexError, TypeError, ValueError, struct.error) as error:
        raise ColumnsAltered(path.name, f"its nodes or accessors cannot be read ({error})") from error


def read_levels(path: Path) -> dict[int, list[int]]:
    """Return object id -> triangles of each coarser level of its mesh, finer first; objects without any are left out.

    A level is a mesh with as many primitives, on the vertices of the mesh. Raises ColumnsAltered, naming the file, and
    what `read_boxes` raises, which comes first.
    """
    with path.open("rb") as file:
        head = file.read(20)
        text = file.read(int.from_bytes(head[12:16], "little"))
    try:
        return _levels(json.loads(text))
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise ColumnsAltered(path.name, f"its levels cannot be read ({error})") from error


def _levels(document: dict[str, Any]) -> dict[int, list[int]]:
    meshes, accessors = document["meshes"], document["accessors"]
    out = {}
    for node in document["nodes"]:
        base = meshes[node["mesh"]] if "mesh" in node else {}
        levels = base.get("extras", {}).get("levels", [])
        counts = []
        for level in levels:
            parts = meshes[level]["primitives"]
            for part, of in zip(parts, base["primitives"], strict=True):
                if part["attributes"] != of["attributes"] or part["material"] != of["material"]:
                    raise ValueError(f"mesh {level} is no level of another")
            counts.append(sum(accessors[part["indices"]]["count"] // 3 for part in parts))
        if counts:
            out[int(node["extras"]["object"])] = counts
    return out


def _boxes(content: bytes) -> dict[int, np.ndarray]:
    (length,) = struct.unpack_from("<I", content, 12)
    document = json.loads(content[20 : 20 + length])
    binary = content[28 + length :]
    points: dict[int, np.ndarray] = {}
    out: dict[int, np.ndarray] = {}
    stack = [(node, np.eye(4)) for node in document["scenes"][document.get("scene", 0)]["nodes"]]
    while stack:
        number, parent = stack.pop()
        node = document["nodes"][number]
        world = _compose(parent, _local(node))
        stack.extend((child, world) for child in node.get("children", ()))
        if "mesh" not in node:
            continue
        mesh = node["mesh"]
        if mesh not in points:
            points[mesh] = np.concatenate(
                [_positions(document, binary, p) for p in document["meshes"][mesh]["primitives"]]
            )
        moved = sum(points[mesh][:, k, None] * world[:3, k] for k in range(3)) + world[:3, 3]
        out[int(node["extras"]["object"])] = np.stack([moved.min(0), moved.max(0)])
    return out


def _compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.array([[sum(a[i, k] * b[k, j] for k in range(4)) for j in range(4)] for i in range(4)])


def _local(node: dict[str, Any]) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    out = np.eye(4)
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), dtype=np.float64)
    out[:3, 3] = node.get("translation", (0, 0, 0))
    return out


def _positions(document: dict[str, Any], binary: bytes, primitive: dict[str, Any]) -> np.ndarray:
    points = _accessor(document, binary, primitive["attributes"]["POSITION"], 3)
    if "indices" in primitive:
        points = points[np.unique(_accessor(document, binary, primitive["indices"], 1))]
    return points.astype(np.float64)


def _accessor(document: dict[str, Any], binary: bytes, number: int, width: int) -> np.ndarray:
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    dtype = np.dtype("<f4" if width == 3 else _INDEX_TYPES[accessor["componentType"]])
    if width == 3 and accessor["componentType"] != 5126:
        raise ValueError("positions are not float32")
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    stride = view.get("byteStride", dtype.itemsize * width)
    shape = (accessor["count"], width) if width > 1 else (accessor["count"],)
    strides = (stride, dtype.itemsize) if width > 1 else (stride,)
    return np.ndarray(shape, dtype, binary, offset=start, strides=strides)
