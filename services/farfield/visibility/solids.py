"""Which triangles bound solids that nobody can look through, and which are the ground.

Problem  Find sets of opaque triangles of which this holds, whatever the file means by them: a segment with one end
         inside and one outside hits a triangle that is drawn there.
Method   Place every opaque triangle and weld vertices that are equal bit for bit, across objects: in both test cities a
         wall alone and a roof alone are open, together they close. Triangles that hang together by edges are a group.
         Inside is where a ray to infinity crosses the group an odd number of times, so self-intersection does no harm.
         A group is a solid where each edge is used an even number of times, and then every path from inside to outside
         hits it. Or where the other edges lie in one horizontal plane: a cap is missing (the floor of a house, the lid
         of a box), which a segment crosses at most once unless it lies in the plane.
         Triangles with a side that is not drawn close a group only if every edge is used as often in either direction
         and no cap is missing; inside is then where the winding number is positive, which takes a crossing of a front.
Ground   The group with the largest area of which this holds: every triangle leans less than vertically, and turned
         upwards each edge inside is used once in either direction. The sum of its triangles is then a chain whose
         boundary is the rest of the edges. Where that winds once about a convex region without entering it, each
         point of the region is covered exactly once: the ground is a height field there, and a path inside the
         region from above to below it hits it. Whether cameras stand above it, `columns.py` asks.
Exact    Vertices are the float64 that `place` computes; every test here compares these, or is the sign of an exact
         determinant. Only the convex region is rounded, inwards, by `_INWARDS` times the largest coordinate.
"""

from dataclasses import dataclass

import numpy as np

from farfield.scene.kernels import place
from farfield.scene.model import OPAQUE, Scene
from farfield.visibility import solid_kernels as kernels

_INWARDS = 2.0**-40  # hull and distances are sums of a few products: rounded by less than 2**-48 of the coordinates


@dataclass(frozen=True, slots=True, kw_only=True)
class Solids:
    """T opaque triangles as they stand in the scene, S solids made of them."""

    vertex: np.ndarray  # (V,3) f64  welded
    triangle: np.ndarray  # (T,3) i32  front counterclockwise; mirrored objects are turned
    object: np.ndarray  # (T,) i32
    two_sided: np.ndarray  # (T,) b1
    up: np.ndarray  # (T,) i8  front looks up 1, down -1, exactly vertical 0
    solid: np.ndarray  # (T,) i32  -1: of none
    box: np.ndarray  # (S,2,3) f64
    cap_y: np.ndarray  # (S,) f64  plane of the missing cap; nan: closed
    side: np.ndarray  # (S,) i8  1: the whole solid lies on or above its cap, -1: on or below, 0: neither, or closed
    culled: np.ndarray  # (S,) b1  some triangle of it has a side that is not drawn
    ground: np.ndarray  # (G,) i32  triangles of the ground; none where there is no ground
    domain: np.ndarray  # (h,3) f64  the ground is a height field over points with a x + b z <= c in every row


@dataclass(frozen=True, slots=True, kw_only=True)
class Placed:
    """All T triangles as they stand in the scene, object by object, with the front counterclockwise."""

    corner: np.ndarray  # (T,3,3) f64  no -0
    object: np.ndarray  # (T,) i32
    two_sided: np.ndarray  # (T,) b1
    opaque: np.ndarray  # (T,) b1  drawn without holes


def find_solids(placed: Placed) -> Solids:
    """Return the solids among the opaque triangles, in order of their first triangle."""
    corner, owner, two_sided = (a[placed.opaque] for a in (placed.corner, placed.object, placed.two_sided))
    number = np.empty(len(corner) * 3, dtype=np.int32)
    n = kernels.weld(corner.reshape(-1, 3), number)
    vertex = np.empty((n, 3))
    vertex[number] = corner.reshape(-1, 3)
    triangle = number.reshape(-1, 3)
    up = np.zeros(len(triangle), dtype=np.int8)
    kernels.facing(vertex, triangle, up)
    e = _Edges(triangle)
    n_groups = e.connect()
    has_odd, plane_low, plane_high = e.planes(vertex, n_groups)
    culled = np.zeros(n_groups, dtype=np.bool_)
    culled[e.group[~two_sided]] = True
    low, high = _bounds(vertex, triangle, e.group, n_groups)
    is_solid = np.where(culled, ~e.unbalanced(n_groups), ~has_odd | (plane_low == plane_high))
    is_solid &= (low < high).all(1)
    ids = np.cumsum(is_solid) - 1
    kept = np.flatnonzero(is_solid)
    cap_y = np.where(has_odd & ~culled, plane_low, np.nan)[kept]
    side = np.where(low[kept, 1] == cap_y, 1, np.where(high[kept, 1] == cap_y, -1, 0)).astype(np.int8)
    ground, domain = _ground(vertex, triangle, up, two_sided, e.group, n_groups)
    return Solids(
        vertex=vertex, triangle=triangle, object=owner, two_sided=two_sided, up=up,
        solid=np.where(is_solid[e.group], ids[e.group], -1).astype(np.int32),
        box=np.stack([low[kept], high[kept]], 1), cap_y=cap_y, side=side, culled=culled[kept],
        ground=ground, domain=domain,
    )  # fmt: skip


