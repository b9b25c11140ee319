"""The one binary container of farfield: named, typed arrays that a reader maps without copying.

Layout   8 bytes magic, uint32 format version, uint32 header length, header (UTF-8 JSON, keys sorted), zero padding,
         then each column, little-endian, C order, at an 8-byte aligned offset from the start of the file.
Use      Artifacts that stages hand to each other, and the chunks of the placement database. The same content gives
         the same bytes: no time, no address, no order of a dict enters.
"""

import dataclasses
import json
import mmap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from farfield.errors import ColumnsAltered, ColumnsTooNew, ColumnsTruncated, NotColumns

MAGIC = b"FARFIELD"
FORMAT_VERSION = 1
ALIGNMENT = 8
RELEASED_BYTES = 128 << 20  # of a file; what is smaller may stay
WALKED_BYTES = 64 << 20  # written until what was read is given back
DTYPES = ("|b1", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f4", "<f8")

T = TypeVar("T")

# A file about to be written: its pieces in order. Joined they are the container; written one by one they cost no copy.
Parts = Sequence[bytes | memoryview]


def _aligned(n: int) -> int:
    return -(-n // ALIGNMENT) * ALIGNMENT


def pack(kind: str, columns: Mapping[str, np.ndarray], meta: Mapping[str, Any] | None = None) -> bytes:
    """Return the container's bytes. `kind` names what it holds; `meta` is JSON of small values."""
    return b"".join(pack_parts(kind, columns, meta))


Column = np.ndarray | Sequence[np.ndarray]  # an array, or several of one type to be written one after the other


@dataclasses.dataclass(frozen=True, slots=True)
class _Block:
    """A column about to be written."""

    name: str
    arrays: list[np.ndarray]

    @property
    def nbytes(self) -> int:
        return sum(a.nbytes for a in self.arrays)

    def row(self, offset: int) -> dict[str, Any]:
        first = self.arrays[0]
        shape = list(first.shape)
        if len(self.arrays) > 1:
            shape[0] = sum(len(a) for a in self.arrays)
        return {"dtype": first.dtype.str, "name": self.name, "offset": offset, "shape": shape}


def _block(name: str, column: Column) -> _Block:
    arrays = []
    for given in [column] if isinstance(column, np.ndarray) else column:
        array = np.ascontiguousarray(given, dtype=given.dtype.newbyteorder("<")).reshape(given.shape)
        if array.dtype.str not in DTYPES:
            raise TypeError(f"column {name} has type {array.dtype}, which the container does not hold")
        arrays.append(array)
    assert len({(a.dtype, a.shape[1:]) for a in arrays}) == 1
    return _Block(name, arrays)


def pack_parts(kind: str, columns: Mapping[str, Column], meta: Mapping[str, Any] | None = None) -> Parts:
    """Return what `pack` returns, as pieces that are still views of the columns."""
    blocks = [_block(name, columns[name]) for name in sorted(columns)]

    def header(offsets: list[int], total: int) -> bytes:
        table = [block.row(offset) for block, offset in zip(blocks, offsets, strict=True)]
        text = {"bytes": total, "columns": table, "kind": kind, "meta": dict(meta or {})}
        return json.dumps(text, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()

    def layout(start: int) -> tuple[list[int], int]:
        offsets, at = [], start
        for block in blocks:
            offsets.append(at)
            at = _aligned(at + block.nbytes)
        return offsets, at

    # The header's length depends on the digits of the offsets: widen the start until both agree.
    start = 0
    while True:
        offsets, total = layout(start)
        head = header(offsets, total)
        needed = _aligned(16 + len(head))
        if needed <= start:
            break
        start = needed
    front = MAGIC + FORMAT_VERSION.to_bytes(4, "little") + len(head).to_bytes(4, "little") + head
    parts: list[bytes | memoryview] = [front, bytes(start - len(front))]
    for block in blocks:
        parts += [a.reshape(-1).view(np.uint8).data for a in block.arrays if a.nbytes]
        parts.append(bytes(_aligned(block.nbytes) - block.nbytes))
    return parts


def unpack(buffer: Any, *, where: str = "buffer") -> tuple[str, dict[str, np.ndarray], dict[str, Any]]:
    """Return (kind, columns, meta); the columns are read-only views into `buffer` (bytes, mmap or uint8 array).

    Raises NotColumns, ColumnsTooNew, ColumnsTruncated, ColumnsAltered; each names `where`.
    """
    view = (
        np.ascontiguousarray(buffer).view(np.uint8).data
        if isinstance(buffer, np.ndarray)
        else memoryview(buffer).cast("B")
    )
    if len(view) < 16 or bytes(view[:8]) != MAGIC:
        raise NotColumns(where)
    version = int.from_bytes(view[8:12], "little")
    if version != FORMAT_VERSION:
        raise ColumnsTooNew(where, version, FORMAT_VERSION)
    length = int.from_bytes(view[12:16], "little")
    if len(view) < 16 + length:
        raise ColumnsTruncated(where, len(view), 16 + length)
    try:
        head = json.loads(bytes(view[16 : 16 + length]))
        total, kind, meta, table = int(head["bytes"]), str(head["kind"]), dict(head["meta"]), list(head["columns"])
    except (ValueError, KeyError, TypeError, UnicodeDecodeError, RecursionError) as error:
        raise ColumnsAltered(where, "its header is not readable") from error
    if len(view) < total:
        raise ColumnsTruncated(where, len(view), total)
    if len(view) > total:
        raise ColumnsAltered(where, "it is longer than its header says")
    columns: dict[str, np.ndarray] = {}
    for entry in table:
        try:
            name, dtype, shape, offset = str(entry["name"]), entry["dtype"], tuple(entry["shape"]), entry["offset"]
            valid = dtype in DTYPES and all(type(n) is int and n >= 0 for n in shape)
            valid = valid and type(offset) is int and offset >= 16 + length and offset % ALIGNMENT == 0
        except (KeyError, TypeError) as error:
            raise ColumnsAltered(where, "its column table is not readable") from error
        if not valid:
            raise ColumnsAltered(where, f"column {name} has an impossible type, shape or offset")
        count = 1
        for n in shape:
            count *= n
        if offset + count * np.dtype(dtype).itemsize > total:
            raise ColumnsAltered(where, f"column {name} ends past the end of the file")
        array = np.frombuffer(view, dtype=dtype, count=count, offset=offset).reshape(shape)
        array.flags.writeable = False
        columns[name] = array
    return kind, columns, meta


def release(array: np.ndarray, least_bytes: int = RELEASED_BYTES) -> None:
    """Take the pages of the mapped file that `array` is a view of out of this process, if the file has `least_bytes`.

    They stay in the system's cache, and the next read brings them back: for stages that walk through files in parts.
    """
    held: Any = array
    while held is not None and not isinstance(held, mmap.mmap):
        held = held.obj if isinstance(held, memoryview) else getattr(held, "base", None)
    if held is not None and len(held) >= least_bytes and hasattr(mmap, "MADV_DONTNEED"):
        held.madvise(mmap.MADV_DONTNEED)


class Walked(list[bytes | memoryview]):
    """Parts of mapped files that are given back as they are written: while one is asked for, few others are held."""

    def __init__(self, parts: Parts, arrays: Sequence[np.ndarray]) -> None:
        """arrays  one of each mapped file that the parts are views of"""
        super().__init__(parts)
        self._arrays = arrays

    def __iter__(self) -> Iterator[bytes | memoryview]:
        held = 0
        for part in super().__iter__():
            yield part
            held += len(part)
            if held > WALKED_BYTES:
                held = 0
                for array in self._arrays:
                    release(array, 0)


def pack_dataclass(record: Any) -> bytes:
    """Return the container of a frozen dataclass: arrays become columns, everything else becomes meta."""
    return b"".join(dataclass_parts(record))


def dataclass_parts(record: Any, **columns: Column) -> Parts:
    """Return what `pack_dataclass` returns, as pieces that are still views of the arrays; `columns` replace its own."""
    meta: dict[str, Any] = {}
    for field in dataclasses.fields(record):
        if field.name in columns:
            continue
        value = getattr(record, field.name)
        if isinstance(value, np.ndarray):
            columns[field.name] = value
        else:
            meta[field.name] = value
    return pack_parts(type(record).__name__, columns, meta)


def unpack_dataclass(cls: type[T], buffer: Any, *, where: str = "buffer") -> T:
    """Return the dataclass that `pack_dataclass` wrote; lists in meta become tuples.

    Raises as `unpack` does, and ColumnsAltered where kind or fields differ.
    """
    kind, columns, meta = unpack(buffer, where=where)
    if kind != cls.__name__:
        raise ColumnsAltered(where, f"it holds {kind}, not {cls.__name__}")
    names = {field.name for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
    if names != set(columns) | set(meta):
        raise ColumnsAltered(where, f"its fields are not those of {cls.__name__}")
    return cls(**columns, **{k: _frozen(v) for k, v in meta.items()})


def _frozen(value: Any) -> Any:
    if not isinstance(value, list):
        return value
    nested = list in set(map(type, value))  # a level has a name for each of its objects, and every shard reads them
    return tuple(map(_frozen, value)) if nested else tuple(value)


def files_parts(files: Mapping[str, bytes]) -> Parts:
    """Return a container of named files (kind "files"), in the order of their names."""
    names = sorted(files)
    row = np.cumsum([0, *(len(files[name]) for name in names)], dtype=np.int64)
    data = np.frombuffer(b"".join(files[name] for name in names), dtype=np.uint8)
    return pack_parts("files", {"data": data, "row": row}, {"names": names})


def unpack_files(buffer: Any, *, where: str = "buffer") -> Iterable[tuple[str, memoryview]]:
    """Yield (name, content) of what `files_parts` wrote; contents are views into `buffer`. Raises as `unpack` does."""
    kind, columns, meta = unpack(buffer, where=where)
    names = meta.get("names")
    if kind != "files" or not isinstance(names, list) or len(columns["row"]) != len(names) + 1:
        raise ColumnsAltered(where, "it is not a container of files")
    data = columns["data"].data
    for name, start, stop in zip(names, columns["row"][:-1], columns["row"][1:], strict=True):
        yield name, data[int(start) : int(stop)]


def files_table(read: Callable[[int, int], bytes], *, where: str = "buffer") -> dict[str, tuple[int, int]]:
    """Return name -> [start, stop) in bytes of what `files_parts` wrote, of which `read(start, stop)` gives any part.

    For containers that are far away: it asks for their table only. Raises NotColumns, ColumnsTooNew, ColumnsAltered.
    """
    front = read(0, 16)
    if len(front) < 16 or front[:8] != MAGIC:
        raise NotColumns(where)
    version, length = (int.from_bytes(front[i : i + 4], "little") for i in (8, 12))
    if version != FORMAT_VERSION:
        raise ColumnsTooNew(where, version, FORMAT_VERSION)
    try:
        head = json.loads(read(16, 16 + length))
        names, column = head["meta"]["names"], {c["name"]: c for c in head["columns"]}
        at, start = int(column["row"]["offset"]), int(column["data"]["offset"])
        rows = np.frombuffer(read(at, at + 8 * (len(names) + 1)), "<i8")
        return {name: (start + int(a), start + int(b)) for name, a, b in zip(names, rows[:-1], rows[1:], strict=True)}
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ColumnsAltered(where, "it is not a container of files") from error
