"""Damaged, newer and missing files are refused by name; golden bytes pin the format."""

import hashlib
import importlib.util
import json
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from farfield.errors import ColumnsAltered, ColumnsTooNew, ColumnsTruncated, PlacementFileError, PlacementFileMissing
from farfield.placementdb.layout import MANIFEST
from farfield.placementdb.read import Placement
from farfield.placementdb.squeeze import expand, squeeze
from farfield.placementdb.write import build_files, sealed
from placements import made_up

GOLDEN = Path(__file__).parents[2] / "golden"


def golden_maker() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_placementdb", GOLDEN / "make_placementdb.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["placementdb", "placementdb-visible", "placementdb-detail", "placementdb-ktx2"])
def test_the_golden_tree_is_what_is_written_today(name: str) -> None:
    """Red means the format changed: raise VERSION, write the golden trees again, and change the TypeScript reader."""
    files, lookups = golden_maker().make(name)
    there = {str(p.relative_to(GOLDEN / name)): p.read_bytes() for p in (GOLDEN / name).rglob("*") if p.is_file()}
    assert json.loads(there.pop("lookups.json")) == json.loads(json.dumps(lookups))
    assert there == files
    assert sum(map(len, files.values())) < 200_000


def test_the_number_of_threads_does_not_show() -> None:
    made = made_up(seed=9)
    assert build_files(**made) == build_files(**made | {"threads": 3})


def test_nothing_of_the_machine_is_in_the_manifest() -> None:
    text = build_files(**made_up())[MANIFEST]
    assert not re.search(rb"/home|/work|/tmp|hostname|20[2-9]\d-", text)
    manifest = json.loads(text)
    assert text == json.dumps(manifest, sort_keys=True, separators=(",", ":")).encode() + b"\n"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for p in sorted((GOLDEN / "placementdb").rglob("*")):
        to = tmp_path / p.relative_to(GOLDEN / "placementdb")
        to.mkdir(exist_ok=True) if p.is_dir() else to.write_bytes(p.read_bytes())
    return tmp_path


def names(tree: Path) -> list[str]:
    return sorted(str(p.relative_to(tree)) for p in tree.rglob("*") if p.is_file() and p.name != "lookups.json")


def test_every_file_is_needed(tree: Path) -> None:
    assert Placement.open(tree).check() == len(names(tree))
    for name in names(tree):
        content = (tree / name).read_bytes()
        (tree / name).unlink()
        with pytest.raises(PlacementFileMissing, match=re.escape(name)):
            Placement.open(tree).check()
        (tree / name).write_bytes(content)


def test_truncations_are_refused_by_name(tree: Path) -> None:
    for name in names(tree):
        content = (tree / name).read_bytes()
        for length in {0, 1, 7, 15, 16, len(content) // 3, len(content) // 2, len(content) - 2, len(content) - 1}:
            (tree / name).write_bytes(content[:length])
            with pytest.raises(PlacementFileError, match=re.escape(name)) as error:
                Placement.open(tree).check()
            assert isinstance(error.value, ColumnsTruncated) or name == MANIFEST
        (tree / name).write_bytes(content)


def test_flipped_bits_are_refused_by_name(tree: Path) -> None:
    rng = np.random.default_rng(0)
    for name in names(tree):
        content = (tree / name).read_bytes()
        for at, bit in zip(rng.integers(0, len(content), 60), rng.integers(0, 8, 60), strict=True):
            flipped = bytearray(content)
            flipped[at] ^= 1 << bit
            (tree / name).write_bytes(bytes(flipped))
            with pytest.raises(PlacementFileError, match=re.escape(name)):
                Placement.open(tree).check()
        (tree / name).write_bytes(content)


def test_appended_bytes_are_refused(tree: Path) -> None:
    for name in names(tree):
        content = (tree / name).read_bytes()
        (tree / name).write_bytes(content + b" ")
        with pytest.raises(ColumnsAltered, match=re.escape(name)):
            Placement.open(tree).check()
        (tree / name).write_bytes(content)


def reseal(tree: Path, change: dict[str, Any]) -> None:
    manifest = json.loads((tree / MANIFEST).read_text())
    (tree / MANIFEST).write_bytes(sealed(manifest | change))


def test_a_newer_format_is_refused_as_newer(tree: Path) -> None:
    reseal(tree, {"version": 7})
    with pytest.raises(ColumnsTooNew, match=r"manifest\.json has format version 7"):
        Placement.open(tree)


@pytest.mark.parametrize(
    "change",
    [{"format": "other"}, {"format": None}, {"origin_m": [1, 2]}, {"interval_edges": [1.0, -1.0]}, {"view_space": []},
     {"index": {"file": "../index-0000000000000000.ffc", "bytes": 1, "sha256": "0"}}, {"chunks": [{}]}, {"counts": {}},
     {"counts": {"objects": 1, "cells": 21, "problem_views": 231, "impostors": 9}}, {"pages": 5}, {"cost_model": None}],
)  # fmt: skip
def test_a_manifest_that_makes_no_sense_is_refused(tree: Path, change: dict[str, Any]) -> None:
    reseal(tree, change)
    with pytest.raises(PlacementFileError):
        Placement.open(tree)


def forge(tree: Path, key: str, columns: dict[str, np.ndarray]) -> None:
    """Replace columns of the index or the first chunk, with right digests: what only the structure checks can see."""
    manifest = json.loads((tree / MANIFEST).read_text())
    entry = manifest["index"] if key == "index" else manifest["chunks"][0]
    kind, old, meta = expand((tree / entry["file"]).read_bytes(), entry["expanded"])
    content, entry["expanded"] = squeeze(kind, old | columns, meta)
    digest = hashlib.sha256(content).hexdigest()
    name = re.sub(r"[0-9a-f]{16}\.", digest[:16] + ".", entry["file"])
    (tree / name).write_bytes(content)
    entry.update(file=name, bytes=len(content), sha256=digest)
    (tree / MANIFEST).write_bytes(sealed(manifest))


def test_forged_columns_never_lead_to_more_than_a_refusal(tree: Path) -> None:
    """Whatever a well-sealed file holds, the reader refuses it or answers: no other exception, no endless descent."""
    rng = np.random.default_rng(5)
    manifest = (tree / MANIFEST).read_bytes()
    original = json.loads(manifest)
    low, high = np.array(original["view_space"][0])
    refused = 0
    for key, entry in (("index", original["index"]), ("chunk", original["chunks"][0])):
        _, columns, _ = expand((tree / entry["file"]).read_bytes(), entry["expanded"])
        for name, column in columns.items():
            if column.dtype.kind == "f" or not column.size:
                continue
            for _ in range(4):
                bad = column.copy()
                limits = np.iinfo(column.dtype)
                bad[rng.integers(len(bad))] = rng.choice([limits.min, limits.max, -1 if limits.min else 1, 0, 7])
                (tree / MANIFEST).write_bytes(manifest)
                forge(tree, key, {name: bad})
                try:
                    placement = Placement.open(tree)
                    for _ in range(20):
                        placement.lookup(low + (high - low) * rng.random(3), rng.normal(size=3))
                    list(placement.impostors)
                except PlacementFileError:
                    refused += 1
    assert refused > 40


def test_a_column_of_another_type_is_refused(tree: Path) -> None:
    forge(tree, "index", {"node_low": np.zeros(41)})
    with pytest.raises(ColumnsAltered, match="node_low"):
        Placement.open(tree)
