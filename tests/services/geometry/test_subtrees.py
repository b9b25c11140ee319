"""Subtrees that shards and chunks are cut by, against a walk down the tree."""

import numpy as np
import pytest
from farfield.geometry.cells import build_cells, subtrees


@pytest.mark.parametrize("most", [1, 3, 8, 64, 10**6])
def test_subtrees_are_those_of_a_walk_and_hold_every_cell_once(most):
    rng = np.random.default_rng(most)
    for _ in range(10):
        low = rng.uniform(-200, 200, (int(rng.integers(1, 9)), 3))
        cells = build_cells(np.stack([low, low + rng.uniform(0, 120, low.shape)], 1), 16.0)
        expected, stack = [], [0]
        while stack:
            node = stack.pop()
            if cells.stop[node] - cells.start[node] <= most:
                expected.append(node)
            else:
                stack += [int(cells.high[node]), int(cells.low[node])]
        found = subtrees(cells, most=most)
        assert found == expected
        assert [c for n in found for c in range(cells.start[n], cells.stop[n])] == list(range(cells.n_cells))
