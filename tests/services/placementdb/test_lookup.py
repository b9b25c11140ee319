"""Both golden trees and generated placements answer lookups as the arrays do that went in."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from farfield.errors import DirectionInvalid, OutsideViewSpace
from farfield.placementdb.read import Placement
from farfield.placementdb.write import build_files
from naive.placementdb import lookup
from placements import made_up

GOLDEN = Path(__file__).parents[2] / "golden"


def save(files: dict[str, bytes], folder: Path) -> Path:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def answer(placement: Placement, position: Any, direction: Any) -> dict[str, Any]:
    v = placement.lookup(position, direction)
    return {
        "cell": v.cell, "interval": v.interval, "problem_view": v.problem_view, "hopeless": v.hopeless,
        "objects": v.objects.tolist(), "levels": v.levels.tolist(), "impostors": v.impostors.tolist(), "cost_bound": v.cost_bound,
    }  # fmt: skip


@pytest.mark.parametrize("name", ["placementdb", "placementdb-visible", "placementdb-detail", "placementdb-ktx2"])
def test_golden_lookups_are_answered(name: str) -> None:
    placement = Placement.open(GOLDEN / name)
    questions = json.loads((GOLDEN / name / "lookups.json").read_text())
    for q in questions["lookups"]:
        assert answer(placement, q["position"], q["direction"]).items() <= q.items()
    assert sum(bool(q["impostors"]) for q in questions["lookups"]) > 20  # it asks about something
    for position in questions["outside"]:
        with pytest.raises(OutsideViewSpace):
            placement.lookup(position, [1, 0, 0])
    for direction in questions["bad_directions"]:
        with pytest.raises(DirectionInvalid):
            placement.lookup(questions["lookups"][0]["position"], direction)


@pytest.mark.parametrize("seed", range(4))
def test_lookups_agree_with_the_arrays_that_were_written(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    size = rng.uniform(10, 90, (3, 3)) * [1, 0.1, 1]
    low = np.round(rng.uniform(-80, 60, (3, 3)), 1)
    boxes = np.stack([low, low + np.round(size)], axis=1)
    made = made_up(
        view_boxes=boxes, visible=bool(seed % 2), detail=seed > 1, seed=seed, n_impostors=7, wide=False, share=0.05
    )
    placement = Placement.open(save(build_files(**made), tmp_path))
    public = boxes + made["scene"].origin_m
    for _ in range(150):
        a, b = public[rng.integers(3)]
        position = np.where(rng.random(3) < 0.15, b, a + (b - a) * rng.random(3))
        direction = rng.normal(size=3)
        assert answer(placement, position, direction) == lookup(made, position, direction), f"{position=} {direction=}"


def test_a_point_of_the_public_view_space_is_never_outside(tmp_path: Path) -> None:
    made = made_up(origin_m=(1e7 + 0.1, -3.3, 7e6 + 0.7), n_impostors=3, wide=False)
    placement = Placement.open(save(build_files(**made), tmp_path))
    low, high = np.array(placement.manifest["view_space"][0])
    rng = np.random.default_rng(0)
    for _ in range(200):
        pick = rng.integers(0, 3, 3)
        position = np.where(pick == 0, low, np.where(pick == 1, high, low + (high - low) * rng.random(3)))
        assert 0 <= placement.find_cell(position) < made["cells"].n_cells


@pytest.mark.parametrize("bad", [[0, 0, 0], [np.nan, 1, 0], [1, np.nan, 0], [np.inf, 0, 0], [0, 1, -np.inf]])
def test_a_direction_without_direction_is_refused(bad: list[float]) -> None:
    with pytest.raises(DirectionInvalid):
        Placement.open(GOLDEN / "placementdb").find_interval(bad)


@pytest.mark.parametrize("bad", [[np.nan, 2, 0], [0, 99, 0], [np.inf, 2, -320]])
def test_a_position_outside_is_refused(bad: list[float]) -> None:
    with pytest.raises(OutsideViewSpace):
        Placement.open(GOLDEN / "placementdb").find_cell(bad)


def test_the_length_of_a_direction_does_not_matter() -> None:
    placement = Placement.open(GOLDEN / "placementdb")
    for d in np.random.default_rng(2).normal(size=(50, 3)):
        assert len({placement.find_interval(d * s) for s in (1, 2.0**-1000, 2.0**900)}) == 1


def test_a_placement_without_problem_views_is_valid_and_empty(tmp_path: Path) -> None:
    made = made_up(share=0.0, n_impostors=0)
    files = build_files(**made)
    placement = Placement.open(save(files, tmp_path))
    assert placement.check() == 4 == len(files)  # manifest and index; index and page of the geometry
    assert placement.manifest["verdict"] == "valid"
    assert placement.manifest["counts"]["impostors"] == 0 == len(placement.impostors)
    v = placement.lookup(placement.origin_m + np.array([0, 2, 0]), [1, 0, 0])
    assert v.problem_view is None
    assert len(v.impostors) == 0
    assert v.objects.tolist() == list(range(24))
    assert v.cost_bound == made["views"].worst_nonproblem + made["model"].per_frame


def test_impostors_are_those_that_went_in(tmp_path: Path) -> None:
    made = made_up(seed=4, share=0.2)
    baked, hierarchy, placement = made["baked"], made["hierarchy"], made["placement"]
    read = Placement.open(save(build_files(**made), tmp_path))
    assert len(read.impostors) == len(placement.cluster)
    shown = set(placement.serve.tolist())
    for i, impostor in enumerate(read.impostors):
        c = placement.cluster[i]
        assert impostor.objects.tolist() == list(range(hierarchy.start[c], hierarchy.stop[c]))
        assert impostor.bytes == placement.bytes[i]
        assert {layer.number for layer in impostor.layers} <= set(range(np.diff(baked.layer_row)[i]))
        assert bool(impostor.layers) == (i in shown)
        for layer in impostor.layers:
            k = baked.layer_row[i] + layer.number
            assert 3 <= len(layer.corners) == len(layer.uv) <= 8
            assert (layer.plane, layer.far) == (baked.plane[k], pytest.approx(baked.far[k], rel=1e-15))
            assert layer.near == pytest.approx(baked.near[k], rel=1e-15)
            x, y, w, h = layer.rect
            assert ((layer.uv >= [x, y]) & (layer.uv <= [x + w, y + h])).all()
            # The texture coordinate of a corner is the texel that the eye sees there.
            back = np.cross(baked.right[i], baked.up[i])
            assert -(layer.position @ back) == pytest.approx(layer.plane, rel=1e-6)
            slope = np.stack([layer.position @ baked.right[i], layer.position @ baked.up[i]], axis=-1) / layer.plane
            grid = (slope - baked.slope0[i]) / baked.texel[i]
            offset = np.asarray(layer.uv - grid)
            assert offset == pytest.approx(np.tile(np.round(offset[:1]), (len(offset), 1)), abs=1e-3)


def test_ten_thousand_lookups_take_seconds() -> None:
    placement = Placement.open(GOLDEN / "placementdb")
    low, high = np.array(placement.manifest["view_space"][0])
    rng = np.random.default_rng(1)
    for _ in range(10_000):  # about 30 microseconds each; the suite's time limit is the assertion
        placement.lookup(low + (high - low) * rng.random(3), rng.normal(size=3))
