"""What levels of detail bring: how many there are, what they weigh in scene.glb, and what they spare."""

from typing import Any

import numpy as np

from farfield.detail.model import Levels
from farfield.geometry.cells import CellTree
from farfield.rendertime.cost import object_level
from farfield.rendertime.model import CostModel
from farfield.scene.model import Scene

MOST_CELLS = 256  # that are looked at, evenly spread


def levels_summary(scene: Scene, levels: Levels, model: CostModel, cells: CellTree) -> dict[str, Any] | None:
    """Return the figures as JSON values, None where there are no levels.

    objects        that have a coarser level
    levels         of their meshes, shared by the objects of a mesh
    triangles      of these levels, stored once a mesh; bytes  of their indices in scene.glb
    drawn_coarser  share of the objects that are drawn at a coarser level, mean over the cells
    spared         share of the level's triangles that are not drawn for it, mean over the cells, all objects counted
    """
    if not levels.n_levels or not len(model.level_row):
        return None
    mesh = np.repeat(np.arange(len(levels.row) - 1), np.diff(levels.row))
    parts = np.diff(levels.part)
    first = np.repeat(scene.mesh_primitive[mesh], parts)
    primitive = first + np.arange(levels.part[-1]) - np.repeat(levels.part[:-1], parts)
    wide = np.where(np.diff(scene.primitive_vertex)[primitive] <= 65535, 2, 4)
    triangles = np.diff(levels.part_triangle)
    total, n = int(scene.object_triangles.sum()), len(cells.cell_box)
    some = np.unique(np.linspace(0, n - 1, min(n, MOST_CELLS)).astype(np.int64))
    coarser = drawn = 0
    for cell in some:
        level = object_level(model, scene.object_box, cells.cell_box[cell])
        at = level > 0
        coarser += int(at.sum())
        drawn += int(scene.object_triangles[~at].sum())
        drawn += int(model.level_triangles[model.level_row[:-1][at] + level[at] - 1].sum())
    return {
        "objects": int((np.diff(model.level_row) > 0).sum()), "levels": levels.n_levels,
        "triangles": int(triangles.sum()), "bytes": int((3 * triangles * wide).sum()),
        "drawn_coarser": coarser / len(some) / max(scene.n_objects, 1),
        "spared": 1 - drawn / len(some) / max(total, 1),
    }  # fmt: skip
