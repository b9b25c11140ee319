"""Layered environment maps: for each view cell, all that lies far off, recorded in layers across the faces of a cube.

Problem  The plain way to make far things cheap: around every cell of the view space, what is beyond some distance becomes
         a picture. It is the baseline of the evaluation, and all that a skyline needs.
Method   Beyond means: the box of a cluster lies outside the cube of `placement.far_m` around the cell, so the axis of its
         widest gap says on which face it is shown. Clusters are taken as large as they come: descend until one lies
         beyond as a whole and within REACH of its face's frustum. A face has one reference viewpoint (searched), one
         texel grid and one stack of layers for all of them (`farfield.impostor.faces`); each cluster becomes an impostor
         that holds its own texels of it. So maps go through the same budget, bake, files and readers as all
         impostors: a view shows those that are cheaper than what they replace, and their objects are not drawn.
Borders  An object is wholly in the map or wholly geometry, wholly on one face or on another: nothing is cut at a seam
         or at the far-field border, and the face's frustum is as wide as its objects ask for. Two objects that touch
         across a seam meet as any two impostors do: every texel that is touched is covered.
Errs     Bytes, layers and cost are upper bounds, as in `generate`.
After    Jeschke and Wimmer 2002; Jeschke et al., I3D 2005, section 6 (test 15). Changed: theirs cuts objects at faces.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from farfield.candidates.generate import joined
from farfield.candidates.model import BOX, Candidates, take
from farfield.errors import OutOfDomain
from farfield.geometry.cells import CellTree
from farfield.hierarchy.model import Hierarchy
from farfield.impostor.faces import FACES, ROOM, face_axes, lay_out_face, window
from farfield.impostor.frames import EYE_X, EYE_Y, LOW_X, LOW_Y, PLANE_Z, TEXEL, S
from farfield.impostor.kernels import cut_triangles
from farfield.impostor.plan import LayerPlan, plan_layers, precision
from farfield.impostor.weight import MAX_LAYER_TRIANGLES, MAX_LAYERS, MAX_SIDE
from farfield.rendertime.cost import impostor_cost, pixels_bound_rect
from farfield.rendertime.model import CostModel
from farfield.settings import Settings
from farfield.viewspace.cost import cluster_costs
from farfield.viewspace.model import ProblemViews

REACH = 1.25  # slope from the cell's centre to which a face shows clusters; single objects may reach twice as far
SHARD_CELLS = 32
KEPT = 128  # maps that a planner remembers


@njit(cache=True)
def _far_clusters(
    left: np.ndarray, right: np.ndarray, box: np.ndarray, replaceable: np.ndarray, cell: np.ndarray, far_m: float,
    reach: float, cluster: np.ndarray, face: np.ndarray,
) -> int:  # fmt: skip
    """Write the clusters beyond far_m of a cell (2,3) and their faces, in preorder; return how many."""
    n, top = 0, 1
    waiting = np.empty(len(left) + 1, np.int64)
    waiting[0] = 0
    while top > 0:
        top -= 1
        c = waiting[top]
        widest, side = -np.inf, 0
        for axis in range(3):
            up, down = box[c, 0, axis] - cell[1, axis], cell[0, axis] - box[c, 1, axis]
            if up > widest:
                widest, side = up, 2 * axis
            if down > widest:
                widest, side = down, 2 * axis + 1
        if widest >= far_m and replaceable[c]:
            worst = 0.0
            for axis in range(3):
                if axis != side // 2:
                    middle = (cell[0, axis] + cell[1, axis]) / 2
                    worst = max(worst, max(box[c, 1, axis] - middle, middle - box[c, 0, axis]) / widest)
            if worst <= (reach if left[c] >= 0 else 2 * reach):
                cluster[n], face[n] = c, side
                n += 1
                continue
        if left[c] >= 0:
            waiting[top], waiting[top + 1] = right[c], left[c]
            top += 2
    return n


def far_clusters(hierarchy: Hierarchy, cell: np.ndarray, far_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return cluster (K,) i32, ascending and disjoint, and face (K,) i32 of what a cell (2,3) has beyond far_m."""
    cluster, face = (np.empty(len(hierarchy.start), np.int32) for _ in range(2))
    n = _far_clusters(
        hierarchy.left, hierarchy.right, hierarchy.box, hierarchy.replaceable,
        np.ascontiguousarray(cell, np.float64).reshape(2, 3), far_m, REACH, cluster, face,
    )  # fmt: skip
    return cluster[:n], face[:n]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Face:
    """One face's frame and stack, as `lay_out_face` fills them."""

    cell: np.ndarray
    face: int
    plane: np.ndarray
    near: np.ndarray
    far: np.ndarray
    frame: np.ndarray


