"""What the optimiser tells: tiles hold every cell once, counts are those of the views, telling changes nothing."""

from dataclasses import replace

import numpy as np
import pytest
from farfield.geometry.cells import build_cells
from farfield.placement.greedy import place
from farfield.placement.live import Live, tiles
from farfield.settings import Settings

from .instances import random_instance, same_refit


@pytest.mark.parametrize("most", [1, 7, 40, 4096])
def test_tiles_hold_every_cell_once_and_are_few(most):
    cells = build_cells(np.array([[[0.0, 1.5, 0.0], [90.0, 1.8, 60.0]], [[100.0, 1.5, 0.0], [130.0, 1.8, 12.0]]]), 5.0)
    found = tiles(cells, most)
    assert len(found) <= most
    held = np.concatenate([np.arange(cells.start[n], cells.stop[n]) for n in found])
    assert held.tolist() == list(range(cells.n_cells))
    if most >= cells.n_cells:
        assert len(found) == cells.n_cells


@pytest.mark.parametrize("seed", range(6))
def test_told_counts_are_those_of_the_views_and_telling_changes_nothing(seed, monkeypatch):
    monkeypatch.setattr("farfield.placement.choose.SECONDS_BETWEEN_REPORTS", 0.0)
    monkeypatch.setattr("farfield.placement.choose.TOPS_A_SLICE", 1)
    x = random_instance(seed)
    worst = np.arange(10, 10 + x.cells.n_cells)
    x = replace(x, views=replace(x.views, cell_cost=worst))
    told = []
    origin = np.array([100.0, 0.0, -50.0])
    live = Live(told.append, x.cells, x.views, x.model, origin=origin)
    live.map()
    seen = []

    def progress(share, counters):
        seen.append({k: v.copy() if isinstance(v, np.ndarray) else v for k, v in counters.items()})
        live.progress(share, counters)

    def placed(**more):
        return place(
            None, x.hierarchy, x.model, x.cells, x.views, x.candidates, settings=Settings(), refit=same_refit(x), **more
        )

    a, b = placed(progress=progress), placed()
    for name in a.__slots__:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    of_tile = [
        [v for v in range(len(x.views.cell)) if x.cells.start[n] <= x.views.cell[v] < x.cells.stop[n]]
        for n in tiles(x.cells)
    ]
    map_told, words = told[0]["map"], told[1:]
    assert map_told["views"] == [len(views) for views in of_tile]
    assert map_told["cost"] == [
        max(worst[x.cells.start[n] : x.cells.stop[n]]) + x.model.per_frame for n in tiles(x.cells)
    ]
    assert map_told["budget"] == x.model.budget
    low = np.reshape(map_told["boxes"], (-1, 4))[:, :2]
    np.testing.assert_allclose(low, (x.cells.box[tiles(x.cells)] + origin)[:, 0, ::2], atol=0.006)
    assert len(words) == len(seen)
    for word, counters in zip(words, seen, strict=True):
        if "over" not in counters:
            assert "tiles" not in word
            continue
        unsolved = (counters["over"] > 0) | a.hopeless
        assert word["tiles"] == [int(unsolved[views].sum()) for views in of_tile]
        assert word["unsolved"] == sum(word["tiles"])
    last = next(word for word in reversed(words) if "tiles" in word)
    assert last["unsolved"] == a.hopeless.sum() == last["hopeless"]
    assert words[-1]["bytes"] == a.bytes.sum()
