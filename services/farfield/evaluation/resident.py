"""What a viewer holds at once to show any view of one view-space cell: the peak over the cells, in bytes.

Method   Of each cell: its chunk as it lies in memory, the distinct impostor pages of all its problem views in video memory
         (all mip levels, four bytes a texel), and the parts of the level that its visible objects are drawn from at their
         levels of detail (as the manifest states them; a texture takes four bytes a texel and a third more for mip levels).
         The same sums as webviewer/src/stream/caps.ts, which cap memory.
Errs     Upwards: objects that impostors cover in every view of the cell are counted as geometry, too. The index and what the
         page itself takes are not in it: they are there in every cell.
"""

from itertools import pairwise
from typing import Any

import numpy as np

from farfield.placementdb.read import Placement


def peak_resident(placement: Placement) -> dict[str, Any]:
    """Return JSON values: of the cell that needs most (the first such) `cell`, `bytes` and the `chunk_bytes`, `page_bytes` and
    `level_bytes` that these are the sum of; `median_bytes` over all cells; `all_bytes`, what everything takes.

    Raises what `Placement.open` raises where a file is damaged.
    """
    manifest = placement.manifest
    page_bytes = sum(4 * level["size"] ** 2 for level in manifest["page"]["levels"])
    level = _Level(placement)
    rows = np.zeros((manifest["counts"]["cells"], 3), dtype=np.int64)
    for cell in range(len(rows)):
        k = placement.chunk_of(cell)
        if k is not None:
            entry = manifest["chunks"][k]
            rows[cell, 0] = entry.get("expanded", entry["bytes"])
            rows[cell, 1] = page_bytes * len(pages_of(placement, cell))
        rows[cell, 2] = level.bytes_in(cell)
    sums = rows.sum(1)
    worst = int(sums.argmax()) if len(sums) else 0
    chunk, pages, parts = rows[worst].tolist() if len(rows) else (0, 0, 0)
    chunks = sum(entry.get("expanded", entry["bytes"]) for entry in manifest["chunks"])
    return {
        "cell": worst, "bytes": chunk + pages + parts, "chunk_bytes": chunk, "page_bytes": pages, "level_bytes": parts,
        "median_bytes": int(np.sort(sums)[len(sums) // 2]) if len(sums) else 0,
        "all_bytes": chunks + page_bytes * len(manifest["pages"]) + int(level.bytes.sum()),
    }  # fmt: skip


def pages_of(placement: Placement, cell: int) -> np.ndarray:
    """Return (n,) ascending: the pages of the impostors of all problem views of a cell."""
    k = placement.chunk_of(cell)
    if k is None:
        return np.zeros(0, dtype=np.int64)
    chunk, local = placement.chunk(k), cell - placement.manifest["chunks"][k]["cells"][0]
    lists = np.unique(chunk["view_list"][chunk["cell_view"][local] : chunk["cell_view"][local + 1]])
    impostors = np.unique(_rows(chunk["list_row"], chunk["list_impostor"], lists))
    return np.unique(_rows(chunk["impostor_layer"], chunk["layer_page"], impostors))


def _rows(row: np.ndarray, values: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the values of the chosen rows, one after the other."""
    parts = [values[row[k] : row[k + 1]] for k in chosen.tolist()]
    return np.concatenate(parts) if parts else values[:0]


class _Level:
    """Parts of the level: pages of geometry, then files of textures. None where the level came whole."""

    def __init__(self, placement: Placement) -> None:
        self.placement = placement
        self.bytes = np.zeros(0, dtype=np.int64)
        if placement.manifest.get("geometry") is None:
            return
        geometry = placement.geometry()
        self.columns = c = geometry["columns"]
        textures = [-(-16 * t["width"] * t["height"] // 3) for t in geometry["textures"]]
        self.bytes = np.array([*(page["memory"] for page in geometry["pages"]), *textures], dtype=np.int64)
        n_pages = len(geometry["pages"])
        of_material = [
            [n_pages + int(c["texture_file"][x]) for x in (texture, glow) if x >= 0]
            for texture, glow in zip(c["material_texture"].tolist(), c["material_glow"].tolist(), strict=True)
        ]
        row = c["mesh_primitive"].tolist()
        self.of_mesh = [
            np.unique([p for m in c["primitive_material"][a:b].tolist() for p in of_material[m]]).astype(np.int64)
            for a, b in pairwise(row)
        ]

    def bytes_in(self, cell: int) -> int:
        """Return what the objects that the cell sees are drawn from."""
        if not len(self.bytes):
            return 0
        c, seen = self.columns, np.flatnonzero(self.placement.seen_from(cell))
        meshes = c["object_mesh"][seen]
        pages = c["model_page"][c["mesh_model"][meshes] + self.placement.levels_in(cell)[seen]]
        used = np.zeros(len(self.bytes), dtype=bool)
        used[pages[pages >= 0]] = True
        for mesh in np.unique(meshes).tolist():
            used[self.of_mesh[mesh]] = True
        return int(self.bytes[used].sum())
