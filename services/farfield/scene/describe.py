"""Scene -> one JSON document: what `farfield inspect --json` prints and the dashboard shows before a job starts."""

import io
import math
from typing import Any

from PIL import Image

from farfield.geometry.cells import build_cells
from farfield.scene.derive import Suggestion
from farfield.scene.model import BLEND, MASK, Scene

# Of one core, measured on seven scenes of 18 to 4,800 objects: a view is bounded against every object in the worst case.
VIEW_S, VIEW_OBJECT_S = 5e-6, 2.5e-8
_MODES = {BLEND: "blend", MASK: "mask"}


def describe(scene: Scene, suggestion: Suggestion) -> dict[str, Any]:
    """Return plain JSON values; every box is two corners in scene metres (y up), ids are those of the placement."""
    boxes = scene.object_box + scene.origin_m
    return {
        "objects": [
            {"id": i, "name": name, "box": box, "triangles": triangles, "calls": calls, "replaceable": replaceable}
            for i, (name, box, triangles, calls, replaceable) in enumerate(
                zip(
                    scene.object_name,
                    boxes.tolist(),
                    scene.object_triangles.tolist(),
                    scene.object_calls.tolist(),
                    scene.object_replaceable.tolist(),
                )
            )
        ],
        "triangles": int(scene.object_triangles.sum()),
        "calls": int(scene.object_calls.sum()),
        "meshes": len(scene.mesh_primitive) - 1,
        "vertices": len(scene.position),
        "bounds": [boxes[:, 0].min(0).tolist(), boxes[:, 1].max(0).tolist()],
        "materials": [
            {
                "name": name,
                "base_color": scene.material_base_color[k].astype(float).tolist(),
                "alpha": _MODES.get(int(scene.material_alpha_mode[k]), "opaque"),
                "texture": int(scene.material_texture[k]) if scene.material_texture[k] >= 0 else None,
            }
            for k, name in enumerate(scene.material_name)
        ],
        "textures": [_texture(scene, x) for x in range(len(scene.texture_byte) - 1)],
        "dropped_triangles": scene.dropped_triangles,
        "warnings": list(scene.warnings),
        "suggested": {
            "view_space": {
                "boxes": [[list(low), list(high)] for low, high in suggestion.boxes],
                "cell_m": suggestion.cell_m,
                "interval_deg": suggestion.interval_deg,
            },
            "work": _work(scene, suggestion),
            "budgets": list(suggestion.budgets),
            "why": {
                "view_space.boxes": suggestion.boxes_why,
                "view_space.cell_m": suggestion.cell_why,
                "view_space.interval_deg": suggestion.interval_why,
                "budgets": suggestion.budgets_why,
            },
        },
    }


def _texture(scene: Scene, x: int) -> dict[str, int]:
    first, end = scene.texture_byte[x : x + 2].tolist()
    with Image.open(io.BytesIO(scene.texture_data[first:end].tobytes())) as image:  # reads no more than the header
        return {"bytes": end - first, "width": image.width, "height": image.height}


def summary(document: dict[str, Any]) -> dict[str, Any]:
    """Return what `describe` says with counts in place of the long lists, and the sums over its textures."""
    textures = document["textures"]
    return {
        **document, **{key: len(document[key]) for key in ("objects", "materials", "textures")},
        "texture_bytes": sum(t["bytes"] for t in textures),
        "texture_pixels": sum(t["width"] * t["height"] for t in textures),
        "replaceable": sum(o["replaceable"] for o in document["objects"]),
    }  # fmt: skip


def _work(scene: Scene, suggestion: Suggestion) -> dict[str, Any]:
    """Return how many cells and views there are, and at most how many seconds of one core it takes to bound them."""
    cells = build_cells(scene.view_boxes, scene.cell_m).n_cells
    directions = 6 * round(90 / suggestion.interval_deg) ** 2
    seconds = cells * directions * (VIEW_S + VIEW_OBJECT_S * scene.n_objects)
    return {
        "cells": cells, "directions": directions, "views": cells * directions,
        "seconds": round(seconds, 1 - math.floor(math.log10(max(seconds, 0.1)))),
    }  # fmt: skip
