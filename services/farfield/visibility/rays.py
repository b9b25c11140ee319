"""Trace rays through the level: what they hit, and what they pass on the way.

Problem  What does a camera point see along a direction, when some triangles stop the eye and others do not?
Method   Two ray tracers (Embree) over the level's triangles in world space: those of opaque materials stop a ray; those
         of masked and blended ones never do, and are listed as passed. Objects keep their triangles together, so
         that a triangle's number gives its object.
Errs     A masked triangle hides nothing here, also where its texture is solid: what lies behind is taken as seen.
         A single-sided triangle hides nothing from behind, where it is not drawn (`seen`), but for one with a twin on
         the same three corners: which of the two a ray hits is left to chance, so both stop it. Positions are rounded
         to float32 (2**-24 of the distance from the scene's origin): two surfaces nearer than that may change places.
         After `PASSES` see-through triangles in a row a ray reports no more of them.
Same bytes for any number of threads that build the tree (checked in the tests: coincident faces, 1 and 2 threads).
After    Wald et al. Embree: A Kernel Framework for Efficient CPU Ray Tracing. SIGGRAPH 2014.
"""

import hashlib
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from farfield.scene.model import OPAQUE, Scene
from farfield.visibility import kernels

PASSES = 64
MISS = np.inf
_STEP = 2.0**-18  # of the way so far, and of the level's extent / 4: to go on behind a see-through triangle


@dataclass(frozen=True, slots=True)
class _Soup:
    """One kind of triangle in world space, object by object."""

    tracer: EmbreeScene | None
    object: np.ndarray  # (T,) i32

    def hits(
        self, origin: np.ndarray, direction: np.ndarray, limit: np.ndarray | None = None
    ) -> tuple[np.ndarray, ...]:
        """Return (triangle (R,) i32 or -1, distance (R,) f64 or inf, normal (R,3) f32) of each ray's first hit."""
        o, d = origin.astype(np.float32), direction.astype(np.float32)
        if self.tracer is None or not len(o):
            n = len(o)
            return np.full(n, -1, np.int32), np.full(n, MISS), np.zeros((n, 3), np.float32)
        reach = None if limit is None else np.minimum(limit, 1e37).astype(np.float32)
        found = self.tracer.run(o, d, dists=reach, output=True)
        triangle = found["primID"]
        return triangle, np.where(triangle < 0, MISS, found["tfar"].astype(np.float64)), found["Ng"]


@dataclass(frozen=True, slots=True)
class Surface:
    """All triangles of all objects, object after object, for points on them."""

    row: np.ndarray  # (N+1,) i64  triangles of an object
    corner: np.ndarray  # (T,3,3) f32
    area_below: np.ndarray  # (T+1,) f64  running area

    def points(self, object: np.ndarray, random: np.ndarray) -> np.ndarray:
        """Return (K,3) f64 points spread evenly over the surfaces of the objects (K,); random (K,3) in [0, 1)."""
        first, stop = self.row[object], self.row[object + 1]
        low, high = self.area_below[first], self.area_below[stop]
        at = np.searchsorted(self.area_below, low + random[:, 0] * (high - low), side="right") - 1
        corner = self.corner[np.clip(at, first, stop - 1)].astype(np.float64)
        root = np.sqrt(random[:, 1])[:, None]
        third = root * random[:, 2:]
        return corner[:, 0] * (1 - root) + corner[:, 1] * (root - third) + corner[:, 2] * third


