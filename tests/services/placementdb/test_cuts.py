"""Cutting a large layer into pages never costs more triangles than the placement counted."""

import numpy as np
from farfield.impostor.kernels import cut_triangles
from farfield.placementdb.layers import _pieces, halved
from hypothesis import given
from hypothesis import strategies as st


@given(st.integers(1, 4096), st.integers(1, 4096), st.integers(3, 8), st.integers(0, 2**32))
def test_a_cut_adds_no_more_triangles_than_counted(width, height, corners, seed):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, corners))
    ring = np.stack([(0.5 + 0.5 * np.cos(angle)) * width, (0.5 + 0.5 * np.sin(angle)) * height], -1)
    polygon = [(float(x), float(y)) for x, y in ring]
    pieces = [part for *_, piece in _pieces(polygon, width, height) for part in halved(piece)]
    assert all(3 <= len(p) <= 8 for p in pieces)
    assert sum(len(p) - 2 for p in pieces) <= corners - 2 + cut_triangles(width, height)


def test_a_layer_that_fits_a_page_is_not_cut():
    assert cut_triangles(1024, 1024) == cut_triangles(1, 1) == 0
    assert cut_triangles(1025, 1024) == 2
    assert cut_triangles(4096, 4096) == 30
