"""What cropping, sharing and paging save in a finished placement: `python -m benchmarks.stored DIR` prints one line of JSON.

full      every layer as the whole texel grid of its impostor, in the measure that a placement minimises
cropped   the same measure of what was baked: rectangles around what a layer holds
stored    texels in the pages, equal tiles once, and the overheads of `cropped`
pages     how many pages the views of a cell touch, and how few could hold the texels shown there
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from farfield.impostor.plan import plan_layers
from farfield.impostor.weight import TEXEL_BYTES, impostor_bytes
from farfield.placementdb.read import Placement
from farfield.settings import from_mapping


def stored_bytes(placement: Placement) -> dict[str, int]:
    """Return `full`, `cropped` and `stored` bytes."""
    index, manifest = placement.index, placement.manifest
    settings = from_mapping({"camera": manifest["camera"], "quality": manifest["quality"]})
    full = 0
    for i, cluster in enumerate(index["impostor_cluster"]):
        kind, cell = int(index["impostor_kind"][i]), index["impostor_view_cell"][i]
        plan = plan_layers(kind, cell, index["cluster_box"][cluster], settings=settings)
        full += impostor_bytes(int(plan.resolution.astype(np.int64).prod()) * len(plan.plane), len(plan.plane))
    every, once = 0, set()
    for chunk in _chunks(placement):
        fresh = np.isin(chunk["impostor_id"], np.flatnonzero(index["impostor_chunk"] == chunk["number"]))
        for k in np.flatnonzero(fresh):
            for row in range(*chunk["impostor_layer"][k : k + 2]):
                rect = tuple(int(v) for v in chunk["layer_rect"][row])
                every += rect[2] * rect[3]
                once.add((int(chunk["layer_page"][row]), *rect))
    cropped = int(index["impostor_bytes"].sum())
    once_texels = sum(rect[3] * rect[4] for rect in once)
    return {"full": full, "cropped": cropped, "stored": cropped - TEXEL_BYTES * (every - once_texels)}


def pages_of_cells(placement: Placement) -> tuple[list[int], list[int]]:
    """Return for every cell that shows impostors how many pages its views touch, and the least that could hold them."""
    side = int(placement.manifest["page"]["size"])
    touched, least = [], []
    for chunk in _chunks(placement):
        area = chunk["layer_rect"][:, 2:].astype(np.int64).prod(1)
        first, stop = placement.manifest["chunks"][chunk["number"]]["cells"]
        for c in range(first, stop):
            views = range(*chunk["cell_view"][c - first :][:2])
            lists = {int(chunk["view_list"][v]) for v in views}
            shown = {int(m) for s in lists for m in chunk["list_impostor"][slice(*chunk["list_row"][s : s + 2])]}
            rows = [r for m in shown for r in range(*chunk["impostor_layer"][m : m + 2])]
            if rows:
                touched.append(len(set(chunk["layer_page"][rows].tolist())))
                least.append(-(-int(area[rows].sum()) // side**2))
    return touched, least


def _chunks(placement: Placement) -> Iterator[dict]:
    for k in range(len(placement.manifest["chunks"])):
        yield {**placement.chunk(k), "number": k}


def main(folder: str) -> None:
    placement = Placement.open(Path(folder) / "placement")
    touched, least = pages_of_cells(placement)
    found = stored_bytes(placement)
    print(json.dumps({
        "impostors": len(placement.index["impostor_cluster"]), **found,
        "full_over_stored": round(found["full"] / found["stored"], 2), "pages": len(placement.manifest["pages"]),
        "cells": len(touched), "pages_a_cell": round(float(np.mean(touched)), 2), "most_pages_a_cell": max(touched),
        "least_pages_a_cell": round(float(np.mean(least)), 2),
    }))  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
