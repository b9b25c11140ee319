"""The output of stage 2."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class Hierarchy:
    """C = 2 N - 1 clusters over N objects, as preorder nodes: the root is node 0, a left child follows its parent.

    A leaf holds exactly one object. Cluster c is the object range [start[c], stop[c]).
    """

    start: np.ndarray  # (C,) i32
    stop: np.ndarray  # (C,) i32
    left: np.ndarray  # (C,) i32  node, -1 at a leaf
    right: np.ndarray  # (C,) i32  node, -1 at a leaf
    parent: np.ndarray  # (C,) i32  node, -1 at the root
    box: np.ndarray  # (C,2,3) f64  relative to the scene's origin_m
    calls: np.ndarray  # (C,) i64
    triangles: np.ndarray  # (C,) i64
    bytes: np.ndarray  # (C,) i64
    replaceable: np.ndarray  # (C,) b1  every object of it can be baked
