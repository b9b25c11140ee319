"""Write the placement database: everything -> named files.

Problem  A viewer wants, at a cell and a direction, what to draw, from few files that never change under their names.
Method   Cut layers into polygons over blocks of texels (`layers`), lay the blocks out on pages by the cells that
         show them (`pack`, `pages`), cut the lists along the view-space tree (`chunks`), name each file by
         its digest, and state all of them in one manifest. Format: docs/formats/placementdb.md.
"""

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import numpy as np

from farfield.bake.model import BakedLayers
from farfield.detail.model import Levels
from farfield.geometry.cells import CellTree
from farfield.geometry.intervals import edges
from farfield.hierarchy.model import Hierarchy
from farfield.placement.model import Placement, fresh_of
from farfield.placement.repair import verdict
from farfield.placementdb import layout
from farfield.placementdb.base import NAME as BASE
from farfield.placementdb.base import KeptLayers, base_file
from farfield.placementdb.chunks import Chunk, build_chunks
from farfield.placementdb.geometry import build_geometry
from farfield.placementdb.layers import Pieces, cut_layers, tile_texels
from farfield.placementdb.pack import pack_blocks
from farfield.placementdb.pages import build_pages
from farfield.placementdb.squeeze import squeeze
from farfield.placementdb.table import LayerTable, joined, table_of, take
from farfield.rendertime.model import CostModel
from farfield.scene.model import Scene
from farfield.settings import Settings, to_mapping
from farfield.viewspace.model import ProblemViews
from farfield.visibility.model import VisibleSets


def build_files(
    scene: Scene, hierarchy: Hierarchy, model: CostModel, cells: CellTree, visible: VisibleSets, views: ProblemViews,
    placement: Placement, baked: BakedLayers, *, settings: Settings, digests: Mapping[str, str],
    levels: Levels | None = None, lighting: Mapping[str, Any] | None = None, threads: int | None = None,
) -> dict[str, bytes]:  # fmt: skip
    """Return the files of `placement/`, relative name -> content, the same bytes for any number of `threads`.

    All arguments as of `build`.
    """
    return build(
        scene, hierarchy, model, cells, visible, views, placement, baked, settings=settings, digests=digests,
        levels=levels, lighting=lighting, threads=threads,
    )[0]  # fmt: skip


