"""How tight is the bound of a problem view? Against the union of densely sampled views of the same cell and interval.

Problem  A problem view stands for every camera in a cell that looks along an interval; its stated cost as plain geometry is
         a bound over all of them. By how much is it above what those cameras draw together, and above the worst of them?
Method   Cameras at random positions and directions of the cell and interval, every other one at their corners. The union is
         every object that one of them draws, at its largest share of the screen; priced by the manifest's cost model.
Tried    70 houses, cells of 8 m and 2 m: 100, 400 and 1600 cameras a view give medians that differ by less than 0.0002.
Errs     The union grows with the samples: ratios are too large for few of them, never too small. Below 1 is a defect.
"""

from itertools import product
from typing import Any

import numpy as np

from farfield.evaluation import kernels
from farfield.evaluation.verify import Eye
from farfield.evaluation.views import direction_in
from farfield.placementdb.read import Placement

SAMPLES = 100  # cameras of one problem view


def bound_over_union(placement: Placement, *, views: int, seed: int = 0, samples: int = SAMPLES) -> dict[str, Any]:
    """Return what the stated bounds of `views` random problem views are, over the union and the worst of `samples` cameras.

    JSON values: views, samples, cell_m (largest side of a cell), interval_deg; median, p95, least and most of `over_union` and
    `over_worst`; below_one counts views whose bound is under the union: 0, or a defect; wrongly_flagged, those of which no
    camera costs more than the budget.
    """
    found = bound_ratios(placement, views=views, seed=seed, samples=samples)
    sides = np.diff(placement.index["node_box"][placement.index["cell_node"]], axis=1)
    return {
        "views": len(found["union"]), "of_views": found["of_views"], "samples": samples, "seed": seed,
        "cell_m": float(sides.max()), "interval_deg": 90 / (len(placement.manifest["interval_edges"]) - 1),
        "below_one": sum(r < 1 for r in found["union"]), "wrongly_flagged": found["wrongly_flagged"],
        "over_union": _spread(found["union"]), "over_worst": _spread(found["worst"]),
    }  # fmt: skip


def bound_ratios(placement: Placement, *, views: int, seed: int = 0, samples: int = SAMPLES) -> dict[str, Any]:
    """Return the ratios themselves, `union` and `worst`, in order of the problem views; see `bound_over_union`."""
    eye, rng = Eye(placement), np.random.default_rng(seed)
    last = [entry["views"][1] for entry in placement.manifest["chunks"]]
    count = last[-1] if last else 0
    chosen = np.sort(rng.choice(count, min(views, count), replace=False)) if count else np.zeros(0, np.int64)
    over_union, over_worst, calm = [], [], 0
    budget, per_frame = int(placement.manifest["budget"]["amount"]), float(eye.price["per_frame"])
    for v in chosen.tolist():
        k = int(np.searchsorted(last, v, side="right"))
        chunk, entry = placement.chunk(k), placement.manifest["chunks"][k]
        local = v - entry["views"][0]
        cell = entry["cells"][0] + int(np.searchsorted(chunk["cell_view"], local, side="right")) - 1
        union, worst = _drawn(eye, cell, int(chunk["view_interval"][local]), rng, samples)
        if union > 0:
            stated = int(chunk["view_geometry_cost"][local])
            over_union.append(stated / union)
            over_worst.append(stated / worst)
            calm += worst + per_frame <= budget
    return {"of_views": count, "union": over_union, "worst": over_worst, "wrongly_flagged": int(calm)}


def _spread(ratios: list[float]) -> dict[str, float] | None:
    if not ratios:
        return None
    return {
        "median": float(np.median(ratios)), "p95": float(np.percentile(ratios, 95)), "least": min(ratios), "most": max(ratios),
    }  # fmt: skip


def _drawn(eye: Eye, cell: int, interval: int, rng: np.random.Generator, samples: int) -> tuple[float, float]:
    """Return (cost of all that some camera draws, cost of what the dearest one draws), per_frame left out."""
    placement = eye.placement
    box = placement.index["node_box"][placement.index["cell_node"][cell]]
    objects, levels = np.flatnonzero(placement.seen_from(cell)), placement.levels_in(cell)
    fixed = eye.geometry_costs(objects, levels[objects])
    pixel = float(eye.price["per_pixel"] * eye.pixels)
    corners = list(product((0.0, 1.0), repeat=5))
    at = [np.array(corners[s // 2 % 32]) if s % 2 else rng.random(5) for s in range(samples)]
    frames = np.array([eye.frame(direction_in(placement, interval, a[3], a[4])) for a in at])
    eyes, largest = np.array([box[0] + (box[1] - box[0]) * a[:3] for a in at]), np.full(len(objects), -1.0)
    worst = kernels.cameras_share(placement.index["object_box"], objects, eyes, frames, fixed, pixel, largest)
    some = largest >= 0
    return float(fixed[some].sum() + pixel * largest[some].sum()), float(worst)
