"""Lay blocks of texels out on pages: MaxRects, impostors that serve the same cells together.

Problem  Blocks of 1 to 1024 texels a side, few pages, and a viewer that holds the pages of the cells around it.
Method   Blocks come in an order of locality (who serves which cells). Take as many in a row as would fill a page, pack
         them largest first with MaxRects (best short side fit); what does not fit goes into the next page, before
         all others: left to its size, a small one would be last again and wander on from page to page.
         All is done in units of 8 texels, so that no texel of any stored mip level lies over two blocks.
After    J. Jylänki. A Thousand Ways to Pack the Bin. 2010 (the library `rectpack`).

Tried    Skyline (rectpack): four times as fast, no more pages on log-normal sizes; MaxRects takes 0.3 s a 1000 blocks,
         which is nothing beside the encoding of the pages.
"""

import numpy as np
import rectpack

from farfield.placementdb.layout import ALIGN_TEXELS, PAGE_TEXELS

_UNITS = PAGE_TEXELS // ALIGN_TEXELS


def pack_blocks(size: np.ndarray, order: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return page (B,) i64 and low corner (B,2) i64, texels, multiples of 8, of each block.

    size     (B,2) i64, width and height, 1..1024
    order    (B,) i64, a permutation: blocks that are used together stand together
    """
    size = np.asarray(size, dtype=np.int64).reshape(-1, 2)
    assert size.size == 0 or (size.min() >= 1 and size.max() <= PAGE_TEXELS)
    assert np.array_equal(np.sort(order), np.arange(len(size)))
    units = -(-size // ALIGN_TEXELS)
    area = units[:, 0] * units[:, 1]
    page, at = np.full(len(size), -1, dtype=np.int64), np.zeros((len(size), 2), dtype=np.int64)
    rest, n_pages = [int(b) for b in order], 0
    left_over: set[int] = set()
    while rest:
        filled = np.cumsum(area[rest])
        n_taken = max(1, int(np.searchsorted(filled, _UNITS * _UNITS, side="right")))
        taken = sorted(rest[:n_taken], key=lambda b: (b not in left_over, -max(units[b]), -min(units[b]), b))
        packer = rectpack.newPacker(
            mode=rectpack.PackingMode.Offline, bin_algo=rectpack.PackingBin.BFF, pack_algo=rectpack.MaxRectsBssf,
            sort_algo=rectpack.SORT_NONE, rotation=False,
        )  # fmt: skip
        for b in taken:
            packer.add_rect(int(units[b, 0]), int(units[b, 1]), rid=b)
        packer.add_bin(_UNITS, _UNITS)
        packer.pack()
        for _, x, y, _, _, b in packer.rect_list():
            page[b], at[b] = n_pages, (x * ALIGN_TEXELS, y * ALIGN_TEXELS)
        n_pages += 1
        left_over = {b for b in taken if page[b] < 0}
        rest = [b for b in rest if page[b] < 0]
    return page, at
