"""Levels of meshes: how coarse from how far.

Problem  For each mesh a few coarser ones, each with an error that is proven, as far as any object of the mesh is ever
         seen from far enough to use them.
Method   Errors are asked of the simplifier in powers of two of the mesh's size, all primitives alike; a result is kept
         if it has clearly fewer triangles than the last one kept, and its error is measured. A level whose error a
         coarser one does not exceed goes.
Errs     Errors are upper bounds. Shading is not bounded: it is part of what the simplifier minimises.
Shards   Ranges of meshes with about SHARD_TRIANGLES triangles.
"""

from collections.abc import Sequence

import numpy as np

from farfield.detail.distances import sight, stretch
from farfield.detail.error import surface_distance
from farfield.detail.model import Levels, no_levels
from farfield.detail.simplify import Primitive
from farfield.scene.model import Scene
from farfield.settings import Settings

SHARD_TRIANGLES = 100_000
FEWEST = 24  # triangles of a mesh that is worth a level
STEPS = range(12, 1, -1)  # errors asked for: the mesh's size times 2^-step
SHARE = 0.1  # of the triangles: less is not worth any level
FEWER = 0.7  # triangles of a level against those of the finer one, at most


def plan_shards(scene: Scene) -> list[tuple[int, int]]:
    """Return ranges [a, b) of meshes that cover all of them."""
    triangles = mesh_triangles(scene)
    shards, start, held = [], 0, 0
    for m, n in enumerate(triangles.tolist()):
        if m > start and held + n > SHARD_TRIANGLES:
            shards.append((start, m))
            start, held = m, 0
        held += n
    return [*shards, (start, len(triangles))]


def mesh_triangles(scene: Scene) -> np.ndarray:
    """Return (M,) i64."""
    return np.diff(scene.primitive_triangle[scene.mesh_primitive])


def usable_error(scene: Scene, settings: Settings) -> np.ndarray:
    """Return (M,) f64: the largest mesh-local error that some object of the mesh may be shown with somewhere."""
    low, high = scene.view_boxes[:, 0].min(0), scene.view_boxes[:, 1].max(0)
    box = scene.object_box
    gap = np.maximum(np.maximum(box[:, 0] - low, high - box[:, 1]), 0.0)  # to the corner of the view space farthest off
    reach = np.sqrt(gap[:, 0] ** 2 + gap[:, 1] ** 2 + gap[:, 2] ** 2)
    per_error = stretch(scene.object_matrix) * sight(settings)
    usable = np.zeros(len(scene.mesh_primitive) - 1)
    np.maximum.at(usable, scene.object_mesh, reach / per_error)
    return usable


def build_levels(scene: Scene, *, settings: Settings, meshes: tuple[int, int]) -> Levels:
    """Return the levels of meshes [a, b); `row` counts from mesh a."""
    usable = usable_error(scene, settings)
    triangles = mesh_triangles(scene)
    found = [_levels_of(scene, m, float(usable[m])) if triangles[m] >= FEWEST else [] for m in range(*meshes)]
    levels = [level for of_mesh in found for level in of_mesh]
    parts = [part for _, of_level in levels for part in of_level]
    return Levels(
        sight=sight(settings), row=_row([len(of_mesh) for of_mesh in found]),
        error_m=np.array([e for e, _ in levels], dtype=np.float64),
        part=_row([len(of_level) for _, of_level in levels]), part_triangle=_row([len(part) for part in parts]),
        index=np.concatenate([np.zeros((0, 3), np.int32), *parts]),
    )  # fmt: skip


def merge(parts: Sequence[Levels], scene: Scene, *, settings: Settings) -> Levels:
    """Return the levels of all meshes; parts in the order of `plan_shards`, none where the stage was skipped.

    With `detail.mode` "auto" none are left if, all objects at their coarsest, they spare less than SHARE.
    """
    if not parts:
        return no_levels()
    join = lambda name: _row(np.concatenate([np.diff(getattr(p, name)) for p in parts]))  # noqa: E731
    levels = Levels(
        sight=parts[0].sight, row=join("row"), error_m=np.concatenate([p.error_m for p in parts]), part=join("part"),
        part_triangle=join("part_triangle"), index=np.concatenate([p.index for p in parts]),
    )  # fmt: skip
    least = mesh_triangles(scene)
    some = np.flatnonzero(np.diff(levels.row))
    least[some] = levels.triangles[levels.row[some + 1] - 1]
    spared = 1 - least[scene.object_mesh].sum() / scene.object_triangles.sum()
    return no_levels() if settings.detail.mode == "auto" and spared < SHARE else levels


def _levels_of(scene: Scene, mesh: int, usable: float) -> list[tuple[float, list[np.ndarray]]]:
    """Return (error, triangles of each primitive) of the mesh's levels, finer first."""
    primitives = [Primitive(scene, p) for p in range(*scene.mesh_primitive[mesh : mesh + 2])]
    whole = [p.index for p in primitives]
    surface = _surface(scene, whole)
    ends = surface.reshape(-1, 3)
    size = float(np.sqrt(((ends.max(0) - ends.min(0)) ** 2).sum()))
    kept: list[tuple[float, list[np.ndarray]]] = []
    n = len(surface)
    for step in STEPS:
        wanted = size * 2.0**-step
        if wanted > usable:
            break
        coarse = [p.simplified(wanted) for p in primitives]
        count = sum(map(len, coarse))
        if count > FEWER * n:
            continue
        error = surface_distance(surface, _surface(scene, coarse))
        if error > usable:
            break
        while kept and kept[-1][0] >= error:
            kept.pop()
        kept.append((error, coarse))
        n = count
    return kept


def _surface(scene: Scene, parts: Sequence[np.ndarray]) -> np.ndarray:
    return scene.position[np.concatenate(parts)].astype(np.float64)


def _row(counts: Sequence[int] | np.ndarray) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(np.asarray(counts, dtype=np.int64))]).astype(np.int64)
