"""Bring a cluster into the frame of its impostor: triangles clipped to the slabs and snapped once to 1/256 texel.

Problem  Layers must share the texels of their borders, triangles those of their edges, whoever rasterises them.
Method   Corners go to the frame in float64. Each triangle is cut at the slab borders it crosses (never at a frustum
         side: the grid covers the cluster's box, only rounding is outside, and that is clamped) and rounded to
         integers; all that follows is exact on these. The first slab begins at the eye and the last never ends:
         nothing is cut away.
Backs    A triangle of a single-sided material is left out iff no point of the view cell sees its front. Culling by the
         eye alone, as a viewer at the eye would, opens holes for the rest of the cell. Errs towards keeping: a few
         faces stay that turn away from the eye; shafts are taken as the octagonal pyramids around them.
         By the same test a double-sided face shows its front wherever some of the cell sees that: most bodies are closed,
         and where the eye lies a little under a roof its dark underside would line the wall's top edge. Errs for open
         sheets that lie across the cell: they have one colour on both sides.
"""

import math

import numpy as np

from farfield.bake import kernels
from farfield.bake.records import MAX_SIDE, Pieces, Slabs, Sources
from farfield.candidates.model import BOX
from farfield.errors import ObjectTouchesViewCell, OutOfDomain
from farfield.impostor.plan import LayerPlan
from farfield.scene.model import BLEND, Scene

_OUTSIDE = 0.5  # texels that a corner may lie off the grid: a sanity bound, far above rounding


def cell_hull(kind: int, view_cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points (P,3) and directions (D,3) f64 whose hull and cone contain the view cell (see Candidates)."""
    cell = np.asarray(view_cell, np.float64)
    if kind == BOX:
        low, high = cell[:3], cell[3:6]
        return np.array([[(low, high)[b >> a & 1][a] for a in range(3)] for b in range(8)]), np.zeros((0, 3))
    apex, axis, tangent, near, far = cell[:3], cell[3:6], cell[6], cell[7], cell[8]
    side = np.zeros(3)
    side[np.argmin(np.abs(axis))] = 1
    u = np.cross(axis, side)
    u /= math.sqrt(float((u * u).sum()))
    v = np.cross(axis, u)
    turn = [math.pi * k / 4 for k in range(8)]
    wide = tangent / math.cos(math.pi / 8)
    rays = np.array([axis + wide * (math.cos(a) * u + math.sin(a) * v) for a in turn])
    if math.isinf(far):
        return apex + near * rays, rays
    return np.concatenate([apex + near * rays, apex + far * rays]), np.zeros((0, 3))


def count_triangles(scene: Scene, objects: tuple[int, int]) -> int:
    """Return how many triangles objects [a, b) have."""
    mesh = scene.object_mesh[objects[0] : objects[1]]
    first, last = (scene.primitive_triangle[scene.mesh_primitive[m]] for m in (mesh, mesh + 1))
    return int((last - first).sum())


def gather(
    scene: Scene, objects: tuple[int, int], plan: LayerPlan, *, kind: int, view_cell: np.ndarray,
    triangles: tuple[int, int] | None = None,
) -> Sources:  # fmt: skip
    """Return the triangles of objects [a, b) in the frame of `plan`, without those of blended materials.

    triangles  [first, last) of all triangles of these objects, in their order; None: all of them

    Raises ObjectTouchesViewCell where a triangle is not in front of the eye, OutOfDomain for a grid that is too large
    or does not cover the cluster.
    """
    if max(plan.resolution) > MAX_SIDE:
        raise OutOfDomain(
            f"an impostor of {plan.resolution[0]} x {plan.resolution[1]} texels is larger than {MAX_SIDE}"
        )
    start, stop = objects
    first, last = triangles or (0, count_triangles(scene, objects))
    n = last - first
    axes = np.stack([plan.right, plan.up, -plan.back]).astype(np.float64)
    points, directions = cell_hull(kind, view_cell)
    hull = np.array([[float((axis * (p - plan.eye)).sum()) for axis in axes] for p in points])
    cone = np.array([[float((axis * d).sum()) for axis in axes] for d in directions]).reshape(-1, 3)
    corner, vertex = np.empty((n, 3, 3)), np.empty((n, 3), np.int32)
    material, owner, away = np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.bool_)
    found = kernels.gather(
        scene.position, scene.index, scene.primitive_triangle, scene.primitive_material, scene.mesh_primitive,
        scene.object_mesh, scene.object_matrix, start, stop, first, last, scene.material_alpha_mode == BLEND,
        ~scene.material_double_sided.astype(np.bool_), np.ascontiguousarray(plan.eye, np.float64), axes, hull, cone,
        corner, vertex, material, owner, away,
    )  # fmt: skip
    corner, vertex = corner[:found], vertex[:found]
    snapped, inverse = np.empty((found, 6), np.int32), np.empty((found, 3))
    reciprocal = np.empty((found, 3), np.float32)
    outside = kernels.snap_sources(corner, vertex, *grid(plan), snapped, inverse, reciprocal)
    if outside < 0:
        raise ObjectTouchesViewCell(f"a triangle of objects {start} to {stop} is not in front of the eye")
    if outside > _OUTSIDE:
        raise OutOfDomain(f"objects {start} to {stop} reach {outside:g} texels beyond their impostor's grid")
    return Sources(corner, snapped, inverse, reciprocal, vertex, material[:found], owner[:found], away[:found])


def cut(sources: Sources, plan: LayerPlan) -> Pieces:
    """Return the parts of the triangles in each slab of `plan`."""
    near, far = np.array(plan.near, np.float64), np.array(plan.far, np.float64)
    assert (near[1:] == far[:-1]).all()
    near[0], far[-1] = -np.inf, np.inf
    count = np.zeros(len(near), np.int64)
    kernels.count_pieces(sources.corner, near, far, count)
    row = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    piece, source = np.empty((int(row[-1]), 6), np.int32), np.empty(int(row[-1]), np.int32)
    kernels.fill_pieces(sources.corner, sources.snapped, near, far, *grid(plan), row[:-1].copy(), piece, source)
    return Pieces(row, piece, source)


def bound(pieces: Pieces, plan: LayerPlan) -> Slabs:
    """Return the slabs with the rectangle of texels that each layer's pieces touch; `at` is still 0."""
    k = len(plan.near)
    low, size = np.zeros((k, 2), np.int32), np.zeros((k, 2), np.int32)
    kernels.bound_pieces(pieces.row, pieces.snapped, grid(plan)[2], low, size)
    far = np.asarray(plan.far, np.float64)
    inverse_far = np.where(np.isinf(far), 0.0, 1 / far)
    return Slabs(1 / np.asarray(plan.near, np.float64), inverse_far, low, size, np.zeros((k, 2), np.int32))


def grid(plan: LayerPlan) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return slope0, texel (2,) f64 and resolution (2,) i64 of the texel grid, as kernels take them."""
    return (
        np.array(plan.slope0, np.float64), np.array(plan.texel, np.float64), np.array(plan.resolution, np.int64),
    )  # fmt: skip
