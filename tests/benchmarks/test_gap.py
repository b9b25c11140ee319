"""How far placements are from what is proven that none can weigh less than, on a fixed small set of scenes.

Run with: pytest tests/benchmarks/test_gap.py --bench -s. Each row has the placed bytes (estimates, as the bounds are) and
two bounds: over the candidates as generated, and over those and the placed impostors, which re-tightening made lighter.
"""

import os
import time
from pathlib import Path

import numpy as np
import pytest
from benchmarks.inputs import Level, cutout_level, town_level
from farfield.placement.antichain import subtree_end
from farfield.placement.bound import bound_of, lower_bound_bytes
from farfield.placement.choose import choose
from farfield.placement.curve import gather
from farfield.placement.rescue import rescue
from farfield.scene.read import read_scene
from farfield.settings import from_mapping

SCENES = Path(os.environ.get("FARFIELD_SCENES", Path(__file__).parents[3] / "shared" / "scenes"))
FOLIO_M = 64.0  # side of the square in the middle of its world


def real(name: str, **settings) -> Level:
    path = SCENES / name / "scene.glb"
    if not path.exists():
        pytest.skip(f"{name} of the development scenes is not there (FARFIELD_SCENES)")
    settings = from_mapping({"camera": {"width": 512, "height": 512}} | settings)
    return Level(f"{name} {settings.budget}", read_scene(path, settings=settings), settings)


def folio() -> Level:
    h = FOLIO_M / 2
    space = {"boxes": [[[-h, 0.0, -h], [h, 1.8, h]]], "cell_m": 4.0}
    return real("folio2025-world", budget="400 calls", view_space=space)


LEVELS = {
    "town of 100 houses, 40 calls": (lambda: town_level(100, budget="40 calls", view_m=32.0), 1.05),
    "town of 400 houses, 60 calls": (lambda: town_level(400, budget="60 calls"), 1.2),
    "town of 400 houses, 100 calls": (lambda: town_level(400), 1.2),
    "town of 1600 houses, 400 calls": (lambda: town_level(1600, view_m=96.0), 1.2),
    "cut-out of the demo city, 110 calls": (cutout_level, 1.2),
    "kenney-city, 60 calls": (lambda: real("kenney-city", budget="60 calls"), 1.25),
    "folio2025-world, 64 m of it, 400 calls": (folio, 1.3),
}


@pytest.mark.parametrize("name", LEVELS)
def test_placement_is_near_the_bound(name):
    make, most = LEVELS[name]
    level = make()
    candidates = level.candidates
    start = time.process_time()
    placement = level.placement
    placed_s = time.process_time() - start
    need = np.maximum(level.views.cost - placement.view_target, 0)
    end = subtree_end(level.hierarchy.start, level.hierarchy.stop)
    chosen = rescue(candidates, choose(candidates, excess=need, end=end).chosen, need=need, end=end)
    generated = lower_bound_bytes(candidates, *gather(candidates, chosen, len(need)), need=need, end=end)
    start = time.process_time()
    joint = bound_of(placement, level.hierarchy, level.views, candidates, method="auto")
    bound_s = time.process_time() - start
    bytes = int(placement.bytes.sum())
    print(
        f"\n{name}: {len(need):,} views, {len(candidates.cluster):,} candidates, {len(placement.cluster):,} impostors, "
        f"{bytes / 1e6:.2f} MB placed in {placed_s:.1f} s; bound {generated / 1e6:.2f} MB, ratio {bytes / generated:.3f}; "
        f"with the placed ones ({joint.method}, {bound_s:.1f} s) {joint.lower_bytes / 1e6:.2f} MB, "
        f"ratio {bytes / max(joint.lower_bytes, 1):.3f}"
    )
    assert joint.lower_bytes <= bytes <= most * generated
