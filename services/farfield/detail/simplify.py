"""Coarser triangles for one primitive, on its own vertices.

Problem  Fewer triangles for a primitive such that its outline, its texture and its shading stay, and such that what
         adjoins it (another primitive, another object, at whatever level) still does.
Method   meshoptimizer's edge collapse with attributes. Equal vertices are welded first: a soup has no edges to
         collapse. Borders are locked. Where vertices of one place differ in texture coordinates or colour, the seam is
         protected; where only normals differ (flat shading) it may go, at a price: the normals are part of the error.
Errs     What the simplifier says of its error is not relied on: `error.surface_distance` measures it.
Tried    Seams of normals kept as well: 104,792 triangles of a BIM model's parts become 101,962, not 11,822; nothing that
         is shaded flat gets simpler.
"""

from typing import Any

import numpy as np

from farfield.scene.model import Scene

# What a unit of attribute counts as, against a position that moves by the primitive's extent.
NORMAL, UV, COLOR = 0.25, 1.0, 0.5


def library() -> Any | None:
    """Return the module almeshopt, or None where there is no wheel for the processor."""
    try:
        import almeshopt
    except ImportError:
        return None
    return almeshopt


class Primitive:
    """One primitive of a scene, welded: what the simplifier needs, once for all levels."""

    def __init__(self, scene: Scene, primitive: int) -> None:
        first, stop = scene.primitive_vertex[primitive : primitive + 2]
        a, b = scene.primitive_triangle[primitive : primitive + 2]
        columns = [x[first:stop] for x in (scene.position, scene.normal, scene.uv, scene.color)]
        self.index = scene.index[a:b]
        self.vertex, corner = _weld(np.concatenate(columns, 1))
        self.corner = np.ascontiguousarray(corner[self.index - first].reshape(-1), dtype=np.uint32)
        self.vertex += int(first)
        position, normal, uv, color = (x[self.vertex - int(first)] for x in columns)
        self.position = np.ascontiguousarray(position)
        self.extent = float(np.sqrt(((self.position.max(0) - self.position.min(0)).astype(np.float64) ** 2).sum()))
        self.attribute = np.ascontiguousarray(np.concatenate([normal, uv, color], 1))
        self.weight = np.array([NORMAL] * 3 + [UV] * 2 + [COLOR] * 4, dtype=np.float32)
        self.protected = _seams(position, np.concatenate([uv, color], 1))

    def simplified(self, error: float) -> np.ndarray:
        """Return (T,3) i32 triangles into the scene's vertices, as few as the simplifier finds within about `error`.

        error  mesh-local length; an estimate. At least one triangle is left.
        """
        almeshopt = library()
        assert almeshopt is not None
        options = almeshopt.SIMPLIFY_LOCK_BORDER | almeshopt.SIMPLIFY_PERMISSIVE | almeshopt.SIMPLIFY_ERROR_ABSOLUTE
        lock = np.where(self.protected, almeshopt.SIMPLIFY_VERTEX_PROTECT, 0).astype(np.uint8)
        corner, _ = almeshopt.simplify_with_attributes(
            self.corner, self.position, self.attribute, self.weight, 3, error, lock, options
        )
        corner = corner.reshape(-1, 3)
        p = self.position[corner]
        flat = (p[:, 0] == p[:, 1]).all(1) | (p[:, 1] == p[:, 2]).all(1) | (p[:, 2] == p[:, 0]).all(1)
        found = self.vertex[corner[~flat]].astype(np.int32)
        return found if 0 < len(found) < len(self.index) else self.index


def _weld(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (first (K,), of (V,)): the first of each set of equal rows (bit for bit), and each row's set."""
    rows = np.ascontiguousarray(rows)
    keys = rows.view(np.dtype((np.void, rows.shape[1] * rows.itemsize))).reshape(-1)
    _, first, of = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)  # in the order of the vertices, not of their bytes
    rank = np.empty(len(first), dtype=np.int64)
    rank[order] = np.arange(len(first))
    return first[order], rank[of.reshape(-1)]


def _seams(position: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Return (V,) b1: some vertex at the same place differs in the columns `kept`."""
    _, place = _weld(position)
    _, value = _weld(np.concatenate([position, kept], 1))
    values_at = np.bincount(np.unique(np.stack([place, value]), axis=1)[0], minlength=place.max() + 1)
    return values_at[place] > 1
