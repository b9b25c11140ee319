"""EXT_meshopt_compression: buffer views of vertices, triangles and indices as `gltfpack` writes them.

Method   Vertices and triangles are decoded by meshoptimizer itself (the package `almeshopt`); sequences of indices and the
         three filters are a few lines of arithmetic, here, in float32 as the specification has it.
Refuses  A view whose counts, strides or sizes disagree, before anything is allocated or handed to the library.
After    EXT_meshopt_compression, vendor extension of glTF 2.0.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from farfield.errors import SceneIndexOutOfRange, SceneUnreadable
from farfield.scene.accessors import Json
from farfield.scene.limits import need

EXTENSION = "EXT_meshopt_compression"
_TAIL = 4  # bytes behind a sequence of indices


def view_bytes(view: dict[str, Any], buffer_of: Callable[[int], bytes], most: int, where: str) -> bytes | None:
    """Return what a compressed buffer view holds once decoded, None where it is not compressed.

    most  bytes that it may have. Raises SceneUnreadable, SceneIndexOutOfRange, SceneOverLimit.
    """
    extensions = Json.table(view.get("extensions"), f"{where}: extensions of its bufferView")
    if EXTENSION not in extensions:
        return None
    where = f"{where}: {EXTENSION}"
    row = Json.table(extensions[EXTENSION], where)
    count = Json.count(row.get("count"), f"{where}.count")
    stride = Json.count(row.get("byteStride"), f"{where}.byteStride")
    length = Json.count(row.get("byteLength"), f"{where}.byteLength")
    start = Json.count(row.get("byteOffset", 0), f"{where}.byteOffset")
    mode, kind = row.get("mode"), row.get("filter", "NONE")
    if count * stride != Json.count(view.get("byteLength"), f"{where}: byteLength of its bufferView"):
        raise SceneUnreadable(f"{where}: {count} elements of {stride} bytes are not what its bufferView states.")
    need(count * stride, most, "bytes in a compressed bufferView")
    whole = memoryview(buffer_of(Json.integer(row.get("buffer"), f"{where}.buffer")))
    if start + length > len(whole):
        raise SceneIndexOutOfRange(f"{where} ends {start + length - len(whole)} bytes past its buffer.")
    data = bytes(whole[start : start + length])
    if not count:
        return b""
    if mode == "ATTRIBUTES":
        return _filtered(_attributes(data, count, stride, where), kind, where)
    if mode not in ("TRIANGLES", "INDICES") or kind != "NONE":
        raise SceneUnreadable(f"{where}: mode {mode!r:.40} with filter {kind!r:.40} is not known.")
    if stride not in (2, 4):
        raise SceneUnreadable(f"{where}: indices of {stride} bytes are not known.")
    index = _triangles(data, count, where) if mode == "TRIANGLES" else _sequence(data, count, where)
    if stride == 2 and index.max() > 0xFFFF:
        raise SceneUnreadable(f"{where}: an index does not fit into 2 bytes.")
    return index.astype("<u2" if stride == 2 else "<u4").tobytes()


def _library() -> Any:
    try:
        import almeshopt
    except ImportError as error:
        raise SceneUnreadable(f"The scene needs {EXTENSION}, and the package almeshopt does not run here.") from error
    return almeshopt


def _attributes(data: bytes, count: int, stride: int, where: str) -> np.ndarray:
    """Return (count, stride) u1."""
    if stride % 4 or not 4 <= stride <= 256 or not data:
        raise SceneUnreadable(f"{where}: vertices of {stride} bytes are not known.")
    try:
        rows: np.ndarray = _library().decode_vertex_buffer(data, count, stride, np.uint8)
    except RuntimeError as error:
        raise SceneUnreadable(f"{where} does not decode.") from error
    return rows


def _triangles(data: bytes, count: int, where: str) -> np.ndarray:
    if count % 3 or not data:
        raise SceneUnreadable(f"{where}: {count} indices are no triangles.")
    try:
        index: np.ndarray = _library().decode_index_buffer(data, count)
    except RuntimeError as error:
        raise SceneUnreadable(f"{where} does not decode.") from error
    return index


def _sequence(data: bytes, count: int, where: str) -> np.ndarray:
    """Return (count,) i64: each index is a difference (zigzag, 7 bits a byte) to the last one of its of two bases."""
    body = np.frombuffer(data, np.uint8)[1:]
    last = np.flatnonzero(body < 128)[:count]  # the byte in which a number ends
    if data[:1] not in (b"\xd0", b"\xd1") or len(last) < count or last[-1] + 1 + _TAIL > len(body):
        raise SceneUnreadable(f"{where} does not decode.")
    first = np.concatenate([[0], last[:-1] + 1])
    if (last - first).max() > 4:
        raise SceneUnreadable(f"{where} does not decode.")
    value = np.zeros(count, np.int64)
    for k in range(5):
        here = first + k <= last
        value[here] |= (body[first[here] + k] & 127).astype(np.int64) << 7 * k
    base, value = value & 1, value >> 1
    step = (value >> 1) ^ -(value & 1)
    index = np.zeros(count, np.int64)
    for b in (0, 1):
        index[base == b] = np.cumsum(step[base == b])
    if index.min() < 0 or index.max() > 0xFFFFFFFF:
        raise SceneUnreadable(f"{where} has an index that is none.")
    return index


def _filtered(rows: np.ndarray, kind: Any, where: str) -> bytes:
    stride = rows.shape[1]
    if kind == "NONE":
        return rows.tobytes()
    if kind == "OCTAHEDRAL" and stride in (4, 8):
        return _octahedral(rows.view("<i1" if stride == 4 else "<i2")).tobytes()
    if kind == "QUATERNION" and stride == 8:
        return _quaternion(rows.view("<i2")).tobytes()
    if kind == "EXPONENTIAL":
        stored = rows.view("<i4")
        return np.ldexp((stored << 8 >> 8).astype("<f4"), stored >> 24).astype("<f4").tobytes()
    raise SceneUnreadable(f"{where}: filter {kind!r:.40} on {stride} bytes is not known.")


def _rounded(value: np.ndarray, dtype: np.dtype) -> np.ndarray:
    return np.trunc(value + np.where(value >= 0, np.float32(0.5), np.float32(-0.5))).astype(dtype)


def _octahedral(rows: np.ndarray) -> np.ndarray:
    """Unit vectors of (n,4): x and y on the octahedron, what 1 is, and a last component that stays."""
    most = np.float32(np.iinfo(rows.dtype).max)
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = (rows[:, k].astype(np.float32) / rows[:, 2].astype(np.float32) for k in (0, 1))
        z = np.float32(1) - np.abs(x) - np.abs(y)
        fold = np.maximum(-z, np.float32(0))
        x, y = (v - np.where(v >= 0, fold, -fold) for v in (x, y))
        scale = most / np.sqrt(x * x + y * y + z * z)
        out = np.nan_to_num(np.stack([x * scale, y * scale, z * scale], 1), nan=0.0, posinf=0.0, neginf=0.0)
    return np.concatenate([_rounded(out, rows.dtype), rows[:, 3:]], 1)


def _quaternion(rows: np.ndarray) -> np.ndarray:
    """Unit quaternions of (n,4): three components, and which is the largest in two bits of what 1 is."""
    scale = np.float32(np.sqrt(0.5)) / (rows[:, 3] | 3).astype(np.float32)
    x, y, z = (rows[:, k].astype(np.float32) * scale for k in range(3))
    w = np.sqrt(np.maximum(np.float32(1) - x * x - y * y - z * z, np.float32(0)))
    out, largest = np.empty_like(rows), rows[:, 3] & 3
    for k, value in enumerate((w, x, y, z)):
        out[np.arange(len(rows)), (largest + k) & 3] = _rounded(value * np.float32(32767), rows.dtype)
    return out
