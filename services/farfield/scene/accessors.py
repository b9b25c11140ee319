"""glTF accessors -> arrays: bounds first, then bytes; interleaved, sparse, normalized and zero-filled ones.

After    glTF 2.0 specification, sections 3.6.2 (accessors) and 3.6.2.3 (sparse accessors).
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from farfield.errors import SceneIndexOutOfRange, SceneUnreadable
from farfield.scene.limits import Limits, need

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Json:
    """Typed access to a parsed JSON document: every wrong type becomes SceneUnreadable that says where."""

    @staticmethod
    def table(value: Any, where: str) -> dict[str, Any]:
        if value is None:
            return {}
        if not isinstance(value, dict):
            raise SceneUnreadable(f"{where} must be a JSON object.")
        return value

    @staticmethod
    def rows(value: Any, where: str) -> list[Any]:
        if value is None:
            return []
        if not isinstance(value, list):
            raise SceneUnreadable(f"{where} must be a JSON list.")
        return value

    @staticmethod
    def integer(value: Any, where: str) -> int:
        if isinstance(value, float) and value.is_integer() and abs(value) < 2**53:
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool):
            raise SceneUnreadable(f"{where} must be a whole number.")
        return value

    @staticmethod
    def count(value: Any, where: str) -> int:
        n = Json.integer(value, where)
        if n < 0:
            raise SceneUnreadable(f"{where} must not be negative.")
        return n

    @staticmethod
    def number(value: Any, where: str) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise SceneUnreadable(f"{where} must be a number.")
        try:
            return float(value)
        except OverflowError:
            return math.inf

    @staticmethod
    def numbers(value: Any, n: int, where: str) -> list[float]:
        row = Json.rows(value, where)
        if len(row) != n:
            raise SceneUnreadable(f"{where} must hold {n} numbers.")
        return [Json.number(v, where) for v in row]

    @staticmethod
    def text(value: Any, where: str) -> str:
        if not isinstance(value, str):
            raise SceneUnreadable(f"{where} must be a string.")
        return value

    @staticmethod
    def pick(rows: list[Any], index: Any, where: str) -> dict[str, Any]:
        """Return entry `index` of a list of objects. Raises SceneIndexOutOfRange."""
        i = Json.integer(index, where)
        if not 0 <= i < len(rows):
            raise SceneIndexOutOfRange(f"{where} refers to entry {i} of {len(rows)}.")
        return Json.table(rows[i], where)


class Accessors:
    """Reads accessors of one document; each is decoded once."""

    def __init__(
        self, document: dict[str, Any], buffer_of: Callable[[int], bytes], limits: Limits,
        decoded: Callable[[dict[str, Any], Callable[[int], bytes], int, str], bytes | None] = lambda *_: None,
    ) -> None:  # fmt: skip
        """decoded  what gives the bytes of a buffer view that is compressed, None for others; told how many may be"""
        self._accessors = Json.rows(document.get("accessors"), "accessors")
        self._views = Json.rows(document.get("bufferViews"), "bufferViews")
        self._buffer_of = buffer_of
        self._limits = limits
        self._decoded = decoded
        self._unpacked: dict[int, memoryview] = {}
        self._known: dict[int, np.ndarray] = {}
        self._elements = 0

    def view_bytes(self, index: Any, where: str) -> memoryview:
        """Return the bytes of a buffer view. Raises SceneIndexOutOfRange where it ends past its buffer."""
        return self._view(index, where)[0]

    def _view(self, index: Any, where: str) -> tuple[memoryview, int]:
        view = Json.pick(self._views, index, f"{where}.bufferView")
        key = Json.integer(index, where)
        if (
            key not in self._unpacked
            and (data := self._decoded(view, self._buffer_of, 64 * self._limits.vertices, where)) is not None
        ):
            self._elements += len(data) // 4
            need(self._elements, 4 * self._limits.vertices, "accessor elements")
            self._unpacked[key] = memoryview(data)
        if key in self._unpacked:
            return self._unpacked[key], Json.count(view.get("byteStride", 0), f"{where}: byteStride of its bufferView")
        buffer = memoryview(self._buffer_of(Json.integer(view.get("buffer"), f"{where}: buffer of its bufferView")))
        start = Json.count(view.get("byteOffset", 0), f"{where}: byteOffset of its bufferView")
        length = Json.count(view.get("byteLength"), f"{where}: byteLength of its bufferView")
        stride = Json.count(view.get("byteStride", 0), f"{where}: byteStride of its bufferView")
        if start + length > len(buffer):
            raise SceneIndexOutOfRange(
                f"{where}: its bufferView ends {start + length - len(buffer)} bytes past its buffer."
            )
        return buffer[start : start + length], stride

    def _elements_of(self, source: dict[str, Any], dtype: np.dtype, width: int, count: int, where: str) -> np.ndarray:
        """Return a (count, width) view into the buffer."""
        data, stride = self._view(source.get("bufferView"), where)
        offset = Json.count(source.get("byteOffset", 0), f"{where}.byteOffset")
        size = dtype.itemsize * width
        stride = stride or size
        if stride < size:
            raise SceneUnreadable(f"{where}: byteStride {stride} is less than an element's {size} bytes.")
        end = offset + stride * (count - 1) + size if count else offset
        if end > len(data):
            raise SceneIndexOutOfRange(f"{where} ends {end - len(data)} bytes past its bufferView.")
        return np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))

    def raw(self, index: Any, where: str) -> tuple[np.ndarray, bool]:
        """Return ((count, width) array in the stored type, normalized)."""
        accessor = Json.pick(self._accessors, index, where)
        kind, component = accessor.get("type"), accessor.get("componentType")
        if (
            not isinstance(kind, str)
            or kind not in _WIDTHS
            or not isinstance(component, int)
            or component not in _TYPES
        ):
            raise SceneUnreadable(f"{where}: its accessor has an unknown type ({kind!r:.40}, {component!r:.40}).")
        dtype, width = np.dtype(_TYPES[component]), _WIDTHS[kind]
        count = Json.count(accessor.get("count"), f"{where}.count")
        normalized = accessor.get("normalized", False) is True
        key = Json.integer(index, where)
        if key in self._known:
            return self._known[key], normalized
        self._elements += count
        need(self._elements, 4 * self._limits.vertices, "accessor elements")
        if accessor.get("bufferView") is not None:
            array = self._elements_of(accessor, dtype, width, count, where)
        else:
            array = np.zeros((count, width), dtype)
        if accessor.get("sparse") is not None:
            array = self._sparse(Json.table(accessor["sparse"], f"{where}.sparse"), array, where)
        self._known[key] = array
        return array, normalized

    def _sparse(self, sparse: dict[str, Any], array: np.ndarray, where: str) -> np.ndarray:
        where = f"{where}.sparse"
        n = Json.count(sparse.get("count"), f"{where}.count")
        if n > len(array):
            raise SceneUnreadable(f"{where} replaces {n} of {len(array)} elements.")
        indices = Json.table(sparse.get("indices"), f"{where}.indices")
        component = indices.get("componentType")
        if component not in (5121, 5123, 5125):
            raise SceneUnreadable(f"{where}.indices have componentType {component!r:.40}.")
        at = self._elements_of(indices, np.dtype(_TYPES[component]), 1, n, f"{where}.indices")[:, 0].astype(np.int64)
        if n and at.max() >= len(array):
            raise SceneIndexOutOfRange(f"{where} replaces element {at.max()} of {len(array)}.")
        values = Json.table(sparse.get("values"), f"{where}.values")
        array = array.copy()
        array[at] = self._elements_of(values, array.dtype, array.shape[1], n, f"{where}.values")
        return array

    def floats(self, index: Any, widths: tuple[int, ...], where: str) -> np.ndarray:
        """Return (count, width) float32: normalized integers in [0, 1] or [-1, 1], others by value."""
        array, normalized = self.raw(index, where)
        if array.shape[1] not in widths:
            raise SceneUnreadable(f"{where} has {array.shape[1]} components.")
        if array.dtype.kind == "f":
            return array.astype(np.float32)
        if not normalized:
            return array.astype(np.float32)
        info = np.iinfo(array.dtype)
        return np.maximum(array.astype(np.float32) / np.float32(info.max), np.float32(-1.0))

    def indices(self, index: Any, where: str) -> np.ndarray:
        """Return (count,) int64."""
        array, _ = self.raw(index, where)
        if array.shape[1] != 1 or array.dtype.kind != "u":
            raise SceneUnreadable(f"{where} are not unsigned integers.")
        return array[:, 0].astype(np.int64)
