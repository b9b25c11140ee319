"""base.ffc: whatever is done to it, it is read as it was written or refused by name."""

import hashlib
import json

import numpy as np
import pytest
from farfield.columns import pack, unpack
from farfield.errors import BaseUnfit, ColumnsAltered, PlacementFileError
from farfield.pipeline import STEPS
from farfield.placementdb.base import KIND, NAME, VERSION, BaseFiles, open_base
from farfield.placementdb.write import build, sealed
from farfield.stages import Stage
from placements import made_up


@pytest.fixture(scope="module")
def made():
    return made_up(n_objects=20, n_impostors=6, budget=14, wide=False, seed=4)


@pytest.fixture
def folder(made, tmp_path):
    files, base = build(**made)
    for name, content in files.items():
        (tmp_path / "placement" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "placement" / name).write_bytes(content)
    (tmp_path / NAME).write_bytes(base)
    return tmp_path


def restate(folder, content: bytes) -> None:
    """Write `content` as the base, and a manifest that vouches for it."""
    (folder / NAME).write_bytes(content)
    path = folder / "placement" / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["base"] |= {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    path.write_bytes(sealed(manifest))


def read_all(folder):
    files = BaseFiles(folder)
    base = files.read()
    return base, files.layers_of(np.arange(len(base.start)))


def test_it_is_read_as_it_was_written(made, folder):
    base, kept = read_all(folder)
    p = made["placement"]
    for name in ("kind", "view_cell", "bytes", "layers", "cost"):
        np.testing.assert_array_equal(getattr(base, name), getattr(p, name))
    shown = np.bincount(p.serve, minlength=len(p.cluster)) > 0
    assert not shown.all()
    np.testing.assert_array_equal(np.diff(base.cell_row) > 0, shown)
    np.testing.assert_array_equal(np.diff(kept.table.layer_row) > 0, shown)
    assert (
        open_base(folder, made["settings"]).sha256
        == json.loads((folder / "placement/manifest.json").read_text())["manifest_sha256"]
    )


def test_no_changed_bit_is_read(folder):
    whole = (folder / NAME).read_bytes()
    rng = np.random.default_rng(1)
    for at in rng.integers(0, len(whole), 100):
        content = bytearray(whole)
        content[at] ^= 1 << int(rng.integers(8))
        (folder / NAME).write_bytes(content)
        with pytest.raises(PlacementFileError):
            BaseFiles(folder)
    (folder / NAME).write_bytes(whole[:-8])
    with pytest.raises(PlacementFileError):
        BaseFiles(folder)
    (folder / NAME).unlink()
    with pytest.raises(PlacementFileError):
        BaseFiles(folder)


def test_columns_that_cannot_be_are_refused_though_the_manifest_vouches_for_them(folder):
    _, columns, meta = unpack((folder / NAME).read_bytes())
    for name, column in columns.items():
        bad = [
            {n: c for n, c in columns.items() if n != name},
            columns | {name: column.astype(np.float32).ravel()[:-1]},
        ]
        if len(column) > 1 and name not in ("origin_m",):
            bad.append(columns | {name: column[:-1]})
        for changed in bad:
            restate(folder, pack(KIND, changed, meta))
            with pytest.raises(ColumnsAltered):
                BaseFiles(folder)
    extreme = (
        "start",
        "stop",
        "cell",
        "cell_row",
        "table_layer_row",
        "table_corner_row",
        "table_page",
        "table_rect",
        "kind",
    )
    for name in extreme:
        restate(
            folder, pack(KIND, columns | {name: np.full_like(columns[name], np.iinfo(columns[name].dtype).max)}, meta)
        )
        with pytest.raises(ColumnsAltered):
            BaseFiles(folder)
    for name, value in (
        ("cost", -1),
        ("bytes", 0),
        ("view_cell", np.nan),
        ("cell", -1),
        ("table_page", -1),
        ("start", -1),
    ):
        restate(folder, pack(KIND, columns | {name: np.full_like(columns[name], value)}, meta))
        with pytest.raises(ColumnsAltered):
            BaseFiles(folder)
    restate(folder, pack(KIND, columns, meta))
    read_all(folder)


def test_a_base_of_another_version_is_refused(folder):
    _, columns, _ = unpack((folder / NAME).read_bytes())
    restate(folder, pack(KIND, columns, {"version": VERSION - 1}))
    with pytest.raises(BaseUnfit):
        BaseFiles(folder)
    path = folder / "placement" / "manifest.json"
    manifest = json.loads(path.read_text())
    del manifest["base"]
    path.write_bytes(sealed(manifest))
    with pytest.raises(BaseUnfit):
        BaseFiles(folder)


def test_steps_that_shape_an_impostor_have_a_version_of_the_base():
    """What was baked or counted by other code is not what would be now: red means that VERSION is to be raised, too."""
    shaping = (Stage.SCENE, Stage.HIERARCHY, Stage.RENDERTIME, Stage.CANDIDATES, Stage.BAKE)
    assert (VERSION, *(STEPS[stage].version for stage in shaping)) == (2, 4, 1, 2, 2, 8)