def build(
    scene: Scene, hierarchy: Hierarchy, model: CostModel, cells: CellTree, visible: VisibleSets, views: ProblemViews,
    placement: Placement, baked: BakedLayers, *, settings: Settings, digests: Mapping[str, str],
    levels: Levels | None = None, lighting: Mapping[str, Any] | None = None, threads: int | None = None,
    kept: KeptLayers | None = None,
) -> tuple[dict[str, bytes], bytes]:  # fmt: skip
    """Return the files of `placement/`, and the file by which another placement starts from this one.

    placement    after `repair`: costs and bytes as measured; its impostors are those of `baked`, row by row, but for
                 those of a base
    digests      name -> SHA-256 (hex) of what went in; "scene.glb", where given, is stated as the viewer's level
    levels       of detail of the scene's meshes: the level is written in pages, too; None: it is in scene.glb only
    lighting     how geometry and impostors are shaded alike, JSON values; None: as the bake shades
    threads      that encode pages; None: as many as this process may use
    kept         the layers and pages of the impostors that the placement took from a base
    """
    fresh = fresh_of(placement)
    assert len(fresh) == len(baked.eye), "placement and bake disagree on the impostors"
    assert len(placement.serve_row) == len(views.cell) + 1
    shown = np.zeros(len(placement.cluster), dtype=bool)
    shown[placement.serve] = True
    pieces = cut_layers(baked, shown[fresh])
    block_page, block_at = pack_blocks(pieces.block_rect[:, 2:], *_block_cells(views, placement, fresh, pieces))
    if lighting is None:  # late: a caller who says how it is lit needs no renderer
        from farfield.bake.shade import LIGHTING

        lighting = LIGHTING
    threads = len(os.sched_getaffinity(0)) if threads is None else threads
    pages = build_pages(
        _page_blocks(baked, pieces, block_page, block_at), page_format=settings.bake.page_format, threads=threads
    )
    pages = [*(kept.pages if kept is not None else ()), *pages]
    table = _table(placement, table_of(baked, pieces, block_page, block_at), kept)
    chunks = build_chunks(cells, visible, views, placement, table)

    files: dict[str, bytes] = {}

    def add(folder: str, content: bytes, suffix: str) -> dict[str, Any]:
        digest = hashlib.sha256(content).hexdigest()
        name = f"{folder}{digest[: layout.NAME_DIGITS]}{suffix}"
        assert files.setdefault(name, content) == content, f"two files want the name {name}"
        return {"file": name, "bytes": len(content), "sha256": digest}

    def add_columns(
        folder: str, kind: str, columns: Mapping[str, np.ndarray], meta: Mapping[str, Any] | None = None
    ) -> dict[str, Any]:
        content, expanded = squeeze(kind, columns, meta)
        return add(folder, content, ".ffz") | {"expanded": expanded}

    index = _index(scene, hierarchy, model, cells, views, placement, table, chunks)
    names = {**layout.INDEX, **layout.DETAIL} if len(model.level_row) else layout.INDEX
    index_entry = add_columns("index-", layout.INDEX_KIND, layout.cast(index, names))
    chunk_entries = []
    for i, chunk in enumerate(chunks):
        meta = {"chunk": i, "cells": list(chunk.cells), "views": list(chunk.views)}
        entry = add_columns("chunks/", layout.CHUNK_KIND, chunk.columns, meta)
        box = (cells.box[chunk.node] + scene.origin_m).tolist()
        used = np.unique(chunk.columns["layer_page"]).tolist()
        chunk_entries.append(
            entry | {k: meta[k] for k in ("cells", "views")} | {"node": chunk.node, "box": box, "pages": used}
        )
    impostor_of = np.repeat(np.arange(len(table.eye)), np.diff(table.layer_row))
    users = np.unique(np.stack([table.page, impostor_of], axis=-1), axis=0)[:, 0]
    page_entries = [
        add("pages/", page, layout.SUFFIX[settings.bake.page_format]) | {"impostors": int((users == k).sum())}
        for k, page in enumerate(pages)
    ]
    listed = [index_entry, *chunk_entries, *page_entries]
    geometry = None
    if levels is not None:
        cut = build_geometry(scene, levels)
        geometry = {
            "index": add_columns("geometry/", layout.GEOMETRY_INDEX_KIND, cut.index),
            "pages": [add_columns("geometry/", layout.GEOMETRY_PAGE_KIND, page.columns, {"page": i}) | {"memory": page.memory}
                      for i, page in enumerate(cut.pages)],
            "textures": [add("textures/", t.content, t.suffix) | {"width": t.width, "height": t.height} for t in cut.textures],
            "notice": scene.notice,
        }  # fmt: skip
    base = base_file(scene, hierarchy, cells, views, placement, table)
    counts = _counts(scene, hierarchy, cells, views, placement, table)
    manifest = _manifest(scene, model, visible, views, placement, settings) | {
        "counts": counts | {"chunks": len(chunks), "pages": len(pages)},
        "index": index_entry, "chunks": chunk_entries, "pages": page_entries,
        "file_bytes": sum(entry["bytes"] for entry in listed),
        "video_bytes": len(pages) * layout.PAGE_WIDTH * layout.PAGE_HEIGHT * 4,
        "lighting": dict(lighting), "geometry": geometry,
        "scene": {"file": "scene.glb", "sha256": digests["scene.glb"]} if "scene.glb" in digests else None,
        "base": {"file": BASE, "bytes": len(base), "sha256": hashlib.sha256(base).hexdigest()},
        "provenance": {
            "settings": to_mapping(settings), "software": {"farfield": version("farfield"), "renderer": _renderer(baked, kept)},
            "inputs": dict(digests),
        },
    }  # fmt: skip
    files[layout.MANIFEST] = sealed(manifest)
    return files, base


