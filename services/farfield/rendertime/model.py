"""The output of stage 4."""

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class CostModel:
    """What drawing costs, in integers of `unit`, each bound rounded up [placement.md section 3].

    cost of a frame = per_frame + sum of object costs + sum of impostor costs. `target` = budget - per_frame, so all
    costs elsewhere leave per_frame out.
    """

    unit: str  # "ns", "calls" or "triangles"
    budget: int
    per_frame: int
    per_call: float
    per_triangle: float
    per_pixel: float
    per_impostor: float
    per_impostor_triangle: float
    per_impostor_pixel: float
    object_fixed: np.ndarray  # (N,) i64  ceil(calls * per_call + triangles * per_triangle)
    fov_deg: float  # vertical
    width: int
    height: int
    # coarser levels of objects: object o, no nearer to a cell than level_from[k], is drawn there as level k of its rows
    level_row: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))  # (N+1,) i64, or (0,) without levels
    level_from: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (K,) f64  metres, ascending within an object
    level_fixed: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))  # (K,) i64  as object_fixed
    level_triangles: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))  # (K,) i64

    @property
    def target(self) -> int:
        return self.budget - self.per_frame