def place_triangles(scene: Scene) -> Placed:
    """Return every triangle of every object, relative to scene.origin_m."""
    corners: list[np.ndarray] = [np.zeros((0, 3, 3))]
    materials: list[np.ndarray] = [np.zeros(0, np.int32)]
    counts: list[int] = []
    for o in range(scene.n_objects):
        mesh = int(scene.object_mesh[o])
        a, b = scene.mesh_primitive[mesh : mesh + 2]
        first, last = scene.primitive_vertex[a], scene.primitive_vertex[b]
        index = scene.index[scene.primitive_triangle[a] : scene.primitive_triangle[b]] - first
        matrix = np.ascontiguousarray(scene.object_matrix[o])
        placed = np.empty((last - first, 3))
        place(scene.position[first:last], matrix, placed)
        corner = placed[index] + 0.0  # no -0, which would not weld with 0
        corners.append(corner[:, ::-1] if _mirrors(matrix) else corner)
        materials.append(np.repeat(scene.primitive_material[a:b], np.diff(scene.primitive_triangle[a : b + 1])))
        counts.append(len(index))
    material = np.concatenate(materials)
    return Placed(
        corner=np.ascontiguousarray(np.concatenate(corners)),
        object=np.repeat(np.arange(scene.n_objects, dtype=np.int32), counts),
        two_sided=scene.material_double_sided[material].astype(np.bool_),
        opaque=scene.material_alpha_mode[material] == OPAQUE,
    )


def _mirrors(m: np.ndarray) -> bool:
    a, b, c = m[:, 0], m[:, 1], m[:, 2]
    return bool(
        a[0] * (b[1] * c[2] - b[2] * c[1]) - b[0] * (a[1] * c[2] - a[2] * c[1]) + c[0] * (a[1] * b[2] - a[2] * b[1]) < 0
    )


class _Edges:
    """The edges of all triangles, and the groups that hang together by them."""

    def __init__(self, triangle: np.ndarray) -> None:
        self.of = np.empty((len(triangle), 3), dtype=np.int32)
        self.low, self.high, self.uses, self.direction = (
            np.zeros(max(1, 3 * len(triangle)), dtype=np.int32) for _ in range(4)
        )
        self.n = kernels.edges(triangle, self.of, self.low, self.high, self.uses, self.direction)
        self.group = np.zeros(len(triangle), dtype=np.int32)

    def connect(self) -> int:
        return int(kernels.connect(self.of, self.n, self.group))

    def _group_of_edge(self) -> np.ndarray:
        group = np.zeros(self.n, dtype=np.int32)
        group[self.of.reshape(-1)] = np.repeat(self.group, 3)
        return group

    def planes(self, vertex: np.ndarray, n_groups: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Has the group edges with an odd number of uses, and the lowest and highest point of these."""
        odd = np.flatnonzero(self.uses[: self.n] % 2 == 1)
        group = self._group_of_edge()[odd]
        ends = vertex[np.stack([self.low[odd], self.high[odd]], 1), 1]
        low, high = np.full(n_groups, np.inf), np.full(n_groups, -np.inf)
        np.minimum.at(low, group, ends.min(1))
        np.maximum.at(high, group, ends.max(1))
        return np.isfinite(low), low, high

    def unbalanced(self, n_groups: int) -> np.ndarray:
        """Has the group an edge that is not used equally often in either direction."""
        found = np.zeros(n_groups, dtype=np.bool_)
        found[self._group_of_edge()[self.direction[: self.n] != 0]] = True
        return found


def _bounds(vertex: np.ndarray, triangle: np.ndarray, group: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    corner = vertex[triangle]
    np.minimum.at(low, group, corner.min(1))
    np.maximum.at(high, group, corner.max(1))
    return low, high


def _ground(
    vertex: np.ndarray, triangle: np.ndarray, up: np.ndarray, two_sided: np.ndarray, group: np.ndarray, n_groups: int
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles and domain of the largest group that is a height field; empty where none is."""
    bad = np.zeros(n_groups, dtype=np.bool_)
    bad[group[(up == 0) | ((up < 0) & ~two_sided)]] = True
    corner = vertex[triangle][:, :, [0, 2]]
    u, v = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = np.zeros(n_groups)
    np.add.at(area, group, np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))
    area[bad] = 0.0
    for g in np.argsort(-area, kind="stable")[:8].tolist():  # the largest is it, or there is none worth the name
        if not area[g] > 0:
            break
        members = np.flatnonzero(group == g)
        turned = np.where((up[members] < 0)[:, None], triangle[members][:, ::-1], triangle[members])
        domain = _domain(vertex[:, [0, 2]], turned)
        if domain is not None:
            return members.astype(np.int32), domain
    return np.zeros(0, np.int32), np.zeros((0, 3))


