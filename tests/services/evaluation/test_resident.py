"""The peak of resident bytes: what lookups of every view of a cell name is what is counted, and no cell holds more."""

import numpy as np
import pytest
from farfield.evaluation.resident import pages_of, peak_resident
from farfield.placementdb.read import Placement

GOLDEN = ("placementdb", "placementdb-visible", "placementdb-detail")


def _held(placement: Placement, cell: int) -> tuple[int, int, int]:
    """Look up every interval of the cell, and add up what its impostors and its objects are drawn from."""
    manifest, index = placement.manifest, placement.index
    n = len(manifest["interval_edges"]) - 1
    k = placement.chunk_of(cell)
    chunk, pages = 0, set()
    if k is not None:
        columns, entry = placement.chunk(k), manifest["chunks"][k]
        chunk = entry.get("expanded", entry["bytes"])
        local = cell - entry["cells"][0]
        known = columns["view_interval"][columns["cell_view"][local] : columns["cell_view"][local + 1]]
        assert set(known.tolist()) <= set(range(6 * n * n))
        for v in range(columns["cell_view"][local], columns["cell_view"][local + 1]):
            a, b = columns["list_row"][columns["view_list"][v] :][:2]
            for i in columns["impostor_id"][columns["list_impostor"][a:b]].tolist():
                pages |= {layer.page for layer in placement.impostors[i].layers}
    page_bytes = sum(4 * level["size"] ** 2 for level in manifest["page"]["levels"])
    parts = 0
    if manifest["geometry"] is not None:
        geometry = placement.geometry()
        columns = geometry["columns"]
        seen = np.flatnonzero(placement.seen_from(cell)).tolist()
        levels = placement.levels_in(cell)
        models = {int(columns["mesh_model"][columns["object_mesh"][o]]) + int(levels[o]) for o in seen}
        used = {int(columns["model_page"][m]) for m in models}
        parts = sum(geometry["pages"][p]["memory"] for p in used if p >= 0)
        assert not geometry["textures"], "this adds up pages alone"
    assert set(pages_of(placement, cell).tolist()) == pages
    assert len(index["object_box"]) >= 1
    return chunk, page_bytes * len(pages), parts


@pytest.mark.parametrize("name", GOLDEN)
def test_no_cell_holds_more_than_the_peak_and_one_holds_it(name: str, request: pytest.FixtureRequest) -> None:
    placement = Placement.open(request.config.rootpath / "tests" / "golden" / name)
    told = peak_resident(placement)
    held = [_held(placement, cell) for cell in range(placement.manifest["counts"]["cells"])]
    sums = [sum(parts) for parts in held]
    assert told["bytes"] == max(sums) and told["cell"] == sums.index(max(sums))
    assert (told["chunk_bytes"], told["page_bytes"], told["level_bytes"]) == held[told["cell"]]
    assert told["median_bytes"] == sorted(sums)[len(sums) // 2]
    assert told["bytes"] <= told["all_bytes"]
