"""Does occlusion pay? Measure on a few cells how much of the level's cost a cell sees.

Problem  Finding visible sets takes a minute; where most of the level is seen from everywhere they save nothing.
Method   12 cells spread over the view space, 131,072 view-like rays each from its free points. What is seen is the cost
         of the objects that were hit, and of those that were not but will be: Chao's estimate from how many were hit
         once and twice, at the mean cost of those hit once. The share of the whole, the mean over the cells.
Cost     of an object: its calls and triangles on the device `reference`, whatever the budget is in, so that another
         budget or device does not ask for other visible sets.
Errs     Either way by little: above `WORTH` most objects are seen and hidden ones save less than they take to find.
After    Chao. Nonparametric Estimation of the Number of Classes in a Population. Scand. J. Statist. 11, 1984.
"""

from dataclasses import replace

import numpy as np

from farfield.geometry.cells import CellTree
from farfield.rendertime.cost import build_cost_model
from farfield.scene.model import Scene
from farfield.settings import Settings
from farfield.visibility.free import build_pool, choose_rule, places_of, whole
from farfield.visibility.rays import Rays
from farfield.visibility.sample import view_directions

WORTH = 0.7  # of the cost: where a cell sees more, every cell is taken to see everything
N_CELLS, N_RAYS = 12, 2**17
_SPARE, _TRIES = 8, 256  # cells tried for one that is open; points tried in each


_measured: dict[tuple[str, int], float | None] = {}  # of the last scene: who asks whether also asks why


def seen_share(scene: Scene, cells: CellTree, *, seed: int, digest: str) -> float | None:
    """Return what `measure` does; `digest` names the scene, so that asking twice in a row costs once."""
    if (digest, seed) not in _measured:
        found = measure(scene, cells, seed=seed)
        _measured.clear()
        _measured[digest, seed] = found
    return _measured[digest, seed]


def reason_to_skip(share: float | None) -> str | None:
    """Return why the stage is not worth its time at this share of the cost, or None."""
    if share is None:
        return "visibility.mode is auto, and no cell that was tried has a free camera point"
    if share >= WORTH:
        return f"visibility.mode is auto, and cells see {share:.0%} of the level's cost: hiding the rest does not pay"
    return None


def measure(scene: Scene, cells: CellTree, *, seed: int) -> float | None:
    """Return the share of the objects' cost that a cell sees, in [0, 1]; None where no cell has a free camera point."""
    rays = Rays(scene)
    rng = np.random.default_rng([seed, 1])
    rule = choose_rule(rays, whole(scene.view_boxes, cell_m=scene.cell_m))
    # Evenly in the order of the tree, each with a few to replace it if it is closed.
    wanted = min(N_CELLS, cells.n_cells)
    which = np.unique(np.linspace(0, cells.n_cells - 1, min(cells.n_cells, wanted * _SPARE)).round().astype(np.int64))
    places = places_of(cells, scene.view_boxes, cell_m=scene.cell_m, which=which)
    pool = build_pool(rays, places, rule, rng, tries=_TRIES, last=0)
    chosen = [group[0] for group in np.array_split(pool.open, wanted) if len(group)]
    if not chosen:
        return None
    device = replace(Settings(), budget="1000000 ms", device="reference")
    cost = build_cost_model(scene, settings=device).object_fixed.astype(np.float64)
    return float(np.mean([_share(rays, pool.draw(np.full(N_RAYS, c), rng.random(N_RAYS)), cost, rng) for c in chosen]))


def _share(rays: Rays, origin: np.ndarray, cost: np.ndarray, rng: np.random.Generator) -> float:
    direction = view_directions(rng.random((len(origin), 4)))
    object, distance, _ = rays.seen(origin, direction)
    hits = np.bincount(object[object >= 0], minlength=len(cost))
    hits += np.bincount(rays.passed(origin, direction, distance)[1], minlength=len(cost))
    once, twice = hits == 1, int((hits == 2).sum())
    n = int(once.sum())
    unseen = n * n / (2 * twice) if twice else n * (n - 1) / 2
    hidden = float(cost[hits == 0].sum())
    more = min(hidden, unseen * float(cost[once].mean())) if n else 0.0
    return (float(cost[hits > 0].sum()) + more) / float(cost.sum())
