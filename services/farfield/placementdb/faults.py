"""What is wrong with a manifest, an index or a chunk whose digest is right: a file made by someone else, or a defect.

Each function returns a clause that completes "FILE is altered or damaged: ...", or None.
"""

from typing import Any

import numpy as np

from farfield.placementdb import layout

_Columns = dict[str, np.ndarray]


def manifest_fault(manifest: dict[str, Any]) -> str | None:
    """Check the keys that a reader relies on, their types, and the ranges of the chunks."""
    sound = True
    try:
        origin = [float(x) for x in manifest["origin_m"]]
        boxes = np.array(manifest["view_space"], dtype=np.float64)
        edges = np.array(manifest["interval_edges"], dtype=np.float64)
        numbers = [manifest["worst_nonproblem"], manifest["cost_model"]["per_frame"], manifest["budget"]["amount"]]
        numbers += [manifest["counts"][k] for k in ("objects", "cells", "problem_views", "impostors")]
        entries = [manifest["index"], *manifest["chunks"], *manifest["pages"]]
        if geometry := manifest.get("geometry"):
            entries += [geometry["index"], *geometry["pages"], *geometry["textures"]]
            sound = all(type(e["memory"]) is int for e in geometry["pages"])
            numbers += [e[key] for e in geometry["textures"] for key in ("width", "height")]
        if base := manifest.get("base"):
            entries.append(base)
        numbers += [e["expanded"] for e in entries if e["file"].endswith(".ffz")]
        sound = sound and len(origin) == 3 and boxes.ndim == 3 and boxes.shape[1:] == (2, 3)
        sound = sound and edges.ndim == 1 and len(edges) >= 2 and bool((np.diff(edges) > 0).all())
        sound = sound and all(type(n) is int for n in numbers)
        sound = sound and all(
            type(e["file"]) is str and type(e["bytes"]) is int and type(e["sha256"]) is str for e in entries
        )
        suffix = layout.SUFFIX[manifest["page"].get("format", "webp")]
        sound = sound and all(e["file"].endswith(suffix) for e in manifest["pages"])
        at = {"cells": 0, "views": 0}
        for entry in manifest["chunks"]:
            for key, stop in (("cells", manifest["counts"]["cells"]), ("views", manifest["counts"]["problem_views"])):
                a, b = entry[key]
                sound = sound and type(a) is int and type(b) is int and at[key] <= a <= b <= stop
                at[key] = b
    except (KeyError, TypeError, ValueError):
        sound = False
    return None if sound else "a key is missing or has the wrong type"


def index_fault(index: _Columns, manifest: dict[str, Any]) -> str | None:
    """Check shapes, ids, and that both trees are trees."""
    fault = layout.misfit(index, {**layout.INDEX, **layout.DETAIL} if "level_row" in index else layout.INDEX)
    if fault:
        return fault
    if "level_row" in index:
        row = index["level_row"]
        if row[0] != 0 or row[-1] != len(index["level_from"]) or (np.diff(row) < 0).any():
            return "the rows level_row do not cut what they should"
    elif manifest["version"] == layout.DETAIL_VERSION:
        return "column level_row is missing"
    count = manifest["counts"]
    for name, key in (("object_box", "objects"), ("cell_node", "cells"), ("impostor_cluster", "impostors")):
        if len(index[name]) != count[key]:
            return f"column {name} has not as many rows as the manifest states"
    nodes, cells, clusters, n_objects = (
        len(index["node_axis"]), len(index["cell_node"]), len(index["cluster_start"]), len(index["object_box"])
    )  # fmt: skip
    if not len(index["view_box"]) or not nodes:
        return "there is no view space"
    inner = index["node_axis"] >= 0
    for child in (index["node_low"][inner], index["node_high"][inner]):
        if not ((child > np.flatnonzero(inner)) & (child < nodes)).all():  # ascending: a descent ends
            return "the view-space tree is no tree"
    start, stop = index["node_start"], index["node_stop"]
    if (index["node_axis"] > 2).any() or not ((start >= 0) & (start < stop) & (stop <= cells)).all():
        return "a node of the view-space tree is out of range"
    a, b = index["cluster_start"], index["cluster_stop"]
    if not ((a >= 0) & (a < b) & (b <= n_objects)).all():
        return "a cluster is out of range"
    if not _within(index["impostor_cluster"], clusters) or (index["impostor_kind"] > 1).any():
        return "an impostor is out of range"
    if not _within(index["impostor_chunk"] + 1, len(manifest["chunks"]) + 1):
        return "an impostor names a chunk that is not there"
    return None


