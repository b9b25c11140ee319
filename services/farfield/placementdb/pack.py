"""Lay blocks of texels out on pages: MaxRects, impostors that the same cells show together.

Problem  Blocks of 1 to 1024 texels a side, few pages, and a viewer that holds the pages of the cells around it. An
         impostor is shown in some 20 cells, one in ten in more than 60: no order of the cells puts all of them side by side.
Method   Pages are grown one at a time. A page begins with what did not fit into the one before, or with the impostor
         that fewest cells show; then it takes, again and again, the impostor with the least share of cells that do not
         touch the page already, and counts that impostor's cells as touching it. It is closed at FILLED of its area.
         Then its blocks are packed largest first with MaxRects (best short side fit); with the slack hardly one is left.
         All is done in units of 8 texels, so that no texel of any stored mip level lies over two blocks.
After    J. Jylänki. A Thousand Ways to Pack the Bin. 2010.

Tried    Pages that a cell touches in the demo city, mean, most (520 cells, 6,881 impostors; 3.2 full pages hold what a cell
         shows): by first and last cell, pages as full as can be 22.3, 35 (38 pages); as it is 10.4, 15 (39 pages). Tiles
         shared by many impostors beside one of these, 178 of 62,335 blocks: 19.7, 29. Ties to the first, not to that of most
         cells, and weights of it: 10.5 to 14.7. 40 s of annealed swaps win another 10 %.
         The library rectpack, which the tests compare with, places the same blocks at the same corners in 47 s, not 0.4.
"""

import numpy as np

from farfield.placementdb.kernels import max_rects
from farfield.placementdb.layout import ALIGN_TEXELS, PAGE_TEXELS

_UNITS = PAGE_TEXELS // ALIGN_TEXELS
TIE = 1e-6  # a cell: of those that bring no new cell the one of most cells, which few other pages can take
FILLED = 0.98  # of a page's area, before it is packed
CLOSED = 0.95  # from here on the first impostor that is too large closes the page: a small one from afar fills none


def pack_blocks(
    size: np.ndarray, owner: np.ndarray, row: np.ndarray, cell: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return page (B,) i64 and low corner (B,2) i64, texels, multiples of 8, of each block.

    size       (B,2) i64, width and height, 1..1024
    owner      (B,) i64, the impostor of each
    row, cell  (I+1,), (E,) i64: the cells from 0 on that show impostor i, each once
    """
    size = np.asarray(size, dtype=np.int64).reshape(-1, 2)
    assert size.size == 0 or (size.min() >= 1 and size.max() <= PAGE_TEXELS)
    units = -(-size // ALIGN_TEXELS)
    area = units[:, 0] * units[:, 1]
    of_owner = np.argsort(owner, kind="stable")
    block_row = np.searchsorted(owner[of_owner], np.arange(len(row)))
    groups = _Groups(np.bincount(owner, area, len(row) - 1).astype(np.int64), row, cell)
    page, at = np.full(len(size), -1, dtype=np.int64), np.zeros((len(size), 2), dtype=np.int64)
    rest: list[int] = []
    n_pages = 0
    while rest or groups.left.any():
        begun = list(dict.fromkeys(int(owner[b]) for b in rest))
        for i in groups.grow(begun, int(area[rest].sum())):
            rest.extend(int(b) for b in of_owner[block_row[i] : block_row[i + 1]])
        tried = np.array(rest, dtype=np.int64)
        tried = tried[np.lexsort((-units[tried].min(1), -units[tried].max(1)))]  # stable
        corner = max_rects(units[tried], _UNITS)
        placed = corner[:, 0] >= 0
        page[tried[placed]], at[tried[placed]] = n_pages, corner[placed] * ALIGN_TEXELS
        n_pages += 1
        rest = [b for b in rest if page[b] < 0]
    return page, at


class _Groups:
    """Impostors that are on no page yet, and which of them a page should take next."""

    def __init__(self, area: np.ndarray, row: np.ndarray, cell: np.ndarray) -> None:
        self.area, self.row, self.cell = area, row, cell
        self.left = area > 0
        self.n_cells = np.maximum(np.diff(row), 1)
        n = int(cell.max(initial=-1)) + 1
        by_cell = np.argsort(cell, kind="stable")
        self.shown = np.repeat(np.arange(len(area)), np.diff(row))[by_cell]  # impostors, cell by cell
        self.shown_row = np.searchsorted(cell[by_cell], np.arange(n + 1))

    def grow(self, begun: list[int], used: int) -> list[int]:
        """Return the impostors to add to a page that holds `used` units of the impostors `begun`, in order."""
        room = int(FILLED * _UNITS * _UNITS) - used
        fresh = np.ones(len(self.shown_row) - 1, dtype=bool)
        new = np.diff(self.row)
        share = np.where(self.left, new / self.n_cells - TIE * self.n_cells, np.inf)
        for i in begun:
            self._touch(i, fresh, new, share)
        taken: list[int] = []
        if not begun and self.left.any():
            taken.append(int(np.where(self.left, self.n_cells, np.iinfo(np.int64).max).argmin()))
        while True:
            for i in taken[-1:]:
                room -= int(self.area[i])
                self.left[i], share[i] = False, np.inf
                self._touch(i, fresh, new, share)
            best = int(share.argmin())
            while share[best] < np.inf and self.area[best] > room > (1 - CLOSED) * _UNITS * _UNITS:
                share[self.area > room] = np.inf
                best = int(share.argmin())
            if share[best] == np.inf or self.area[best] > room:
                return taken
            taken.append(best)

    def _touch(self, impostor: int, fresh: np.ndarray, new: np.ndarray, share: np.ndarray) -> None:
        """Count the impostor's cells as touching the page."""
        for c in self.cell[self.row[impostor] : self.row[impostor + 1]]:
            if fresh[c]:
                fresh[c] = False
                ids = self.shown[self.shown_row[c] : self.shown_row[c + 1]]
                new[ids] -= 1
                open_ids = ids[share[ids] < np.inf]
                share[open_ids] = new[open_ids] / self.n_cells[open_ids] - TIE * self.n_cells[open_ids]
