"""Opaque patches: surfaces of which a single one hides an object, for interiors and thin walls.

Problem  Given boxes A and B, does an opaque surface K meet every segment from A to B?
Method   K is a set of triangles whose sum, as a chain, has the directed edges (u, v) as its boundary. Of a line from a
         to b, the sign of det(b - u, v - u, a - u) says on which side it passes an edge. If all edges of the boundary
         are passed on the same side, each turns about the line by more than 0 and less than pi, so the boundary winds
         about it at least once, so the line meets K. K need not be flat, nor convex: convex ones just succeed most.
         The sign is linear in a and in b, so it holds for all of A and B iff it does for their corners: 8 corners of A
         give 8 planes an edge, and B must lie beyond each. If besides A and B lie on different sides of K along some
         direction, the line meets K between a and b.
         K is made by joining neighbours that are nearly coplanar while the outline stays nearly convex, longest common
         edge first; a triangle with one side drawn hides only from that side.
Bounds   With u = 2**-53, lengths of v - u, a - u, b - u in the maximum norm e, r, s: a determinant of rounded differences
         rounds by less than 100 u e r s; 2**-45 e r s is asked for. Distances along the direction round by less than
         8 u of the coordinates; 2**-46 of the largest is asked for.
"""

from dataclasses import dataclass

import numpy as np

from farfield.visibility import patch_kernels as kernels
from farfield.visibility import solid_kernels
from farfield.visibility.solids import Placed

MOST = 2000
_SMALLEST = 0.5  # of a cell's side: the root of the area


@dataclass(frozen=True, slots=True, kw_only=True)
class Patches:
    """P patches, largest first, with E boundary edges."""

    row: np.ndarray  # (P+1,) i64  edges of patch p are [row[p], row[p+1])
    edge: np.ndarray  # (E,2,3) f64  from, to; counterclockwise seen from the front
    normal: np.ndarray  # (P,3) f64  about a unit vector
    span: np.ndarray  # (P,2) f64  least and greatest of normal . vertex
    two_sided: np.ndarray  # (P,) b1


def find_patches(placed: Placed, *, cell_m: float) -> Patches | None:
    """Return the largest opaque patches of a scene, None if none is half a cell large."""
    corner, two_sided = placed.corner[placed.opaque], placed.two_sided[placed.opaque]
    number = np.empty(len(corner) * 3, dtype=np.int32)
    n = solid_kernels.weld(corner.reshape(-1, 3), number)
    vertex = np.empty((n, 3))
    vertex[number] = corner.reshape(-1, 3)
    u, v = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    cross = np.stack([u[:, 1] * v[:, 2] - u[:, 2] * v[:, 1], u[:, 2] * v[:, 0] - u[:, 0] * v[:, 2],
                      u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]], 1)  # fmt: skip
    length = np.sqrt((cross * cross).sum(1))
    normal = cross / np.maximum(length, 1e-300)[:, None]
    next_ = np.empty(3 * len(corner), dtype=np.int32)
    face = np.empty(len(corner), dtype=np.int32)
    kernels.join(vertex, number.reshape(-1, 3), normal, two_sided, next_, face)
    area = np.zeros(len(corner))
    np.add.at(area, face, length / 2)
    chosen = np.flatnonzero(area >= (_SMALLEST * cell_m) ** 2)
    chosen = chosen[np.argsort(-area[chosen], kind="stable")][:MOST]
    if not len(chosen):
        return None
    order = np.argsort(face, kind="stable")
    start = np.searchsorted(face[order], chosen)
    stop = np.searchsorted(face[order], chosen, side="right")
    edges, row = [], [0]
    for a, b in zip(start.tolist(), stop.tolist(), strict=True):
        half = (3 * order[a:b][:, None] + np.arange(3)).reshape(-1)
        half = half[next_[half] >= 0]  # what was not joined across
        ends = number.reshape(-1, 3)[half // 3, (half % 3 + 1) % 3]
        edges.append(np.stack([vertex[number[half]], vertex[ends]], 1))
        row.append(row[-1] + len(half))
    edge = np.ascontiguousarray(np.concatenate(edges))
    along = (edge[:, 0] * np.repeat(normal[chosen], np.diff(row), axis=0)).sum(1)
    span = np.stack([np.minimum.reduceat(along, row[:-1]), np.maximum.reduceat(along, row[:-1])], 1)
    return Patches(
        row=np.array(row, dtype=np.int64), edge=edge, normal=np.ascontiguousarray(normal[chosen]), span=span,
        two_sided=two_sided[chosen],
    )  # fmt: skip
