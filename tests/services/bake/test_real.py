"""Recording on scenes that others made: OpenGL, numba and first principles find the same texels in every layer."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cutout import ROOT
from farfield.bake import beside, coverage
from farfield.bake.bake import _surface
from farfield.bake.clip import bound, cut, gather
from farfield.bake.records import Pieces
from farfield.bake.sheets import lay_out
from farfield.bake.textures import decode
from farfield.candidates.model import BOX
from farfield.errors import ImpostorError
from farfield.hierarchy.build import build_hierarchy
from farfield.impostor.plan import plan_layers
from farfield.scene.read import read_scene
from farfield.settings import from_mapping
from naive import coverage as naive

SCENES = Path(os.environ.get("FARFIELD_SCENES", ROOT.parent / "shared" / "scenes"))
SETTINGS = from_mapping({"camera": {"width": 480, "height": 270}})

pytestmark = pytest.mark.scenes


def recorded(scene: Any, rng: np.random.Generator) -> Any:
    """Yield what is handed to `record` for some clusters of all sizes, seen from a cell beside each."""
    hierarchy = build_hierarchy(scene)
    size = hierarchy.stop - hierarchy.start
    few = [
        int(rng.choice(np.flatnonzero((size >= a) & (size < b))))
        for a, b in ((1, 2), (2, 8), (8, 64), (64, 10**9))
        if ((size >= a) & (size < b)).any()
    ]
    for cluster in few:
        box, reach = hierarchy.box[cluster], float(np.linalg.norm(np.diff(hierarchy.box[cluster], axis=0)))
        at = box.mean(0) + np.array([0.8, 0.3, 0.6]) * 1.5 * reach
        cell = np.array([*(at - 0.1 * reach), *(at + 0.1 * reach), 0, 0, 0])
        objects = int(hierarchy.start[cluster]), int(hierarchy.stop[cluster])
        try:
            plan = plan_layers(BOX, cell, box, settings=SETTINGS)
        except ImpostorError:
            continue
        sources = gather(scene, objects, plan, kind=BOX, view_cell=cell)
        pieces = cut(sources, plan)
        surface = _surface(scene, objects, decode(scene, np.unique(scene.primitive_material)))
        yield objects, box, plan, sources, pieces, bound(pieces, plan), surface


@pytest.mark.parametrize("name", ["kenney-city", "schependomlaan-bim", "folio2025-world", "munich-osm"])
def test_every_recorder_finds_the_same_texels(
    gl: Any, name: str, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    from farfield.bake.gl.record import Recorder

    if name in ("folio2025-world", "munich-osm") and not request.config.getoption("--accept"):
        pytest.skip("two scenes stand for four, but with --accept")
    path = SCENES / name / "scene.glb"
    if not path.exists():
        pytest.skip(f"{name} of the development scenes is not there (FARFIELD_SCENES)")
    scene = read_scene(path, settings=SETTINGS)
    rng = np.random.default_rng(0)
    layers = texels = 0
    for objects, box, plan, sources, pieces, slabs, surface in recorded(scene, rng):
        start = np.concatenate([[0], np.cumsum(slabs.size.astype(np.int64).prod(1))])
        for span, size in lay_out(slabs):
            sheet = coverage.record(sources, pieces, slabs, surface, span, size)
            np.testing.assert_array_equal(Recorder().record(sources, pieces, slabs, surface, span, size), sheet)
            layers, texels = layers + span[1] - span[0], texels + int((sheet > 0).sum())
        opaque = ~surface.masked[sources.material]
        for f in rng.permutation(len(pieces.source))[:60]:
            if not opaque[pieces.source[f]]:
                continue
            alone = Pieces(np.array([0, 1]), pieces.snapped[f : f + 1], pieces.source[f : f + 1])
            rect = bound(alone, type("One", (), {"near": plan.near[:1], "far": plan.far[:1], "slope0": plan.slope0,
                                                 "texel": plan.texel, "resolution": plan.resolution}))  # fmt: skip
            width, height = rect.size[0].tolist()
            if width * height > 2500:
                continue
            sheet = coverage.record(sources, alone, rect, surface, (0, 1), (width, height))
            found = {
                (int(i + rect.low[0, 0]), int(j + rect.low[0, 1])) for j, i in zip(*np.nonzero(sheet), strict=True)
            }
            assert found == naive.texels(pieces.snapped[f].tolist(), *plan.resolution.tolist())
        marks = beside.mark_beside(scene, objects, box, plan, slabs, start)
        with monkeypatch.context() as patch:  # however many objects at a time
            patch.setattr(beside, "BATCH", 1)
            np.testing.assert_array_equal(beside.mark_beside(scene, objects, box, plan, slabs, start), marks)
    assert layers > 5 and texels > 5000
