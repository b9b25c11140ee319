"""The output of stage 4."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class VisibleSets:
    """The objects that each leaf cell can see. With mode "off" both arrays are empty and every cell sees every object."""

    mode: str
    row: np.ndarray  # (L+1,) i64, or (0,) when off
    object: np.ndarray  # (E,) i32  sorted within a row