def _domain(point: np.ndarray, triangle: np.ndarray) -> np.ndarray | None:
    """The half planes (h,3) of a convex region that the upward triangles (T,3) cover exactly once; None if none is found.

    Region   the convex hull of the boundary, each side moved inwards by the depth of the boundary below the hull.
             The depth of a boundary edge is at most that of its deeper end below the same side. So the boundary does
             not enter the region, and its winding number is the same all over it.
    """
    e = _Edges(triangle)
    if (e.uses[: e.n] > 2).any():
        return None
    rim = np.flatnonzero(e.direction[: e.n] != 0)
    if (e.uses[rim] != 1).any() or ((e.uses[: e.n] == 2) & (e.direction[: e.n] != 0)).any() or not len(rim):
        return None
    forward = e.direction[rim] > 0
    start = point[np.where(forward, e.low[rim], e.high[rim])]
    stop = point[np.where(forward, e.high[rim], e.low[rim])]
    hull = _hull(start)
    along = np.roll(hull, -1, 0) - hull
    length = np.hypot(along[:, 0], along[:, 1])
    normal = np.stack([along[:, 1], -along[:, 0]], 1) / length[:, None]
    offset = normal[:, 0] * hull[:, 0] + normal[:, 1] * hull[:, 1]
    # An edge must stay outside: there is one side below which both of its ends lie no deeper than the region does.
    depth = [offset[None] - normal[None, :, 0] * q[:, :1] - normal[None, :, 1] * q[:, 1:] for q in (start, stop)]
    inwards = float(np.maximum(depth[0], depth[1]).min(1).max()) + _INWARDS * float(np.abs(hull).max())
    domain = np.concatenate([normal, (offset - inwards)[:, None]], 1)
    inner = hull.mean(0)
    if not (domain[:, 0] * inner[0] + domain[:, 1] * inner[1] < domain[:, 2]).all():
        return None
    return domain if _winds_once(start, stop, inner) else None


def _winds_once(start: np.ndarray, stop: np.ndarray, about: np.ndarray) -> bool:
    """Do the directed edges wind exactly once about a point, either way round, counted by crossings of a ray along +x."""
    x, z = float(about[0]), float(about[1])
    winding = 0
    for (ax, az), (bx, bz) in zip(start.tolist(), stop.tolist(), strict=True):
        if (az <= z) != (bz <= z):
            turn = int(kernels.orient2d(ax, az, bx, bz, x, z))
            winding += (turn > 0 and az <= z) - (turn < 0 and bz <= z)
    return abs(winding) == 1


def _hull(point: np.ndarray) -> np.ndarray:
    """Corners of the convex hull, counterclockwise in (x, z), exact (monotone chain)."""
    order = np.unique(point, axis=0).tolist()

    def chain(points: list) -> list:
        out: list = []
        for p in points:
            while len(out) > 1 and kernels.orient2d(*out[-2], *out[-1], *p) <= 0:
                out.pop()
            out.append(p)
        return out[:-1]

    return np.array(chain(order) + chain(order[::-1]))