def map_of(hierarchy: Hierarchy, cell: np.ndarray, settings: Settings) -> dict[int, LayerPlan]:
    """Return cluster -> its layers in the environment map around a cell (2,3), ascending.

    What needs more than MAX_LAYERS layers or MAX_SIDE texels along a side is shown in parts; an object that does is
    left out, hence drawn as geometry.
    """
    cell = np.ascontiguousarray(cell, np.float64).reshape(2, 3)
    p = precision(settings)
    cluster, face = far_clusters(hierarchy, cell, settings.placement.far_m)
    out: dict[int, LayerPlan] = {}
    plane, near, far, frame = np.empty(ROOM), np.empty(ROOM), np.empty(ROOM), np.zeros(10)
    for f in range(FACES):
        here = cluster[face == f]
        if not len(here):
            continue
        boxes = np.ascontiguousarray(hierarchy.box[here])
        count = lay_out_face(f, boxes, cell, p.delta, p.dl, plane, near, far, frame)
        if count <= 0:
            continue  # more than ROOM layers: no texel could be as large as a pixel
        of = _Face(cell=cell, face=f, plane=plane[:count], near=near[:count], far=far[:count], frame=frame)
        waiting = [int(c) for c in here]
        while waiting:
            c = waiting.pop()
            plan = _part(of, hierarchy.box[c])
            if plan is not None:
                out[c] = plan
            elif hierarchy.left[c] >= 0:
                waiting += [int(hierarchy.right[c]), int(hierarchy.left[c])]
    return dict(sorted(out.items()))


def _part(of: _Face, box: np.ndarray) -> LayerPlan | None:
    """Return the layers of one of the face's boxes (2,3), in its window of the face's grid; None: too many or large."""
    crop, wide = np.zeros((len(of.plane), 2)), np.empty(4)
    frame = of.frame
    a, b = window(
        of.face, np.ascontiguousarray(box), of.cell, of.plane, of.near, of.far, frame, crop, wide
    )  # fmt: skip
    if b - a > MAX_LAYERS or wide[2:].max() > MAX_SIDE:
        return None
    axes = np.empty((3, 3))
    face_axes(of.face, axes)
    s, texel = float(frame[S]), float(frame[TEXEL])
    middle = (of.cell[0] + of.cell[1]) / 2
    return LayerPlan(
        eye=middle + frame[EYE_X] * axes[0] + frame[EYE_Y] * axes[1] + (frame[PLANE_Z] - s) * axes[2],
        right=axes[0].copy(), up=axes[1].copy(), back=-axes[2],
        slope0=np.array([frame[LOW_X] + wide[0] * texel, frame[LOW_Y] + wide[1] * texel]), texel=np.full(2, texel),
        resolution=wide[2:].astype(np.int32), plane=of.plane[a:b] + s, near=of.near[a:b] + s, far=of.far[a:b] + s,
        crop=crop[a:b].astype(np.int32), depth=s,
    )  # fmt: skip


