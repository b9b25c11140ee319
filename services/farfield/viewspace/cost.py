"""What clusters and objects cost in a problem view: two binary searches over running costs, in any kernel."""

from typing import NamedTuple

import numpy as np

from farfield.viewspace import kernels
from farfield.viewspace.model import ProblemViews


class Runs(NamedTuple):
    """The arrays of ProblemViews that kernels read (numba takes tuples, not dataclasses)."""

    cost: np.ndarray
    row: np.ndarray
    run: np.ndarray
    before: np.ndarray
    list: np.ndarray
    list_row: np.ndarray
    list_object: np.ndarray
    list_through: np.ndarray


def runs_of(views: ProblemViews) -> Runs:
    """Return the views for kernels: `farfield.viewspace.kernels.cluster_cost(runs, v, a, b)`."""
    return Runs(*(getattr(views, name) for name in Runs._fields))


def cluster_cost(views: ProblemViews, v: int, a: int, b: int) -> int:
    """Return the cost bound of objects [a, b) in problem view v, in the model's unit."""
    return int(kernels.cluster_cost(runs_of(views), v, a, b))


def cluster_costs(views: ProblemViews, v: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return (M,) i64: the cost of objects [a, b) in view v, for arrays of one shape (or scalars against them)."""
    v, a, b = (np.asarray(x, dtype=np.int64) for x in (v, a, b))
    v, a, b = (np.ascontiguousarray(x) for x in np.broadcast_arrays(v, a, b))
    out = np.empty(v.shape, dtype=np.int64)
    kernels.cluster_costs(runs_of(views), v.ravel(), a.ravel(), b.ravel(), out.reshape(-1))
    return out


def view_objects(views: ProblemViews, v: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the objects (K,) i32 that view v may show, ascending, and what each costs there (K,) i64."""
    begin, end = views.list_row[views.list[v] : views.list[v] + 2]
    runs = views.run[views.row[v] : views.row[v + 1]]
    length = runs[:, 1] - runs[:, 0]
    at = np.repeat(runs[:, 0] - (np.cumsum(length) - length), length) + np.arange(length.sum())
    costs = np.diff(views.list_through[begin:end], prepend=0)
    return views.list_object[begin:end][at], costs[at]


def n_incidences(views: ProblemViews) -> np.ndarray:
    """Return (V,) i64: how many objects each view may show."""
    through = np.concatenate([[0], np.cumsum(views.run[:, 1] - views.run[:, 0], dtype=np.int64)])
    return through[views.row[1:]] - through[views.row[:-1]]
