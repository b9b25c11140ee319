"""The proof passes impostors that show their geometry, and catches those that do not."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from farfield.bake.gl import context as gl_context
from farfield.columns import Parts, unpack
from farfield.evaluation import kernels
from farfield.evaluation.proof import judge, prove
from farfield.evaluation.proof.merge import PICTURES, merge_proofs, upper_share
from farfield.evaluation.proof.pairs import Shown, rect_of
from farfield.executor import file_digest
from farfield.pipeline import STEPS
from farfield.placementdb.read import Placement
from farfield.scene.write import write_glb
from farfield.settings import from_mapping
from farfield.stages import Stage
from farfield.steps.model import Inputs
from farfield.steps.result import write_files
from towns import town

SETTINGS = from_mapping({
    "budget": "60 calls", "camera": {"width": 320, "height": 180}, "visibility": {"mode": "off"}, "placement": {"bound": "off"},
    "view_space": {"cell_m": 16.0, "boxes": [[[-8.0, 27.0, -8.0], [24.0, 30.0, 8.0]]]}, "proof": {"pairs": 20},
})  # fmt: skip


def joined(parts: Parts) -> bytes:
    return b"".join(bytes(p) for p in parts)


class Job:
    """The stages of a job one after the other in this process."""

    def __init__(self, scene: Path) -> None:
        self.artifacts: dict[Stage, Any] = {}
        self.inputs = Inputs(SETTINGS, self.artifacts, {Stage.SCENE: file_digest(scene)}, scene)

    def run(self, stage: Stage) -> Any:
        step = STEPS[stage]
        shards = [] if step.skip(self.inputs) else step.plan(self.inputs)
        pieces = [joined(step.run(self.inputs, shard)) for shard in shards]
        self.artifacts[stage] = joined(step.merge(self.inputs, pieces)) if step.merge else pieces[0]
        digests: Any = self.inputs.digests
        digests[stage] = "0" * 64
        return self.artifacts[stage]


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    folder = tmp_path_factory.mktemp("town")
    (folder / "town.glb").write_bytes(write_glb(town(144)))
    job = Job(folder / "town.glb")
    for stage in list(Stage)[: list(Stage).index(Stage.PLACEMENTDB) + 1]:
        job.run(stage)
    return job


@pytest.fixture(scope="module")
def folder(job: Job, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("placed")
    write_files(job.artifacts[Stage.PLACEMENTDB], folder)
    return folder


@pytest.fixture
def prover(gl: Any, folder: Path) -> prove.Prover:
    return prove.Prover(folder)


def tried(prover: prove.Prover, pairs: int) -> Mapping[str, Any]:
    return merge_proofs([prover.prove(0, pairs, seed=3, each=0)], confidence=0.95)


def test_sound_impostors_pass_in_any_cut(prover: prove.Prover, folder: Path) -> None:
    found = tried(prover, 24)
    assert found["pairs"] > 16 and found["impostors"] > 5
    assert (found["crack_px"], found["failed"], found["failed_impostors"]) == (0, 0, [])
    assert 0.2 < found["worst_displacement_px"] <= found["allowed_px"] == 1.0
    assert 0 < found["mean_displacement_px"] < found["worst_displacement_px"]
    assert found["wrong_texels"] == 0 and found["open_texels"] < 0.3 * found["texels"]
    assert found["pairs_in_view"] > 5 and 0 < found["flip"] < 0.2
    assert len(found["worst"]) == PICTURES
    assert found["worst"][0]["pictures"]["difference"].startswith("data:image/webp;base64,")
    parts = [prove.prove(folder, first, 12, seed=3, each=0) for first in (0, 12)]
    again = merge_proofs(parts, confidence=0.95)
    pictures = "worst"  # a shard keeps those of its own worst
    assert {k: v for k, v in again.items() if k != pictures} == {k: v for k, v in found.items() if k != pictures}


def test_a_lost_texel_is_a_crack(prover: prove.Prover, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every 9th column of every page is empty: impostors fail, and their pairs say so."""
    read = Placement.page

    def holed(self: Placement, k: int) -> np.ndarray:
        image = read(self, k).copy()
        image[:, ::9] = 0
        return image

    monkeypatch.setattr(Placement, "page", holed)
    found = tried(prover, 12)
    assert found["crack_px"] > 10 and found["failed"] > 3
    assert found["worst"][0]["failed"] and found["worst"][0]["impostor"] in found["failed_impostors"]
    assert found["failing_share_upper"] > found["failed"] / found["pairs"]