class Planner:
    """The layers that candidates and bake agree on, by the way impostors are placed."""

    def __init__(self, hierarchy: Hierarchy, settings: Settings) -> None:
        self._hierarchy, self._settings = hierarchy, settings
        self._maps: dict[bytes, dict[int, LayerPlan]] = {}

    def plan(self, kind: int, view_cell: np.ndarray, cluster: int) -> LayerPlan:
        """Return the layers of an impostor of `cluster` for a view cell (9,). Raises ImpostorError."""
        if self._settings.placement.candidates != "environment":
            return plan_layers(kind, view_cell, self._hierarchy.box[cluster], settings=self._settings)
        found = self.map_around(view_cell[:6]).get(cluster)
        if found is None:
            raise OutOfDomain(f"cluster {cluster} is not in the environment map of its view cell")
        return found

    def map_around(self, cell: np.ndarray) -> dict[int, LayerPlan]:
        """Return what `map_of` does, remembered."""
        key = np.ascontiguousarray(cell, np.float64).tobytes()
        if key not in self._maps:
            if len(self._maps) == KEPT:
                self._maps.clear()
            self._maps[key] = map_of(self._hierarchy, cell, self._settings)
        return self._maps[key]


def plan_shards(views: ProblemViews) -> list[tuple[int, int]]:
    """Return ranges [a, b) of leaf cells that hold all problem views."""
    if not len(views.cell):
        return []
    first, last = int(views.cell[0]), int(views.cell[-1]) + 1
    return [(a, min(last, a + SHARD_CELLS)) for a in range(first, last, SHARD_CELLS)]


def generate_maps(
    hierarchy: Hierarchy, model: CostModel, cells: CellTree, views: ProblemViews, *, settings: Settings,
    leaves: tuple[int, int],
) -> Candidates:  # fmt: skip
    """Return the parts of the maps of leaf cells [a, b) that save something in a problem view, sorted as candidates are."""
    rows: list[tuple[Any, ...]] = []
    for cell in np.unique(views.cell[(views.cell >= leaves[0]) & (views.cell < leaves[1])]):
        first, last = (int(v) for v in np.searchsorted(views.cell, [cell, cell + 1]))
        view = np.arange(first, last)
        box = cells.cell_box[cell]
        for cluster, plan in map_of(hierarchy, box, settings).items():
            cost = plan_cost(model, plan)
            start, stop = int(hierarchy.start[cluster]), int(hierarchy.stop[cluster])
            saved = cluster_costs(views, view, np.array(start), np.array(stop)) - cost
            helped = saved > 0
            if helped.any():
                view_cell = np.concatenate([box.reshape(6), np.zeros(3)])
                rows.append((cluster, view_cell, plan.bytes, len(plan.plane), cost, view[helped], saved[helped]))
    column = lambda k, dtype: np.array([r[k] for r in rows], dtype=dtype)  # noqa: E731
    return _sorted(
        Candidates(
            cluster=column(0, np.int32), kind=np.full(len(rows), BOX, np.uint8),
            view_cell=column(1, np.float64).reshape(-1, 9), bytes=column(2, np.int64), layers=column(3, np.int32),
            cost=column(4, np.int64), row=np.cumsum([0, *(len(r[5]) for r in rows)], dtype=np.int64),
            view=np.concatenate([np.zeros(0, np.int32), *(r[5] for r in rows)]).astype(np.int32),
            saved=np.concatenate([np.zeros(0, np.int64), *(r[6] for r in rows)]),
        )
    )  # fmt: skip


def merge(parts: Sequence[Candidates]) -> Candidates:
    """Return the candidates of all shards as one, sorted by (cluster, kind, view cell)."""
    return _sorted(joined(parts))


def _sorted(candidates: Candidates) -> Candidates:
    return take(candidates, np.lexsort((*candidates.view_cell.T[::-1], candidates.kind, candidates.cluster)))


def plan_cost(model: CostModel, plan: LayerPlan) -> int:
    """Return an upper bound of what the baked layers cost, from anywhere in their view cell."""
    triangles, pixels = MAX_LAYER_TRIANGLES * len(plan.plane), 0.0
    for (width, height), plane in zip(plan.crop.tolist(), plan.plane.tolist(), strict=True):
        triangles += cut_triangles(width, height)
        if model.per_impostor_pixel:
            unit = float(plan.texel[0]) * plane
            pixels += pixels_bound_rect(model, width=width * unit, height=height * unit, distance=plane - plan.depth)
    return impostor_cost(model, triangles=triangles, pixels=pixels)
