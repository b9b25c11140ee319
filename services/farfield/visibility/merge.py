"""Join the shards: OR their sets, close what has no free point, and measure the result by what was held out.

The held-out rays of all shards are one sample, spread evenly over the free part of the view space: every shard drew its
share of one number of points, by volume. None was ever marked or looked at before, and all are looked up in the merged
sets, so what is stated of them is the plain binomial bound of `confidence`.
"""

from collections.abc import Sequence

import numpy as np

from farfield.geometry.cells import CellTree
from farfield.scene.model import Scene
from farfield.visibility import kernels
from farfield.visibility.confidence import upper_ppm
from farfield.visibility.model import Sightings, VisibleSets
from farfield.visibility.sample import VIEW_PX


def merge(scene: Scene, cells: CellTree, parts: Sequence[Sightings]) -> VisibleSets:
    """Return the visible sets of all leaf cells from the shards' artifacts, in any order; at least one."""
    first = parts[0]
    assert all((p.mode, p.rule, p.seen_share) == (first.mode, first.rule, first.seen_share) for p in parts)
    seen = np.zeros((cells.n_cells, first.bits.shape[1]), dtype=np.uint64)
    for part in parts:
        seen[part.cell] |= part.bits
    closed = np.sort(np.concatenate([p.closed for p in parts])).astype(np.int32)
    for cell in closed:
        box = cells.cell_box[cell]
        met = np.flatnonzero(((scene.object_box[:, 0] <= box[1]) & (scene.object_box[:, 1] >= box[0])).all(1))
        np.bitwise_or.at(seen[cell], met // 64, np.uint64(1) << (met % 64).astype(np.uint64))
    row = np.concatenate([[0], np.cumsum(kernels.sizes(seen))])
    object = np.empty(int(row[-1]), dtype=np.int32)
    kernels.members(seen, row, object)

    held, missed = sum(p.held_out for p in parts), 0
    shares = [np.zeros(0)]
    for part in parts:
        missed += int(part.held_count[_unseen(seen, part.held_cell, part.held_object)].sum())
        cell = np.repeat(part.view_cell, np.diff(part.view_row))
        lost = np.where(_unseen(seen, cell, part.view_object), part.view_count, 0)
        through = np.concatenate([[0], np.cumsum(lost)])
        shares.append((through[part.view_row[1:]] - through[part.view_row[:-1]]) * (1e6 / VIEW_PX**2))
    ppm = np.sort(np.concatenate(shares))
    return VisibleSets(
        mode=first.mode, row=row, object=object, closed=closed, rays=sum(p.rays for p in parts), rule=first.rule,
        occluders=first.occluders, seen_share=first.seen_share, held_out=held, held_out_missed=missed,
        missed_ppm_upper=upper_ppm(missed, held) if held else None, views=len(ppm),
        p99_ppm=float(ppm[-1 - len(ppm) // 100]) if len(ppm) else None,
        worst_ppm=float(ppm[-1]) if len(ppm) else None,
    )  # fmt: skip


def _unseen(seen: np.ndarray, cell: np.ndarray, object: np.ndarray) -> np.ndarray:
    out = np.empty(len(cell), dtype=np.bool_)
    kernels.is_seen(seen, cell, object, out)
    return ~out
