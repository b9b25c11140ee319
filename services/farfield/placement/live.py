"""What the optimiser tells while it runs: how much it has chosen, and where views are still over the budget.

Problem  Somebody watches the view space from above while impostors are chosen. A level may have 10^5 cells, a picture has
         room for some thousands, and what is told goes through a database.
Method   Tiles instead of cells: the largest subtrees of the view-space tree of at most so many leaf cells that no more
         than MOST_TILES are left; each counts the problem views of its cells that are unsolved, which is above their
         target, or hopeless. Whoever passes that on need send only the counts that have changed.
         Telling never shapes a result: counts go out, nothing comes back.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from farfield.geometry.cells import CellTree, subtrees
from farfield.rendertime.model import CostModel
from farfield.viewspace.model import ProblemViews

Tell = Callable[[dict[str, Any]], None]
MOST_TILES = 4096
CENTIMETRES = 2  # digits of a tile's corners


class Live:
    """Turns what `greedy.place` reports (`progress` is its callback) into facts that JSON holds."""

    def __init__(
        self, tell: Tell, cells: CellTree, views: ProblemViews, model: CostModel, *, origin: np.ndarray,
        views_of: slice = slice(None),
    ) -> None:  # fmt: skip
        """origin (3,) f64: scene metres; views_of: the problem views that are being solved, all by default."""
        self._tell, self._cells, self._model, self._origin = tell, cells, model, origin
        self._nodes = tiles(cells)
        self._tile = np.repeat(np.arange(len(self._nodes)), cells.stop[self._nodes] - cells.start[self._nodes])
        self._cost = views.cell_cost
        self._views = self._tile[views.cell[views_of]]
        self._hopeless = np.zeros(len(self._views), dtype=bool)

    def map(self) -> None:
        """Tell what the view space is from above, and the worst predicted cost of each tile, all as geometry."""
        box = self._cells.box[self._nodes] + self._origin
        corners = np.round(np.concatenate([box[:, 0, ::2], box[:, 1, ::2]], axis=1), CENTIMETRES)
        worst = np.zeros(len(self._nodes), np.int64)
        np.maximum.at(worst, self._tile, self._cost)
        self._tell({
            "map": {
                "boxes": corners.ravel().tolist(), "cost": (worst + self._model.per_frame).tolist(),
                "budget": self._model.budget, "unit": self._model.unit, "views": self._counts(np.ones(len(self._views), bool)),
            }
        })  # fmt: skip

    def progress(self, share: float, counters: dict[str, Any]) -> None:
        """Tell how far the optimiser is; see `greedy.place` for what comes in."""
        told: dict[str, Any] = {"share": round(share, 4)}
        told |= {
            key: int(counters[key]) for key in ("bytes", "choices", "impostors", "smallest_budget") if key in counters
        }
        if "hopeless" in counters:
            self._hopeless = counters["hopeless"]
        if "over" in counters:
            unsolved = (counters["over"] > 0) | self._hopeless
            told |= {
                "unsolved": int(unsolved.sum()),
                "hopeless": int(self._hopeless.sum()),
                "tiles": self._counts(unsolved),
            }
        self._tell(told)

    def _counts(self, which: np.ndarray) -> list[int]:
        return list(np.bincount(self._views[which], minlength=len(self._nodes)).tolist())


def tiles(cells: CellTree, most: int = MOST_TILES) -> list[int]:
    """Return at most `most` nodes, in preorder, that together hold all leaf cells: small ones, as equal as halving makes them."""
    size = 1
    while len(found := subtrees(cells, most=size)) > most:
        size *= 2
    return found
