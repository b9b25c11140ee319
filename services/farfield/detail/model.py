"""The output of stage 3."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """Q coarser levels of M meshes. Level 0 of a mesh is the mesh itself and is not here.

    Mesh m has levels [row[m], row[m+1]), finer first, errors ascending. A level has a part for each primitive of its
    mesh, in their order: the same material, vertices of the same primitive, at least one triangle. Its boundary edges
    are the primitive's own, so that neighbours meet without gaps whatever their levels. Skipped: all empty.
    """

    sight: float  # metres of distance a metre of error takes to be within the pixel error; 0 without levels
    row: np.ndarray  # (M+1,) i64, or (0,) without levels
    error_m: np.ndarray  # (Q,) f64  no point of either surface is farther from the other, mesh-local
    part: np.ndarray  # (Q+1,) i64  level q has parts [part[q], part[q+1])
    part_triangle: np.ndarray  # (R+1,) i64  part r has triangles [r, r+1)
    index: np.ndarray  # (T,3) i32  into the scene's vertex arrays

    @property
    def n_levels(self) -> int:
        return len(self.error_m)

    @property
    def triangles(self) -> np.ndarray:
        """(Q,) i64: triangles of each level."""
        ends = self.part_triangle[self.part]
        return ends[1:] - ends[:-1]

    def of_meshes(self) -> list[list[list[np.ndarray]]]:
        """Return for each mesh its levels, for each level the triangles (T,3) i32 of each primitive; [] without any."""
        ends = self.part_triangle.tolist()
        parts = [self.index[a:b] for a, b in pairwise(ends)]
        levels = [parts[a:b] for a, b in pairwise(self.part.tolist())]
        return [levels[a:b] for a, b in pairwise(self.row.tolist())] if levels else []


def no_levels() -> Levels:
    """Return what a skipped stage hands on: every mesh is drawn as it is."""
    none = np.zeros(0, np.int64)
    return Levels(
        sight=0.0, row=none, error_m=np.zeros(0), part=np.zeros(1, np.int64), part_triangle=np.zeros(1, np.int64),
        index=np.zeros((0, 3), np.int32),
    )  # fmt: skip