def chunk_fault(chunk: _Columns, meta: dict[str, Any], entry: dict[str, Any], manifest: dict[str, Any]) -> str | None:
    """Check shapes, rows and ids against the manifest's entry of the chunk."""
    fault = layout.misfit(chunk, layout.CHUNK)
    if fault:
        return fault
    count = manifest["counts"]
    n, v = (entry[key][1] - entry[key][0] for key in ("cells", "views"))
    if meta.get("cells") != entry["cells"] or meta.get("views") != entry["views"]:
        return "it is the chunk of other cells"
    if len(chunk["cell_view"]) != n + 1 or len(chunk["view_interval"]) != v:
        return "it has not as many cells or problem views as the manifest states"
    rows = [("cell_view", v), ("list_row", len(chunk["list_impostor"])), ("impostor_layer", len(chunk["layer_page"]))]
    rows += [("layer_corner", len(chunk["corner_uv"]))]
    if len(chunk["cell_visible"]):
        rows += [("visible_row", len(chunk["visible_object"]))]
    if fault := _rows_fault(chunk, rows):
        return fault
    ids = [
        ("cell_visible", max(len(chunk["visible_row"]) - 1, 0)), ("visible_object", count["objects"]),
        ("view_list", len(chunk["list_row"]) - 1), ("list_impostor", len(chunk["impostor_id"])),
        ("impostor_id", count["impostors"]), ("layer_page", len(manifest["pages"])),
    ]  # fmt: skip
    for name, size in ids:
        if not _within(chunk[name], size):
            return f"an entry of {name} is out of range"
    if fault := _layers_fault(chunk["layer_corner"], chunk["layer_rect"]):
        return fault
    if (np.diff(chunk["impostor_id"]) <= 0).any():
        return "its impostors are not in ascending order"
    return None


def geometry_fault(columns: _Columns, manifest: dict[str, Any], index: _Columns) -> str | None:
    """Check shapes, rows and ids of the index of the geometry; every object has the levels that it is drawn at."""
    fault = layout.misfit(columns, layout.GEOMETRY_INDEX)
    if fault:
        return fault
    if len(columns["object_mesh"]) != manifest["counts"]["objects"]:
        return "it has not as many objects as the manifest states"
    rows = [("mesh_primitive", len(columns["primitive_material"])), ("mesh_model", len(columns["model_page"]))]
    if fault := _rows_fault(columns, rows):
        return fault
    geometry = manifest["geometry"]
    ids = [
        ("object_mesh", 0, len(columns["mesh_model"]) - 1), ("primitive_material", 0, len(columns["material_alpha"])),
        ("model_page", -1, len(geometry["pages"])), ("material_texture", -1, len(columns["texture_file"])),
        ("material_glow", -1, len(columns["texture_file"])), ("texture_file", 0, len(geometry["textures"])),
    ]  # fmt: skip
    for name, low, stop in ids:
        if not ((columns[name] >= low) & (columns[name] < stop)).all():
            return f"an entry of {name} is out of range"
    mesh = columns["object_mesh"]
    models = np.diff(columns["mesh_model"])[mesh]
    levels = np.diff(index["level_row"]) if "level_row" in index else 0
    if (models < 1 + levels).any() or (columns["model_page"][columns["mesh_model"][mesh]] < 0).any():
        return "an object lacks one of its levels"
    return None


def geometry_page_fault(columns: _Columns) -> str | None:
    """Check shapes, rows and vertex numbers of a page of the geometry."""
    fault = layout.misfit(columns, layout.GEOMETRY_PAGE)
    if fault:
        return fault
    rows = [("model_part", len(columns["part_triangle"]) - 1), ("part_triangle", len(columns["index"]))]
    if fault := _rows_fault(columns, rows):
        return fault
    return None if _within(columns["index"], len(columns["position"])) else "a triangle has a vertex that is not there"


def base_fault(columns: _Columns, manifest: dict[str, Any]) -> str | None:
    """Check shapes, rows and ids of a base, and that no figure of it is impossible."""
    fault = layout.misfit(columns, layout.BASE)
    if fault:
        return fault
    if len(columns["start"]) != manifest["counts"]["impostors"]:
        return "it has not as many impostors as the manifest states"
    rows = [("cell_row", len(columns["cell"])), ("table_layer_row", len(columns["table_page"]))]
    rows += [("table_corner_row", len(columns["table_uv"]))]
    if fault := _rows_fault(columns, rows):
        return fault
    start, stop = columns["start"], columns["stop"]
    if (
        not ((start >= 0) & (start < stop) & (stop <= len(columns["object_digest"]))).all()
        or (columns["kind"] > 1).any()
    ):
        return "an impostor is out of range"
    for name, size in (("cell", len(columns["cell_box"])), ("table_page", len(manifest["pages"]))):
        if not _within(columns[name], size):
            return f"an entry of {name} is out of range"
    if (columns["bytes"] <= 0).any() or (columns["cost"] < 0).any() or np.isnan(columns["view_cell"]).any():
        return "an impostor has an impossible size, cost or view cell"
    return _layers_fault(columns["table_corner_row"], columns["table_rect"])


def _rows_fault(columns: _Columns, rows: list[tuple[str, int]]) -> str | None:
    """Check that each named column of row starts ascends from 0 to its size."""
    for name, size in rows:
        row = columns[name]
        if not len(row) or row[0] != 0 or row[-1] != size or (np.diff(row) < 0).any():
            return f"the rows {name} do not cut what they should"
    return None


def _layers_fault(corner_row: np.ndarray, rect: np.ndarray) -> str | None:
    corners, rect = np.diff(corner_row), rect.astype(np.int64)
    if not ((corners >= 3) & (corners <= layout.MAX_CORNERS)).all():
        return "a layer has fewer than 3 or more than 8 corners"
    if not (rect[:, :2] + rect[:, 2:] <= layout.PAGE_TEXELS).all() or (rect[:, :2] % layout.ALIGN_TEXELS).any():
        return "a layer reaches past its page"
    return None


def _within(ids: np.ndarray, size: int) -> bool:
    return bool(((ids >= 0) & (ids < size)).all())
