"""What a frame costs along a walk through the view space, with impostors and without: the sum that `verify` makes.

The walk is the same for every placement of one view space: a line from its low to its high corner, each point moved into
the nearest box, the camera turning to and fro by TURN as it goes.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from farfield.evaluation.verify import Eye
from farfield.evaluation.views import into
from farfield.placementdb.read import Placement

TURN, TURNS = math.radians(150), 3


def walk(view_space: np.ndarray, frames: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return `frames` positions (3, scene metres) and level directions (3, unit) through boxes (B,2,3)."""
    low, high = view_space[:, 0].min(0), view_space[:, 1].max(0)
    ahead = math.atan2(high[2] - low[2], high[0] - low[0])
    out = []
    for share in ((np.arange(frames) + 0.5) / frames).tolist():
        angle = ahead + TURN * math.sin(2 * math.pi * TURNS * share)
        out.append((into(view_space, low + (high - low) * share), np.array([math.cos(angle), 0.0, math.sin(angle)])))
    return out


def walk_costs(folder: Path, frames: int) -> dict[str, Any]:
    """Return {"placed": cost of each frame, "plain": the same without impostors, "hopeless": in a hopeless view}.

    Costs are in the budget's unit, per_frame included; what cannot be seen from the cell is left out in both.
    """
    placement = Placement.open(folder / "placement")
    eye = Eye(placement)
    placed, plain, hopeless = [], [], []
    for position, direction in walk(np.array(placement.manifest["view_space"], dtype=np.float64), frames):
        v = placement.lookup(position, direction)
        objects = np.flatnonzero(placement.seen_from(v.cell))
        bare = replace(v, objects=objects, levels=placement.levels_in(v.cell)[objects], impostors=v.impostors[:0])
        placed.append(eye.cost(v, position, direction)[0])
        plain.append(eye.cost(bare, position, direction)[0])
        hopeless.append(bool(v.hopeless))
    return {"placed": placed, "plain": plain, "hopeless": hopeless}
