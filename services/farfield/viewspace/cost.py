"""What a cluster costs in a problem view: two binary searches over running costs, in any kernel."""

import numpy as np

from farfield.viewspace import kernels
from farfield.viewspace.model import ProblemViews


def cluster_cost(views: ProblemViews, v: int, a: int, b: int) -> int:
    """Return the cost bound of objects [a, b) in problem view v, in the model's unit.

    Inside numba call `farfield.viewspace.kernels.cluster_cost(row, object, before, cost, v, a, b)`.
    """
    return int(kernels.cluster_cost(views.row, views.object, views.before, views.cost, v, a, b))


def cluster_costs(views: ProblemViews, v: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (M,) i64: the cost of objects [a, b) in view v, for arrays of one shape (or scalars against them)."""
    v, a, b = (np.asarray(x, dtype=np.int64) for x in (v, a, b))
    v, a, b = (np.ascontiguousarray(x) for x in np.broadcast_arrays(v, a, b))
    out = np.empty(v.shape, dtype=np.int64)
    kernels.cluster_costs(
        views.row, views.object, views.before, views.cost, v.ravel(), a.ravel(), b.ravel(), out.reshape(-1)
    )
    return out
