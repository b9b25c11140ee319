"""Random placement problems without geometry: a tree, views with costs, candidates with bytes and served views."""

from dataclasses import dataclass

import numpy as np
from farfield.candidates.model import BOX, SHAFT, Candidates
from farfield.geometry.cells import CellTree, build_cells
from farfield.hierarchy.model import Hierarchy
from farfield.rendertime.model import CostModel
from farfield.viewspace.model import ProblemViews
from problem_views import views_of


@dataclass(frozen=True)
class Instance:
    hierarchy: Hierarchy
    model: CostModel
    cells: CellTree
    views: ProblemViews
    candidates: Candidates


def random_tree(rng, n_objects):
    """A Hierarchy of random cuts; boxes are unit cubes in a row."""
    start, stop, left, right, parent = [], [], [], [], []

    def grow(a, b, above):
        node = len(start)
        start.append(a), stop.append(b), left.append(-1), right.append(-1), parent.append(above)
        if b - a > 1:
            cut = int(rng.integers(a + 1, b))
            left[node] = grow(a, cut, node)
            right[node] = grow(cut, b, node)
        return node

    grow(0, n_objects, -1)
    i32 = lambda c: np.array(c, dtype=np.int32)  # noqa: E731
    start, stop = i32(start), i32(stop)
    box = np.zeros((len(start), 2, 3))
    box[:, 0, 0], box[:, 1, 0], box[:, 1, 1:] = 10 + start, 10 + stop, 1
    count = (stop - start).astype(np.int64)
    return Hierarchy(
        start=start, stop=stop, left=i32(left), right=i32(right), parent=i32(parent), box=box, calls=count,
        triangles=12 * count, bytes=100 * count, replaceable=np.ones(len(start), bool),
    )  # fmt: skip


def flat_model(target, per_frame=0):
    return CostModel(
        unit="calls", budget=target + per_frame, per_frame=per_frame, per_call=1.0, per_triangle=0.0, per_pixel=0.0,
        per_impostor=1.0, per_impostor_triangle=0.0, per_impostor_pixel=0.0, object_fixed=np.zeros(0, np.int64),
        fov_deg=45.0, width=64, height=64,
    )  # fmt: skip


def make_views(n_objects, costs, interval_count):
    """ProblemViews from (V, N) object costs, 0 where the object is not seen; cells of interval_count views."""
    v = np.arange(len(costs))
    return views_of(v // interval_count, v % interval_count, [np.flatnonzero(c) for c in costs], costs)


def make_candidates(hierarchy, costs, cluster, cost, size, serves):
    """Candidates of these clusters, costs and bytes; serves[i] lists views, of which those that gain stay."""
    until = np.concatenate([np.zeros((len(costs), 1), np.int64), np.cumsum(costs, 1)], 1)
    rows = []
    for c, t, b, views in zip(cluster, cost, size, serves):
        geometry = until[views, hierarchy.stop[c]] - until[views, hierarchy.start[c]]
        help = geometry > t
        if help.any():
            rows.append((c, t, b, np.asarray(views)[help], (geometry - t)[help]))
    rows.sort(key=lambda r: int(r[0]))
    n = len(rows)
    shape = np.zeros((n, 9))
    shape[:, 0], shape[:, 3:6] = np.arange(n), 1e6
    return Candidates(
        cluster=np.array([r[0] for r in rows], np.int32), kind=(np.arange(n) % 2).astype(np.uint8) * BOX + SHAFT,
        view_cell=shape, bytes=np.array([r[2] for r in rows], np.int64), layers=np.ones(n, np.int32),
        cost=np.array([r[1] for r in rows], np.int64),
        row=np.cumsum([0, *(len(r[3]) for r in rows)], dtype=np.int64),
        view=np.concatenate([*(r[3] for r in rows), []]).astype(np.int32),
        saved=np.concatenate([*(r[4] for r in rows), []]).astype(np.int64),
    )  # fmt: skip


def random_instance(seed, *, n_objects=8, n_cells=3, intervals=2, n_candidates=14, unit=3, target=None):
    """A small problem with many ties: costs are multiples of `unit`, bytes few different numbers."""
    rng = np.random.default_rng(seed)
    hierarchy = random_tree(rng, n_objects)
    n_views = n_cells * intervals
    costs = rng.integers(0, 4, (n_views, n_objects)).astype(np.int64) * unit
    costs[:, 0] += unit
    cluster = np.sort(rng.integers(0, len(hierarchy.start), n_candidates))
    serves = []
    for _ in range(n_candidates):
        chosen = np.flatnonzero(rng.random(n_cells) < 0.6)
        serves.append((chosen[:, None] * intervals + np.arange(intervals)).ravel())
    candidates = make_candidates(
        hierarchy, costs, cluster, rng.integers(0, 3 * unit, n_candidates), rng.integers(1, 6, n_candidates), serves
    )
    views = make_views(n_objects, costs, intervals)
    if target is None:
        target = int(views.cost.min() * rng.choice([0.0, 0.3, 0.5, 0.7, 0.9]))
    cells = build_cells(np.array([[[0, 0, 0], [n_cells, 1, 1]]], dtype=float), 1.0)
    return Instance(hierarchy, flat_model(target), cells, views, candidates)


def same_refit(instance):
    """A refit that keeps bytes and costs as they are, for tests that are not about tightening."""
    return lambda box, cells: (BOX, np.zeros(9), 2**40, 1, 2**40)


def halving_refit(box, cells):
    """A made-up refit: bytes grow with the cells served, cost is 0."""
    shape = np.concatenate([cells[:, 0].min(0), cells[:, 1].max(0), np.zeros(3)])
    return BOX, shape, len(cells), 1, 0
