"""The view-space kd-tree: a regular binary subdivision of the view space on the scene's fixed grid.

Problem  Cut a list of boxes (the view space) into cells no larger than cell_m, on planes of one fixed grid, so that
         moving or adding a box elsewhere moves no plane here.
Method   A node is a set of boxes clipped to its region, and their bounding box. While that is longer than cell_m
         somewhere, cut its longest side at the coarsest grid plane (multiple of cell_m times a power of two, origin at 0)
         strictly inside it; a plane exists, because an open interval longer than cell_m holds a multiple of it.
         A node no longer than cell_m on any side is a leaf cell even where it straddles a plane: fewer slivers.
Half-open A point on a plane belongs to the high side, and a box of the view space holds its low faces but not its high
         ones, unless it is flat there: neighbouring boxes share no points, and a box that ends at a plane has no part
         beyond it. A point on a high face that no other box holds is still in the view space (`find_cell` looks it up
         just inside that box): the boxes as a whole are closed.
"""

from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class CellTree:
    """K nodes in preorder, L leaf cells numbered in that order. Boxes bound the view space inside the node (tight)."""

    axis: np.ndarray  # (K,) i8   0, 1, 2; -1 at a leaf
    plane: np.ndarray  # (K,) f64  points with x[axis] < plane go low, others high
    low: np.ndarray  # (K,) i32  node, -1 at a leaf
    high: np.ndarray  # (K,) i32  node, -1 at a leaf
    parent: np.ndarray  # (K,) i32  node, -1 at the root
    box: np.ndarray  # (K,2,3) f64
    start: np.ndarray  # (K,) i32  leaf cells of the node: [start, stop)
    stop: np.ndarray  # (K,) i32
    leaf: np.ndarray  # (L,) i32  node of each leaf cell

    @property
    def n_cells(self) -> int:
        return len(self.leaf)

    @property
    def cell_box(self) -> np.ndarray:
        """(L,2,3) f64"""
        return self.box[self.leaf]


def coarsest_plane(low: float, high: float, cell_m: float) -> float | None:
    """Return the multiple of cell_m * 2**k, k >= 0 as large as possible, strictly between low and high; None if none.

    Two multiples of the same coarsest step cannot lie inside: one between them would be coarser.
    """
    first = np.floor(low / cell_m) + 1
    last = np.ceil(high / cell_m) - 1
    if first > last:
        return None
    # The coarsest multiple in [first, last] clears as many low bits of `last` as keep it >= first.
    a, b = int(first), int(last)
    if a <= 0 <= b:
        return 0.0
    step = 1
    while (b // (2 * step)) * 2 * step >= a:
        step *= 2
    return float((b // step) * step * cell_m)


def cells_about(boxes: np.ndarray, cell_m: float) -> float:
    """Return about how many leaf cells `boxes` (B,2,3) f64 make, in no time: each box counts as at least one."""
    size = boxes[:, 1] / cell_m - boxes[:, 0] / cell_m
    return float(np.maximum(size, 1.0).prod(1).sum())


def subtrees(cells: CellTree, *, most: int) -> list[int]:
    """Return the nodes of the largest subtrees of at most `most` >= 1 leaf cells, in preorder: together they hold all."""
    small = cells.stop - cells.start <= most
    top = small & ((cells.parent < 0) | ~small[np.maximum(cells.parent, 0)])
    return [int(node) for node in np.flatnonzero(top)]


def build_cells(boxes: np.ndarray, cell_m: float) -> CellTree:
    """Return the tree over `boxes` (B,2,3) f64, relative to the scene's origin; cell_m > 0 metres.

    The last one is kept, read only: every shard of a stage asks for the same.
    """
    boxes = np.asarray(boxes, dtype=np.float64).reshape(-1, 2, 3)
    assert len(boxes) and cell_m > 0
    return _build(boxes.tobytes(), float(cell_m))


@lru_cache(maxsize=1)
def _build(data: bytes, cell_m: float) -> CellTree:
    boxes = np.frombuffer(data).reshape(-1, 2, 3)
    rows: list[list] = []
    bounds: list[np.ndarray] = []
    leaves: list[int] = []

    def grow(part: np.ndarray, parent: int) -> int:
        node = len(rows)
        tight = np.stack([part[:, 0].min(0), part[:, 1].max(0)])
        rows.append([-1, 0.0, -1, -1, parent, len(leaves), 0])
        bounds.append(tight)
        cut = None
        size = tight[1] - tight[0]
        for axis in sorted(range(3), key=lambda i: (-size[i], i)):
            if size[axis] > cell_m:
                plane = coarsest_plane(tight[0, axis], tight[1, axis], cell_m)
                if plane is not None:
                    cut = (axis, plane)
                    break
        if cut is None:
            leaves.append(node)
        else:
            axis, plane = cut
            low = part[part[:, 0, axis] < plane].copy()
            high = part[(part[:, 1, axis] > plane) | (part[:, 0, axis] >= plane)].copy()
            low[:, 1, axis] = np.minimum(low[:, 1, axis], plane)
            high[:, 0, axis] = np.maximum(high[:, 0, axis], plane)
            rows[node][0], rows[node][1] = axis, plane
            rows[node][2] = grow(low, node)
            rows[node][3] = grow(high, node)
        rows[node][6] = len(leaves)
        return node

    grow(boxes, -1)
    columns = list(zip(*rows, strict=True))
    i32 = lambda c: np.array(c, dtype=np.int32)  # noqa: E731
    tree = CellTree(
        axis=np.array(columns[0], dtype=np.int8), plane=np.array(columns[1], dtype=np.float64), low=i32(columns[2]),
        high=i32(columns[3]), parent=i32(columns[4]), box=np.array(bounds), start=i32(columns[5]), stop=i32(columns[6]),
        leaf=i32(leaves),
    )  # fmt: skip
    for field in fields(tree):
        getattr(tree, field.name).flags.writeable = False
    return tree


def find_cell(tree: CellTree, boxes: np.ndarray, point: np.ndarray) -> int:
    """Return the leaf cell of `point` (3,) f64, or -1 outside the view space `boxes` (B,2,3) f64 the tree was built from."""
    low, high = boxes[:, 0], boxes[:, 1]
    closed = np.flatnonzero(((low <= point) & (point <= high)).all(1))
    if not len(closed):
        return -1
    half_open = closed[((point < high[closed]) | (low[closed] == high[closed])).all(1)]
    if len(half_open):
        q = point
    else:
        b = closed[0]
        q = np.where((point == high[b]) & (low[b] < high[b]), np.nextafter(point, low[b]), point)
    node = 0
    while tree.axis[node] >= 0:
        node = tree.high[node] if q[tree.axis[node]] >= tree.plane[node] else tree.low[node]
    return int(tree.start[node])
