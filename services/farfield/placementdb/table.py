"""What is drawn of each impostor, as one table: frames, and polygons over blocks of texels on pages.

`chunks` cuts it along the view-space tree. A placement that keeps impostors of an earlier one takes their rows from its
table as they are, and lays only the others out anew.
"""

from dataclasses import dataclass, fields

import numpy as np

from farfield.bake.model import BakedLayers
from farfield.placementdb.layers import Pieces


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerTable:
    """I impostors, R polygons, Q corners."""

    eye: np.ndarray  # (I,3) f64  relative to the scene's origin_m
    right: np.ndarray  # (I,3) f64
    up: np.ndarray  # (I,3) f64
    layer_row: np.ndarray  # (I+1,) i64  none where the impostor is not shown
    number: np.ndarray  # (R,) u2  of the layer in its impostor, near to far
    plane: np.ndarray  # (R,) f64  distances from the eye
    inverse_near: np.ndarray  # (R,) f64
    inverse_far: np.ndarray  # (R,) f64
    page: np.ndarray  # (R,) i4
    rect: np.ndarray  # (R,4) u2  x, y, width, height in the page
    corner_row: np.ndarray  # (R+1,) i64  3 to 8 corners each
    position: np.ndarray  # (Q,3) f32  relative to the eye
    uv: np.ndarray  # (Q,2) f32  texels of the page


def table_of(baked: BakedLayers, pieces: Pieces, block_page: np.ndarray, block_at: np.ndarray) -> LayerTable:
    """Return the table of baked impostors whose blocks lie at block_at (B,2) i64 of pages block_page (B,) i64."""
    block, layer = pieces.block, pieces.layer
    rect = np.concatenate([block_at[block], pieces.block_rect[block, 2:]], axis=1)
    uv = pieces.corner + np.repeat(block_at[block], np.diff(pieces.corner_row), axis=0)
    return LayerTable(
        eye=baked.eye, right=baked.right, up=baked.up, layer_row=pieces.row, number=pieces.number.astype(np.uint16),
        plane=baked.plane[layer], inverse_near=1 / baked.near[layer], inverse_far=1 / baked.far[layer],
        page=block_page[block].astype(np.int32), rect=rect.astype(np.uint16), corner_row=pieces.corner_row,
        position=pieces.position, uv=uv.astype(np.float32),
    )  # fmt: skip


def joined(first: LayerTable, then: LayerTable) -> LayerTable:
    """Return both tables as one."""

    def column(name: str) -> np.ndarray:
        a, b = getattr(first, name), getattr(then, name)
        return np.concatenate([a, b[1:] + a[-1]] if name.endswith("_row") else [a, b])

    return LayerTable(**{f.name: column(f.name) for f in fields(LayerTable)})


def take(table: LayerTable, ids: np.ndarray) -> LayerTable:
    """Return the impostors `ids` (M,), in that order."""
    layer_row, rows = spans(table.layer_row, ids)
    corner_row, corners = spans(table.corner_row, rows)
    of_impostor = {name: getattr(table, name)[ids] for name in ("eye", "right", "up")}
    of_row = {
        name: getattr(table, name)[rows] for name in ("number", "plane", "inverse_near", "inverse_far", "page", "rect")
    }
    return LayerTable(
        **of_impostor, **of_row, layer_row=layer_row, corner_row=corner_row, position=table.position[corners],
        uv=table.uv[corners],
    )  # fmt: skip


def spans(row: np.ndarray, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (CSR rows, entry numbers) of the rows `ids` of a CSR table with row starts `row`, one after the other."""
    count = row[ids + 1] - row[ids]
    out = np.concatenate([[0], np.cumsum(count)])
    return out, np.arange(out[-1]) + np.repeat(row[ids] - out[:-1], count)