def sealed(manifest: Mapping[str, Any]) -> bytes:
    """Return the manifest's bytes, with the digest of themselves in `manifest_sha256`."""
    values = {**manifest, "manifest_sha256": "0" * 64}
    text = json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False).encode("ascii") + b"\n"
    assert text.count(layout.DIGEST_KEY) == 1
    digest = hashlib.sha256(text).hexdigest().encode()
    return text.replace(layout.DIGEST_KEY + b"0" * 64, layout.DIGEST_KEY + digest)


def _table(placement: Placement, laid_out: LayerTable, kept: KeptLayers | None) -> LayerTable:
    """Return the table of all impostors; `laid_out` is that of the fresh ones, its pages numbered from 0."""
    if kept is None:
        return laid_out
    old = placement.base >= 0
    all = joined(kept.table, replace(laid_out, page=laid_out.page + np.int32(len(kept.pages))))
    return take(all, np.where(old, np.cumsum(old), old.sum() + np.cumsum(~old)) - 1)


def _renderer(baked: BakedLayers, kept: KeptLayers | None) -> str:
    names = [*(kept.renderer.split(" + ") if kept is not None else ()), *baked.renderer.split(" + ")]
    return " + ".join(dict.fromkeys(name for name in names if name))


def _block_cells(
    views: ProblemViews, placement: Placement, fresh: np.ndarray, pieces: Pieces
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what `pack_blocks` asks for: owner (B,) of each block, and (row, cell) of each owner's cells.

    An owner is an impostor, or a set of them with equal tiles: where those are shown, all of them are.

    fresh  (F,) the impostors of `pieces`
    """
    number = np.full(len(placement.cluster), -1)
    number[fresh] = np.arange(len(fresh))
    impostor, cell = number[placement.serve], np.repeat(views.cell, np.diff(placement.serve_row))
    shown = np.unique(np.stack([impostor, cell], axis=1)[impostor >= 0], axis=0)
    pair = np.unique(np.stack([pieces.block, np.repeat(np.arange(len(fresh)), np.diff(pieces.row))], axis=1), axis=0)
    times = np.bincount(pair[:, 0], minlength=len(pieces.block_rect))
    sets: dict[bytes, int] = {}
    owner = pair[np.searchsorted(pair[:, 0], np.arange(len(times))), 1]
    shown_row = np.searchsorted(shown[:, 0], np.arange(len(fresh) + 1))
    cells = [shown[shown_row[i] : shown_row[i + 1], 1] for i in range(len(fresh))]
    for block in np.flatnonzero(times > 1):
        members = pair[slice(*np.searchsorted(pair[:, 0], [block, block + 1])), 1]
        owner[block] = sets.setdefault(members.tobytes(), len(cells))
        if owner[block] == len(cells):
            cells.append(np.unique(np.concatenate([cells[i] for i in members])))
    row = np.concatenate([[0], np.cumsum([len(c) for c in cells], dtype=np.int64)])
    return owner, row, np.concatenate([np.zeros(0, dtype=np.int64), *cells])


def _page_blocks(
    baked: BakedLayers, pieces: Pieces, block_page: np.ndarray, block_at: np.ndarray
) -> Sequence[Sequence[tuple[int, int, np.ndarray]]]:
    pages: list[list[tuple[int, int, np.ndarray]]] = [[] for _ in range(int(block_page.max(initial=-1)) + 1)]
    for block, page in enumerate(block_page):
        x, y, w, h = (int(n) for n in pieces.block_rect[block])
        texels = tile_texels(baked, int(pieces.block_tile[block]))[y : y + h, x : x + w]
        pages[page].append((int(block_at[block, 0]), int(block_at[block, 1]), texels))
    return pages


def _index(
    scene: Scene, hierarchy: Hierarchy, model: CostModel, cells: CellTree, views: ProblemViews, placement: Placement,
    table: LayerTable, chunks: Sequence[Chunk],
) -> dict[str, np.ndarray]:  # fmt: skip
    n = len(placement.cluster)
    first_chunk = np.full(n, -1)
    for k in reversed(range(len(chunks))):
        first_chunk[chunks[k].columns["impostor_id"]] = k
    corners = np.concatenate([[0], np.cumsum(np.diff(table.corner_row) - 2)])
    triangles = corners[table.layer_row[1:]] - corners[table.layer_row[:-1]]
    return {
        "node_axis": cells.axis, "node_plane": cells.plane, "node_low": cells.low, "node_high": cells.high,
        "node_parent": cells.parent, "node_box": cells.box, "node_start": cells.start, "node_stop": cells.stop,
        "cell_node": cells.leaf, "cell_cost": views.cell_cost, "view_box": scene.view_boxes,
        "object_box": scene.object_box, "object_cost": model.object_fixed, "object_calls": scene.object_calls,
        "object_triangles": scene.object_triangles, "cluster_start": hierarchy.start, "cluster_stop": hierarchy.stop,
        "cluster_left": hierarchy.left, "cluster_right": hierarchy.right, "cluster_parent": hierarchy.parent,
        "cluster_box": hierarchy.box, "impostor_cluster": placement.cluster, "impostor_kind": placement.kind,
        "impostor_view_cell": placement.view_cell, "impostor_bytes": placement.bytes,
        "impostor_cost": placement.cost, "impostor_triangles": triangles,
        "impostor_layers": np.diff(table.layer_row), "impostor_chunk": first_chunk,
    } | ({
        "level_row": model.level_row, "level_from": model.level_from, "level_cost": model.level_fixed,
        "level_triangles": model.level_triangles,
    } if len(model.level_row) else {})  # fmt: skip


def _counts(
    scene: Scene, hierarchy: Hierarchy, cells: CellTree, views: ProblemViews, placement: Placement, table: LayerTable
) -> dict[str, int]:
    return {
        "objects": scene.n_objects, "triangles": int(scene.object_triangles.sum()), "clusters": len(hierarchy.start),
        "nodes": len(cells.axis), "cells": cells.n_cells, "problem_views": len(views.cell),
        "hopeless_views": int(placement.hopeless.sum()), "impostors": len(placement.cluster),
        "layers": len(table.page),
    }  # fmt: skip


def _manifest(
    scene: Scene, model: CostModel, visible: VisibleSets, views: ProblemViews, placement: Placement, settings: Settings
) -> dict[str, Any]:
    origin = scene.origin_m
    low, high = scene.object_box[:, 0], scene.object_box[:, 1]
    prices = ("call", "triangle", "pixel", "impostor", "impostor_triangle", "impostor_pixel")
    return {
        "format": layout.FORMAT, "version": layout.VERSION,
        "units": {"length": "m", "angle": "deg", "cost": model.unit, "texture": "texel"},
        "origin_m": origin.tolist(), "view_space": (scene.view_boxes + origin).tolist(),
        "camera": {"fov_deg": model.fov_deg, "width": model.width, "height": model.height},
        "quality": to_mapping(settings)["quality"],
        "budget": {"text": settings.budget, "unit": model.unit, "amount": model.budget},
        "cost_model": {"per_frame": model.per_frame, "target": model.target}
        | {f"per_{price}": getattr(model, f"per_{price}") for price in prices},
        "interval_edges": edges(round(90 / settings.view_space.interval_deg)).tolist(),
        "bounds": (np.stack([low.min(0), high.max(0)]) + origin).tolist() if scene.n_objects else None,
        "bytes": int(placement.bytes.sum()), "worst_nonproblem": int(views.worst_nonproblem),
        "visibility": visible.mode, "verdict": verdict(placement, model),
        "page": {
            "size": layout.PAGE_TEXELS, "width": layout.PAGE_WIDTH, "height": layout.PAGE_HEIGHT,
            "levels": [{"x": x, "y": y, "size": size} for x, y, size in layout.LEVELS],
            **({"format": settings.bake.page_format} if settings.bake.page_format != "webp" else {}),
        },
    }  # fmt: skip
