"""What a job of a sweep came to: counts and means of its artifacts, as JSON values."""

import math
from typing import Any

import numpy as np

from farfield.experiment.sweep import Ran
from farfield.stages import Stage

MAIN = (Stage.HIERARCHY, Stage.DETAIL, Stage.RENDERTIME, Stage.VISIBILITY, Stage.VIEWSPACE, Stage.CANDIDATES, Stage.PLACEMENT,
        Stage.BAKE, Stage.REPAIR, Stage.PLACEMENTDB)  # fmt: skip


def scene_counts(scene: Any) -> dict[str, int]:
    """Return what a page says of a scene."""
    return {"objects": int(scene.n_objects), "triangles": int(scene.object_triangles.sum())}


def facts_of(ran: Ran) -> dict[str, Any]:
    """Return the facts of a job that was run to its repair.

    boxes_share    of the impostors, how many have a box for a view cell; views_each: problem views that one is shown in
    overrun_mean   cost as geometry over the target - 1, mean over problem views; seen_mean: objects that a cell sees
    """
    inputs = ran.inputs()
    views, placement = inputs.get(Stage.VIEWSPACE), inputs.get(Stage.REPAIR)
    model, visible = inputs.get(Stage.RENDERTIME), inputs.get(Stage.VISIBILITY)
    n_objects = len(inputs.get(Stage.SCENE).object_box)
    n, count = len(views.cell), len(placement.cluster)
    hopeless = int(placement.hopeless.sum())
    seen = float(np.diff(visible.row).mean()) if len(visible.row) > 1 else float(n_objects)
    known = {str(s): ran.times[s].cpu_seconds for s in MAIN if s in ran.times}
    return {
        "problem_views": n, "hopeless": hopeless, "hopeless_share": hopeless / n if n else 0.0,
        "candidates": len(inputs.get(Stage.CANDIDATES).cluster), "impostors": count,
        "bytes": int(placement.bytes.sum()), "boxes_share": float((placement.kind == 1).mean()) if count else 0.0,
        "views_each": len(placement.serve) / count if count else 0.0,
        "layers_each": float(placement.layers.mean()) if count else 0.0,
        "overrun_mean": float((views.cost / max(model.target, 1)).mean() - 1) if n else 0.0,
        "seen_mean": seen, "skipped_visibility": ran.times[Stage.VISIBILITY].skipped,
        "cpu": known, "cpu_seconds": math.fsum(v for v in known.values() if v is not None),
    }  # fmt: skip
