"""What of a cluster shows in its impostor, with a bounded number of its triangles in memory.

Problem  The arrays of a bake take about 200 bytes a triangle, and a cluster may have ten million. An impostor has no more
         texels for that: most of these triangles show nowhere.
Method   Which piece shows in a texel, and at each of its points, is the least in a total order (depth, then number). What
         loses among some triangles therefore loses among all. So MOST at a time are cut and recorded, and those that show
         in no texel and at no point are dropped; what is left of all, in the order of the file, is recorded as any small
         cluster, to the same bytes. The rectangles of the layers come from all triangles, in a pass before.
         Where hardly anything is dropped, what is kept is tried again each time that it has doubled.
Errs     Never: nothing that shows is dropped. What is kept is bounded by the texels (17 triangles each at most), not by a
         number of bytes.
Measured A field of 5 million triangles, 1280 x 720: 1,006 MiB of its own -> 352, and 2,447 -> 275 in the process that draws;
         10.8 instead of 8.1 s of CPU. A city of 10 million: 406 and 241. See tests/benchmarks/results/bake.md.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numba import njit

from farfield.bake.area import BAND, NOTHING, POINTS, sample_band
from farfield.bake.clip import bound, count_triangles, cut, gather
from farfield.bake.records import Pieces, Slabs, Sources, Surface
from farfield.bake.sheets import lay_out
from farfield.columns import release
from farfield.impostor.plan import LayerPlan
from farfield.scene.model import Scene

MOST = 1 << 18  # triangles at once: 50 MB, more where they cross many layers

Record = Callable[..., np.ndarray]
Sheets = list[tuple[tuple[int, int], tuple[int, int]]]


def take(
    scene: Scene, objects: tuple[int, int], plan: LayerPlan, surface: Surface, record: Record, *, kind: int,
    view_cell: np.ndarray,
) -> tuple[Sources, Pieces, Slabs, Sheets]:  # fmt: skip
    """Return what is to be recorded of objects [a, b), laid out in sheets; of a large cluster only what shows.

    record  as `farfield.bake.coverage.record`. Raises what `farfield.bake.clip.gather` and `record` raise.
    """
    some = partial(gather, scene, objects, plan, kind=kind, view_cell=view_cell)
    n = count_triangles(scene, objects)
    if n <= MOST:
        sources = some()
        pieces = cut(sources, plan)
        slabs = bound(pieces, plan)
        return sources, pieces, slabs, lay_out(slabs)

    def batches() -> Iterator[Sources]:
        for first in range(0, n, MOST):
            yield some(triangles=(first, min(first + MOST, n)))
            release(scene.position)  # a city's mapped file is a gigabyte

    slabs = _union([bound(cut(sources, plan), plan) for sources in batches()])
    sheets = lay_out(slabs)
    visible = partial(_visible, plan=plan, slabs=slabs, sheets=sheets, surface=surface, record=record)
    kept: list[Sources] = []
    most = MOST
    for sources in batches():
        kept.append(visible(sources))
        if sum(len(k.vertex) for k in kept) > most:
            kept = [visible(_joined(kept))]
            most = max(MOST, 2 * len(kept[0].vertex))
    sources = _joined(kept)
    return sources, cut(sources, plan), slabs, sheets


def _visible(sources: Sources, *, plan: LayerPlan, slabs: Slabs, sheets: Sheets, surface: Surface,
             record: Record) -> Sources:  # fmt: skip
    """Return the sources that show in some texel, or at some point of one, where there are no others."""
    pieces = cut(sources, plan)
    shown = np.zeros(len(sources.vertex), np.bool_)
    held = max(int(slabs.size[:, 0].max(initial=1)), BAND)
    owner, depth = np.empty((held, POINTS), np.uint32), np.empty((held, POINTS), np.float32)
    for layers, size in sheets:
        sheet = record(sources, pieces, slabs, surface, layers, size)
        _mark(sources, pieces, slabs, surface, *layers, sheet, owner, depth, shown)
    return Sources(*(column[shown] for column in sources))


@njit(cache=True)
def _mark(sources: Any, pieces: Any, slabs: Any, surface: Any, first: int, last: int, sheet: Any, owner: Any, depth: Any,
          shown: Any) -> None:  # fmt: skip
    for found in sheet.flat:
        if found != 0:
            shown[pieces.source[found - 1]] = True
    for k in range(first, last):
        low, size = slabs.low[k], slabs.size[k]
        if size[0] == 0:
            continue
        rows = max(1, BAND // size[0])
        for row in range(0, size[1], rows):
            until = min(row + rows, size[1])
            n = (until - row) * size[0]
            owner[:n] = NOTHING
            depth[:n] = np.inf
            sample_band(sources, pieces, slabs, surface, k, low[1] + row, low[1] + until, owner, depth)
            for t in range(n):
                for c in range(POINTS):
                    if owner[t, c] != NOTHING:
                        shown[pieces.source[owner[t, c]]] = True


def _union(parts: list[Slabs]) -> Slabs:
    """Return the slabs whose rectangles hold those of all parts."""
    low, size = np.array([p.low for p in parts]), np.array([p.size for p in parts])
    some = size.all(2, keepdims=True)
    first = np.where(some, low, np.iinfo(np.int32).max).min(0)
    end = np.where(some, low + size, 0).max(0)
    empty = ~some.any(0)
    return parts[0]._replace(
        low=np.where(empty, 0, first).astype(np.int32), size=np.where(empty, 0, end - first).astype(np.int32)
    )


def _joined(parts: list[Sources]) -> Sources:
    return Sources(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