class Rays:
    """The level, ready for rays. Coordinates are relative to the scene's origin; directions are units."""

    def __init__(self, scene: Scene) -> None:
        primitives = scene.mesh_primitive[scene.object_mesh], scene.mesh_primitive[scene.object_mesh + 1]
        first, stop = scene.primitive_triangle[primitives[0]], scene.primitive_triangle[primitives[1]]
        row = np.concatenate([[0], np.cumsum(stop - first)])
        corner = np.empty((int(row[-1]), 3, 3), dtype=np.float32)
        area = np.empty(len(corner))
        kernels.place_triangles(scene.position, scene.index, first, row, scene.object_matrix, corner, area)
        self.surface = Surface(row, corner, np.concatenate([[0.0], np.cumsum(area)]))
        stops = np.repeat(
            scene.material_alpha_mode[scene.primitive_material] == OPAQUE, np.diff(scene.primitive_triangle)
        )
        own = np.arange(len(corner)) + np.repeat(first - row[:-1], np.diff(row))
        object_of = np.repeat(np.arange(scene.n_objects, dtype=np.int32), np.diff(row))
        self._opaque, self._clear = (_soup(corner, object_of, stops[own] == kind) for kind in (True, False))
        self.see_through = self._clear.tracer is not None
        stop = stops[own]
        double_sided = scene.material_double_sided.astype(np.bool_)[scene.primitive_material]
        one_sided = ~np.repeat(double_sided, np.diff(scene.primitive_triangle))[own[stop]]
        if one_sided.any():
            one_sided &= ~_twins(corner if stop.all() else corner[stop])
        self._one_sided = one_sided if one_sided.any() else None
        self._step = float(np.abs(corner).max(initial=0)) * _STEP / 4

    def first(self, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (object (R,) i32, -1 where nothing stops the ray; distance (R,) f64, inf there; faces (R,) b1).

        origin, direction (R,3) f64; faces: the ray hit a front.
        """
        triangle, distance, normal = self._opaque.hits(origin, direction)
        hit = triangle >= 0
        object = np.where(hit, self._opaque.object[np.where(hit, triangle, 0)] if hit.any() else -1, -1)
        faces = hit & ((normal * direction.astype(np.float32)).sum(1) < 0)
        return object.astype(np.int32), distance, faces

    def seen(self, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what a camera at the origins sees: (object, distance) as `first`, but rays go on behind backs that are
        not drawn; and (R,) f64 how far they meet no opaque triangle at all, drawn or not.
        """
        triangle, distance, normal = self._opaque.hits(origin, direction)
        free = distance.copy()
        if self._one_sided is not None:
            triangle, toward, left = triangle.copy(), direction.astype(np.float32), np.arange(len(origin))
            for _ in range(PASSES):
                back = (triangle[left] >= 0) & self._one_sided[triangle[left]] & ((normal * toward[left]).sum(1) > 0)
                left = left[back]
                if not len(left):
                    break
                start = distance[left] * (1 + _STEP) + self._step
                at = origin[left] + direction[left] * start[:, None]
                triangle[left], ahead, normal = self._opaque.hits(at, direction[left])
                distance[left] = start + ahead
        hit = triangle >= 0
        object = np.where(hit, self._opaque.object[np.where(hit, triangle, 0)] if hit.any() else -1, -1)
        return object.astype(np.int32), distance, free

    def passed(self, origin: np.ndarray, direction: np.ndarray, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (ray (K,) i64, object (K,) i32), each pair once: what rays pass through before `distance` (R,)."""
        none = np.zeros(0, np.int64), np.zeros(0, np.int32)
        if not self.see_through:
            return none
        ray, start = np.arange(len(origin)), np.zeros(len(origin))
        pairs: list[np.ndarray] = []
        for _ in range(PASSES):
            at = origin[ray] + direction[ray] * start[:, None]
            triangle, ahead, _ = self._clear.hits(at, direction[ray], distance[ray] - start)
            hit = triangle >= 0
            ray, start, triangle = ray[hit], start[hit] + ahead[hit], triangle[hit]
            if not len(ray):
                break
            pairs.append(np.stack([ray, self._clear.object[triangle]], 1))
            start = start * (1 + _STEP) + self._step
            left = start < distance[ray]
            ray, start = ray[left], start[left]
        if not pairs:
            return none
        found = np.unique(np.concatenate(pairs), axis=0)
        return found[:, 0], found[:, 1].astype(np.int32)


_cache: dict[str, Rays] = {}


def rays_of(scene: Scene) -> Rays:
    """Return `Rays(scene)`; the shards of a stage that one process runs share it (14 s and 1.5 GB at 10 M triangles)."""
    digest = hashlib.sha256()
    for array in (
        scene.position, scene.index, scene.primitive_triangle, scene.primitive_material, scene.mesh_primitive,
        scene.object_mesh, scene.object_matrix, scene.material_alpha_mode, scene.material_double_sided,
    ):  # fmt: skip
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array).data)
    key = digest.hexdigest()
    if key not in _cache:
        _cache.clear()
        _cache[key] = Rays(scene)
    return _cache[key]


def _twins(corner: np.ndarray) -> np.ndarray:
    """Return (T,) b1: whether another of the triangles (T,3,3) f32 has the same three corners (or the same hash)."""
    bits = (corner + np.float32(0)).view(np.uint32)  # no -0
    point = np.zeros(corner.shape[:2], dtype=np.uint64)
    for axis in range(3):
        point = (point ^ bits[:, :, axis]) * np.uint64(0x9E3779B97F4A7C15)
        point ^= point >> np.uint64(29)
    key = point.sum(1, dtype=np.uint64)  # in whatever order they stand
    order = np.argsort(key, kind="stable")
    same = key[order[1:]] == key[order[:-1]]
    out = np.zeros(len(corner), dtype=np.bool_)
    out[order[1:][same]] = out[order[:-1][same]] = True
    return out


def _soup(corner: np.ndarray, object_of: np.ndarray, kept: np.ndarray) -> _Soup:
    if not kept.any():
        return _Soup(None, np.zeros(1, np.int32))
    chosen = corner if kept.all() else corner[kept]
    tracer = EmbreeScene()
    TriangleMesh(tracer, chosen.reshape(-1, 3), np.arange(3 * len(chosen), dtype=np.int32).reshape(-1, 3))
    return _Soup(tracer, object_of[kept])