def test_a_layer_out_of_place_is_displaced(prover: prove.Prover, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planes twice as far from the eye as they should be: right from the eye, wrong from elsewhere."""
    every = prover.placement.impostors
    moved = [
        replace(i, layers=tuple(replace(a, plane=2 * a.plane, position=2 * a.position) for a in i.layers))
        for i in every
    ]
    monkeypatch.setattr(prover.placement, "impostors", moved)
    found = tried(prover, 12)
    assert found["worst_displacement_px"] > 1.2 and found["failed"] > 3


def test_texels_at_a_wrong_depth_are_counted(prover: prove.Prover, monkeypatch: pytest.MonkeyPatch) -> None:
    read = Placement.page

    def flat(self: Placement, k: int) -> np.ndarray:
        image = read(self, k).copy()
        image[..., 3][image[..., 3] > 0] = 252  # all at the near end of their slab
        return image

    sound = tried(prover, 8)
    monkeypatch.setattr(Placement, "page", flat)
    prover._page_of.clear()
    prover.drawer._pages.clear()
    found = tried(prover, 8)
    assert found["wrong_texels"] > 20 * max(sound["wrong_texels"], 1)
    assert sound["failed"] == 0 and found["failed"] > 3


def test_pairs_are_where_the_impostor_is_shown(folder: Path) -> None:
    placement = Placement.open(folder)
    shown = Shown(placement)
    assert set(shown.impostors) == set(np.flatnonzero(placement.index["impostor_chunk"] >= 0))
    boxes = np.array(placement.manifest["view_space"])
    for k in range(60):
        pair, seen = shown.pair(k, 7, 0)
        assert ((boxes[:, 0] <= pair.position) & (pair.position <= boxes[:, 1])).all(1).any()
        assert not seen or pair.impostor in placement.lookup(pair.position, pair.direction).impostors
        assert not seen or rect_of(placement, pair) is not None
    ordered = [shown.pair(k, 7, 2)[0].impostor for k in range(2 * len(shown.impostors))]
    assert ordered == np.repeat(shown.impostors, 2).tolist()


def test_the_stage_states_what_it_found_and_where_there_is_no_opengl(
    gl: Any, job: Job, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = unpack(job.run(Stage.PROOF))[2]
    assert found["pairs"] + found["unseen"] == 20 and found["failed"] == 0 and "OpenGL" in found["renderer"]

    def none(*given: Any) -> Any:
        raise gl_context.NoContext("no driver")

    monkeypatch.setattr(prove, "Drawer", none)
    without = merge_proofs([prove.prove(folder, 0, 20, seed=0, each=0)], confidence=0.95)
    assert (without["pairs"], without["failed"], without["failing_share_upper"]) == (0, 0, 1.0)
    assert "no driver" in without["not_proven"]


def test_pixels_inside_have_all_their_neighbours() -> None:
    rng = np.random.default_rng(0)
    solid = rng.random((30, 40)) < 0.97
    for reach in (1, 2):
        wanted = np.zeros_like(solid)
        for y in range(reach, 30 - reach):
            for x in range(reach, 40 - reach):
                wanted[y, x] = solid[y - reach : y + reach + 1, x - reach : x + reach + 1].all()
        np.testing.assert_array_equal(judge.inside(solid, reach), wanted)


def test_surfaces_within_a_reach_are_those_that_their_points_say() -> None:
    """Against a fine grid of points of each triangle; segments, points and slivers among them."""
    rng = np.random.default_rng(2)
    weight = np.array([(i / 60, j / 60, 1 - (i + j) / 60) for i in range(61) for j in range(61 - i)])
    for k in range(60):
        corner = rng.normal(size=(2, 3, 3))
        if k % 3 == 1:
            corner[:, 2] = corner[:, 0] + 0.3 * (corner[:, 1] - corner[:, 0])
        if k % 6 == 2:
            corner[0] = corner[0, 0]
        point = rng.normal(size=(20, 3)) * 1.5
        nearest = np.sqrt((((weight @ corner)[None] - point[:, None, None]) ** 2).sum(-1).min((1, 2)))
        found = np.zeros(20, bool)
        kernels.surface_within(point, nearest * (1 + 1e-9), corner, found)
        assert found.all()
        spacing = np.abs(np.diff(corner[:, [0, 1, 2, 0]], axis=1)).max() / 60 * 2  # of the grid: none is nearer by more
        kernels.surface_within(point, np.maximum(nearest - spacing, 0), corner, found)
        assert not found[nearest > 1.5 * spacing].any()


def test_the_bound_of_the_failing_share_holds_as_often_as_it_says() -> None:
    assert upper_share(0, 100, 0.95) == pytest.approx(1 - 0.05 ** (1 / 100))
    assert upper_share(0, 0, 0.95) == upper_share(5, 5, 0.95) == 1.0
    rng = np.random.default_rng(1)
    for share in (0.01, 0.2):
        failed = rng.binomial(50, share, 4000)
        held = np.mean([upper_share(int(f), 50, 0.9) >= share for f in failed])
        assert held >= 0.9 - 0.015
