"""The output of stage 3."""

from dataclasses import dataclass

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

    @property
    def target(self) -> int:
        return self.budget - self.per_frame
