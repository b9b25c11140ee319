"""The container: round trip, same content same bytes, and every damaged file is refused by name."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from farfield import columns
from farfield.columns import (
    DTYPES,
    dataclass_parts,
    files_parts,
    pack,
    pack_dataclass,
    unpack,
    unpack_dataclass,
    unpack_files,
)  # fmt: skip
from farfield.errors import ColumnsAltered, ColumnsTooNew, ColumnsTruncated, NotColumns, PlacementFileError
from farfield.executor import map_file
from farfield.scene.model import Scene
from hypothesis import given
from hypothesis import strategies as st
from towns import town

COLUMNS = {"b": np.arange(7, dtype=np.int16), "a": np.eye(3), "empty": np.zeros((0, 3), np.float32)}
FILE = pack("test", COLUMNS, {"n": 3})


@given(st.lists(st.sampled_from(DTYPES), min_size=1, max_size=8), st.integers(0, 5), st.integers(0, 2**32))
def test_columns_come_back_as_they_went(dtypes, rows, seed):
    rng = np.random.default_rng(seed)
    columns = {
        f"c{i}": rng.integers(0, 256, (rows, i + 1, np.dtype(d).itemsize), np.uint8).view(d) if d != "|b1"
        else rng.integers(0, 2, (rows, i + 1), np.uint8).astype(bool)
        for i, d in enumerate(dtypes)
    }  # fmt: skip
    kind, back, meta = unpack(pack("x", columns, {"seed": seed}))
    assert kind == "x" and meta == {"seed": seed} and set(back) == set(columns)
    for name, column in columns.items():
        assert back[name].dtype == column.dtype and back[name].shape == column.shape
        assert back[name].tobytes() == column.tobytes()


def test_order_of_columns_and_byte_order_do_not_change_the_bytes():
    turned = {name: COLUMNS[name].astype(COLUMNS[name].dtype.newbyteorder(">")) for name in reversed(COLUMNS)}
    assert pack("test", turned, {"n": 3}) == FILE


def test_every_column_begins_at_a_multiple_of_eight_bytes():
    for column in unpack(FILE)[1].values():
        assert (
            column.size == 0
            or column.__array_interface__["data"][0] % 8 == np.frombuffer(FILE, "u1").__array_interface__["data"][0] % 8
        )


def test_every_truncation_is_refused():
    for n in range(len(FILE)):
        with pytest.raises((ColumnsTruncated, NotColumns, ColumnsAltered)):
            unpack(FILE[:n])


def test_a_longer_a_newer_and_a_foreign_file_are_refused():
    with pytest.raises(ColumnsAltered):
        unpack(FILE + b"\0")
    with pytest.raises(ColumnsTooNew, match="version 9"):
        unpack(FILE[:8] + b"\x09" + FILE[9:])
    with pytest.raises(NotColumns):
        unpack(b"PK" + FILE[2:])


@given(st.integers(0, len(FILE) - 1), st.integers(1, 255))
def test_a_changed_byte_is_refused_or_harmless(at, change):
    damaged = bytearray(FILE)
    damaged[at] ^= change
    try:
        unpack(bytes(damaged))
    except PlacementFileError:
        pass


def test_a_dataclass_comes_back_and_another_class_is_refused():
    scene = town(9)
    data = pack_dataclass(scene)
    assert pack_dataclass(unpack_dataclass(Scene, data)) == data == b"".join(dataclass_parts(scene))
    assert pack_dataclass(replace(scene, dropped_triangles=1)) != data
    with pytest.raises(ColumnsAltered, match="holds test"):
        unpack_dataclass(Scene, FILE)


def test_files_come_back_in_the_order_of_their_names():
    files = {"b/c": b"123456789", "a": b"", "d": b"x"}
    packed = b"".join(files_parts(files))
    assert [(name, bytes(content)) for name, content in unpack_files(packed)] == sorted(files.items())
    with pytest.raises(ColumnsAltered):
        list(unpack_files(FILE))


def test_what_is_released_leaves_the_process_and_reads_the_same_again(tmp_path) -> None:
    values = np.arange(4 << 20, dtype=np.int64)  # 32 MiB
    (tmp_path / "f").write_bytes(columns.pack("k", {"a": values, "b": values[:9]}))
    mapped = columns.unpack(map_file(tmp_path / "f"))[1]
    mapped["a"].sum()
    before = _file_pages()
    columns.release(mapped["b"])  # a small file may stay
    assert before - _file_pages() < 25 << 20
    columns.release(mapped["b"], 16 << 20)  # any column: all lie in the one file
    assert before - _file_pages() > 25 << 20
    assert np.array_equal(mapped["a"], values)
    columns.release(values, 0)  # of no file
    columns.release(columns.unpack(columns.pack("k", {"a": values}))[1]["a"], 0)
    assert values[-1] == len(values) - 1


def _file_pages() -> int:
    line = next(x for x in Path("/proc/self/status").read_text().splitlines() if x.startswith("RssFile:"))
    return 1024 * int(line.split()[1])
