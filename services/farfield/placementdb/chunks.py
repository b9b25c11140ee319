"""Cut the placement along the view-space tree: what the cells of one subtree show, and the impostors used there.

Method   A chunk is a largest subtree of at most `CELLS` leaf cells. Equal lists are stored once. The tables
         of an impostor are repeated in every chunk that shows it: a chunk needs no other to be drawn.
"""

from dataclasses import dataclass

import numpy as np

from farfield.geometry.cells import CellTree, subtrees
from farfield.placement.model import Placement
from farfield.placementdb.layout import CHUNK, cast
from farfield.placementdb.table import LayerTable, take
from farfield.viewspace.model import ProblemViews
from farfield.visibility.model import VisibleSets

CELLS = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Chunk:
    """The columns of one chunk, and its place: `cells` and `views` are half-open ranges of ids."""

    node: int
    cells: tuple[int, int]
    views: tuple[int, int]
    columns: dict[str, np.ndarray]


def build_chunks(
    cells: CellTree, visible: VisibleSets, views: ProblemViews, placement: Placement, table: LayerTable
) -> list[Chunk]:
    """Return the chunks that have something to say, in order of their cells."""
    sees_all = visible.row.size == 0
    out = []
    for node in subtrees(cells, most=CELLS):
        a, b = int(cells.start[node]), int(cells.stop[node])
        va, vb = (int(v) for v in np.searchsorted(views.cell, [a, b]))
        if va == vb and sees_all:
            continue
        columns = _view_columns(views, placement, (a, b), (va, vb))
        columns |= _visible_columns(visible, (a, b))
        ids = np.unique(columns["list_impostor"])
        columns["list_impostor"] = np.searchsorted(ids, columns["list_impostor"])
        columns |= _impostor_columns(ids, table)
        out.append(Chunk(node=node, cells=(a, b), views=(va, vb), columns=cast(columns, CHUNK)))
    return out


def _view_columns(
    views: ProblemViews, placement: Placement, cells: tuple[int, int], span: tuple[int, int]
) -> dict[str, np.ndarray]:
    (a, b), (va, vb) = cells, span
    shown = [placement.serve[placement.serve_row[v] : placement.serve_row[v + 1]] for v in range(va, vb)]
    which, row, impostor = _once(shown)
    return {
        "cell_view": np.searchsorted(views.cell[va:vb], np.arange(a, b + 1)),
        "view_interval": views.interval[va:vb], "view_cost": placement.view_cost[va:vb],
        "view_geometry_cost": views.cost[va:vb], "view_hopeless": placement.hopeless[va:vb].astype(np.uint8),
        "view_list": which, "list_row": row, "list_impostor": impostor,
    }  # fmt: skip


def _visible_columns(visible: VisibleSets, cells: tuple[int, int]) -> dict[str, np.ndarray]:
    if visible.row.size == 0:
        none = np.zeros(0, dtype=np.int32)
        return {"cell_visible": none, "visible_row": none, "visible_object": none}
    which, row, seen = _once([visible.object[visible.row[c] : visible.row[c + 1]] for c in range(*cells)])
    return {"cell_visible": which, "visible_row": row, "visible_object": seen}


def _once(lists: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (which distinct list each is, CSR rows of the distinct ones, their entries), in order of first use."""
    known: dict[bytes, int] = {}
    which: list[int] = []
    distinct: list[np.ndarray] = []
    for entries in lists:
        entries = np.ascontiguousarray(entries, dtype=np.int32)
        key = entries.tobytes()
        if key not in known:
            known[key] = len(distinct)
            distinct.append(entries)
        which.append(known[key])
    row = np.cumsum([0, *(len(entries) for entries in distinct)])
    return np.array(which, dtype=np.int32), row, np.concatenate([np.zeros(0, np.int32), *distinct])


def _impostor_columns(ids: np.ndarray, table: LayerTable) -> dict[str, np.ndarray]:
    some = take(table, ids)
    return {
        "impostor_id": ids, "impostor_eye": some.eye, "impostor_right": some.right, "impostor_up": some.up,
        "impostor_layer": some.layer_row, "layer_number": some.number, "layer_plane": some.plane,
        "layer_inverse_near": some.inverse_near, "layer_inverse_far": some.inverse_far, "layer_page": some.page,
        "layer_rect": some.rect, "layer_corner": some.corner_row, "corner_position": some.position, "corner_uv": some.uv,
    }  # fmt: skip
