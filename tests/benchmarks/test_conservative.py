"""Attack mode `conservative` on the development scenes: rays from anywhere in cells, at what the cells drop.

A cell's points below the ground are no camera points. The tracer is not watertight, so a hit on a dropped object
counts only if the segment meets nothing in float64 either.
"""

import os
import time
from pathlib import Path

import numpy as np
import pytest
from cutout import ROOT
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from farfield.geometry.cells import build_cells
from farfield.scene.read import read_scene
from farfield.settings import Settings, ViewSpaceSettings
from farfield.visibility.conservative import find_occluders, prove
from farfield.visibility.solids import place_triangles
from naive import conservative as naive

SCENES = Path(os.environ.get("FARFIELD_SCENES", ROOT.parent / "shared" / "scenes"))
_BATCH = 1_000_000


def tracer_of(corner):
    out = EmbreeScene()
    TriangleMesh(out, np.ascontiguousarray(corner.astype(np.float32)))
    return out


def unit(v):
    return (v / np.sqrt((v * v).sum(1))[:, None]).astype(np.float32)


class Attack:
    """Rays from a cell's box, its faces, edges and corners, at random points of dropped objects, tops preferred."""

    def __init__(self, level, cells, rng):
        self.placed, self.rng = place_triangles(level), rng
        opaque = self.placed.opaque
        self.corner, self.two_sided = self.placed.corner[opaque], self.placed.two_sided[opaque]
        self.object, self.tracer = self.placed.object[opaque], tracer_of(self.corner)
        occluders = find_occluders(level, cells)
        self.ground = None
        if occluders.columns is not None and occluders.columns.domain.any():
            solids = occluders.solids
            self.ground = tracer_of(solids.vertex[solids.triangle[solids.ground]])

    def rays(self, box, dropped, n):
        snap = self.rng.random((n, 3))
        p = box[0] + (box[1] - box[0]) * np.where(snap < 0.15, 0, np.where(snap > 0.85, 1, self.rng.random((n, 3))))
        t = self.rng.integers(0, len(self.placed.object), n)
        aim = np.flatnonzero(dropped[self.placed.object])
        if len(aim):
            t = np.where(self.rng.random(n) < 0.85, self.rng.choice(aim, n), t)
        corner = self.placed.corner[t]
        q = (corner * self.rng.dirichlet((0.5, 0.5, 0.5), n)[:, :, None]).sum(1)
        top = corner[np.arange(n), corner[:, :, 1].argmax(1)]
        q = np.where(self.rng.random((n, 1)) < 0.4, top, q)
        if self.ground is not None:
            up = np.tile(np.array([[0, 1, 0]], np.float32), (n, 1))
            above = (self.ground.run(p.astype(np.float32), up) < 0) & (self.ground.run(p.astype(np.float32), -up) >= 0)
            p, q = p[above], q[above]
        apart = np.abs(q - p).max(1) > 1e-6
        return p[apart], q[apart] - p[apart]

    def violations(self, box, keep, n):
        """Return how many of n rays reach a dropped object, and which objects they saw."""
        found, wrong = np.zeros(len(keep), bool), 0
        p, d = self.rays(box, ~keep, n)
        hit = self.tracer.run(p.astype(np.float32), unit(d)) if len(p) else np.zeros(0, np.int32)
        found[self.object[hit[hit >= 0]]] = True
        for r in np.flatnonzero((hit >= 0) & ~keep[self.object[hit]]):
            target = self.corner[hit[r]]
            edges = np.stack([target[1] - target[0], target[2] - target[0], -d[r]], 1)
            end = p[r] + d[r] * np.linalg.solve(edges, p[r] - target[0])[2]
            if naive.is_free(p[r], end, self.corner, self.two_sided):
                wrong += 1
            found[self.object[hit[r]]] = keep[self.object[hit[r]]]
        return wrong, found


@pytest.mark.scenes
@pytest.mark.parametrize(
    ("name", "cell_m", "n_cells", "rays", "least"),
    [
        ("munich-osm", 23.0, 20, 500_000, 0.9),
        ("san-francisco-osm", 23.0, 12, 500_000, 0.5),
        ("schependomlaan-bim", 2.0, 20, 500_000, 0.2),
    ],
)
def test_no_ray_reaches_what_is_dropped(name, cell_m, n_cells, rays, least, report):
    whole = (((-1.0, -0.6, -23.0), (22.9, 13.0, 1.0)),)
    view = ViewSpaceSettings(cell_m=cell_m, boxes=whole if "bim" in name else None)
    path = SCENES / name / "scene.glb"
    if not path.exists():
        pytest.skip(f"{name} of the development scenes is not there (FARFIELD_SCENES)")
    level = read_scene(path, settings=Settings(view_space=view))
    cells = build_cells(level.view_boxes, level.cell_m)
    rng = np.random.default_rng(1)
    attack = Attack(level, cells, rng)
    prove(level, cells, int(cells.leaf[0]), np.zeros((1, level.n_objects), bool))
    seconds, hidden, dropped, wrong = 0.0, 0, 0, 0
    for cell in rng.permutation(cells.n_cells)[:n_cells]:
        start = time.process_time()
        keep = prove(level, cells, int(cells.leaf[cell]), np.zeros((1, level.n_objects), bool))[0]
        seconds += time.process_time() - start
        found = np.zeros(level.n_objects, bool)
        for first in range(0, rays, _BATCH):
            bad, more = attack.violations(cells.cell_box[cell], keep, min(_BATCH, rays - first))
            wrong, found = wrong + bad, found | more
        hidden, dropped = hidden + int((~found).sum()), dropped + int((~found & ~keep).sum())
    share = dropped / hidden
    report(
        stage="visibility", work=f"conservative, proves {share:.2f} of the hidden pairs", input=name, seconds=seconds,
        rate=n_cells / seconds, unit="cells/s",
    )  # fmt: skip
    assert wrong == 0
    assert share >= least
