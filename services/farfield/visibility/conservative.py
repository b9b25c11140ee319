"""Drop objects that no camera of a cell can see, and only those.

Problem  Given the pairs (cell, object) that a ray has seen, which of the others can be proved hidden: every segment from
         any point of the cell to any point of the object meets a triangle that is drawn there? What is not proved is
         kept. Errs by keeping; never drops a visible object of the level as it is. Where what hides it is drawn as a
         coarser level of detail or as an impostor, an object just behind its edge can show by up to the pixel error.
Columns  A bundle of segments from box P to box Q at time t fills the box (1 - t) P + t Q. If that lies in opaque columns
         (`columns.py`), each segment has a point m inside a solid S or under the ground: occluders are fused, and no
         slit is stepped over, however thin. One good t is enough; the line between the middles is walked for it.
         With p the camera, q the target, both outside S, the segment crosses S twice, its missing cap at most once.
         It also meets S before m where S is closed, where the cap is under the ground and p above it, or where p and m
         lie above a floor. Else S does not count for objects that may touch it (their boxes meet).
Inside   A camera inside S sees what touches S: objects whose boxes meet S are kept for cells whose box does. Others are
         behind S, unless seen through its missing cap: where that is not under the ground, S does not count for
         targets that reach below it. A solid with sides that are not drawn never counts for cells that it meets.
Patches  `patches.py`: thin walls, for interiors.
Order    A cell is looked at whole, then in parts, and a part only looks at what the whole could not hide. Targets are
         the objects' parts on tiles, in Morton order under a tree of boxes. A few small parts go first: what they cannot
         hide is kept and costs nothing more (San Francisco 1.7 -> 0.9 s a cell).
Tried    Down the view-space tree, so that a cell looks only at what its parent could not hide: the same sets, 0.46 instead
         of 0.51 and 0.40 instead of 0.33 s a cell in two parts of Munich. Nothing gained: a parent hides little.
Bounds   (1 - t) P + t Q and its squares round by less than 32 u of the largest coordinate; the bundle is widened, raised
         and lowered by 128 u of it, which also makes m lie strictly inside. Boxes of solids, cells and objects are
         compared exactly. Points of a cell under the ground are no camera points (`columns.py` says what is ground).
"""

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from farfield.geometry.cells import CellTree
from farfield.scene.model import Scene
from farfield.visibility import conservative_kernels as kernels
from farfield.visibility import patch_kernels
from farfield.visibility.columns import Columns, build_columns
from farfield.visibility.patches import Patches, find_patches
from farfield.visibility.solids import Placed, Solids, find_solids, place_triangles

TILES_A_CELL = 4
PARTS = (1, 3, 2)  # a cell is looked at whole, then in 3 x 3 parts, each of these in 2 x 2
_SLACK = 2.0**-46


@dataclass(frozen=True, slots=True, kw_only=True)
class Targets:
    """I parts of objects over tiles, in Morton order of their tiles; solids that objects touch."""

    object: np.ndarray  # (I,) i32
    box: np.ndarray  # (I,2,3) f64
    blocks: np.ndarray  # (bx,bz) f32  highest opaque point of each block of squares
    touch_row: np.ndarray  # (S+1,) i64  solid s may touch objects touch[row[s]:row[s+1]]
    touch: np.ndarray  # (E,) i32
    own: np.ndarray  # (2,N,4) f64  rectangle (x, z, x, z) of the open solids that an object touches; 1: over ground
    own_cap: np.ndarray  # (2,N) f64  the highest of their caps; inf where that says nothing, -inf where there is none


@dataclass(frozen=True, slots=True, kw_only=True)
class Occluders:
    """What hides something in a scene."""

    solids: Solids
    columns: Columns | None
    targets: Targets | None
    patches: Patches | None
    reasons: tuple[str, ...]  # what is used and what is not, and why


def find_occluders(scene: Scene, cells: CellTree) -> Occluders:
    """Return what can hide objects of a scene: a few seconds for a city."""
    placed = place_triangles(scene)
    solids = find_solids(placed)
    columns = build_columns(scene, cells, solids)
    reasons = []
    height = float(np.median(np.diff(cells.cell_box[:, :, 1], axis=1)))
    if columns is not None:
        reasons.append(columns.ground_reason)
        # A part of a cell is a twelfth to a sixth of it wide, its sights spread over its height.
        useful = columns.top[3] + columns.bottom_on_ground[3] >= height / 2
        if useful.mean() < 0.001:
            reasons.append("columns skipped: nothing solid is a quarter of a cell wide and half a cell high")
            columns = None
    else:
        reasons.append("columns skipped: nothing solid fills a square")
    patches = find_patches(placed, cell_m=scene.cell_m)
    if patches is None:
        reasons.append("patches skipped: no opaque surface is half as large as a cell")
    return Occluders(
        solids=solids, columns=columns, targets=None if columns is None else _targets(scene, placed, solids, columns),
        patches=patches, reasons=tuple(reasons),
    )  # fmt: skip


def prove(scene: Scene, cells: CellTree, node: int, seen: np.ndarray) -> np.ndarray:
    """Return keep (n,N) b1: all but the objects proved hidden from the n leaf cells under `node` of the tree.

    seen  (n,N) b1  pairs with a witness: kept and not looked at
    """
    assert seen.shape == (cells.stop[node] - cells.start[node], scene.n_objects)
    return _Proof(scene, cells, _cached_occluders(scene, cells), node, seen).keep


def reasons(scene: Scene, cells: CellTree) -> tuple[str, ...]:
    """Return what `prove` takes to hide something in this scene and what not, and why, in sentences."""
    return _cached_occluders(scene, cells).reasons


_cache: dict[str, Occluders] = {}


def _cached_occluders(scene: Scene, cells: CellTree) -> Occluders:
    """The shards of a stage that one process runs share them."""
    digest = hashlib.sha256()
    arrays: tuple[Any, ...] = (
        scene.position, scene.index, scene.primitive_triangle, scene.primitive_vertex, scene.primitive_material,
        scene.mesh_primitive, scene.object_mesh, scene.object_matrix, scene.material_alpha_mode,
        scene.material_double_sided, cells.cell_box, np.float64(scene.cell_m),
    )  # fmt: skip
    for array in arrays:
        digest.update(str(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    key = digest.hexdigest()
    if key not in _cache:
        _cache.clear()
        _cache[key] = find_occluders(scene, cells)
    return _cache[key]


def _targets(scene: Scene, placed: Placed, solids: Solids, columns: Columns) -> Targets:
    size = scene.cell_m / TILES_A_CELL
    low = placed.corner[:, :, [0, 2]].reshape(-1, 2)
    first = np.floor(low.min(0) / size)
    nx, nz = (np.floor(low.max(0) / size) - first + 1).astype(np.int64).tolist()
    x0, z0 = (first * size).tolist()
    corner = placed.corner.reshape(-1, 3)
    index = np.arange(len(corner), dtype=np.int32).reshape(-1, 3)
    raster = (x0, z0, size, size * 2.0**-10, nx, nz)
    empty = np.zeros(0, np.int64), np.zeros((0, 2, 3))
    n = kernels.target_parts(corner, index, placed.object, *raster, *empty, False)
    tile, box = np.empty(n, np.int64), np.empty((n, 2, 3))
    kernels.target_parts(corner, index, placed.object, *raster, tile, box, True)
    order = np.argsort(tile, kind="stable")
    tile, box = tile[order], box[order]
    start = np.flatnonzero(np.concatenate([[True], tile[1:] != tile[:-1]]))
    tile = tile[start]
    box = np.stack([np.minimum.reduceat(box[:, 0], start), np.maximum.reduceat(box[:, 1], start)], 1)
    owner, square = (tile // (nx * nz)).astype(np.int32), tile % (nx * nz)
    order = np.lexsort((owner, _morton(square // nz, square % nz)))
    blocks = np.full([-(-n // kernels.BLOCK) for n in columns.top.shape[1:]], -np.inf, dtype=np.float32)
    kernels.highest_blocks(columns.top[0], columns.under[0], blocks)
    touch_row, touch, own, own_cap = _touching(scene, solids, columns)
    return Targets(
        object=owner[order], box=np.ascontiguousarray(box[order]), blocks=blocks, touch_row=touch_row, touch=touch,
        own=own, own_cap=own_cap,
    )  # fmt: skip


def _touching(scene: Scene, solids: Solids, columns: Columns) -> tuple[np.ndarray, ...]:
    """Which objects may touch each solid, and for each object where the open ones among its solids stand."""
    found = [np.flatnonzero(_meet(scene.object_box, box)).astype(np.int32) for box in solids.box]
    row = np.concatenate([[0], np.cumsum([len(f) for f in found], dtype=np.int64)])
    own = np.empty((2, scene.n_objects, 4))
    own[:, :, :2], own[:, :, 2:] = np.inf, -np.inf
    own_cap = np.full((2, scene.n_objects), -np.inf)
    for s, objects in enumerate(found):
        if np.isnan(solids.cap_y[s]):
            continue
        cap = solids.cap_y[s] if solids.side[s] == 1 else np.inf
        for over_ground in range(1 if columns.buried[s] else 2):
            own[over_ground, objects, :2] = np.minimum(own[over_ground, objects, :2], solids.box[s, 0, [0, 2]])
            own[over_ground, objects, 2:] = np.maximum(own[over_ground, objects, 2:], solids.box[s, 1, [0, 2]])
            own_cap[over_ground, objects] = np.maximum(own_cap[over_ground, objects], cap)
    return row, np.concatenate([np.zeros(0, np.int32), *found]), own, own_cap


def _meet(boxes: np.ndarray, box: np.ndarray) -> np.ndarray:
    return np.asarray(((boxes[:, 0] <= box[1]) & (boxes[:, 1] >= box[0])).all(1))


def _morton(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    def spread(v: np.ndarray) -> np.ndarray:
        v = v.astype(np.int64)
        for shift, mask in ((16, 0x0000FFFF0000FFFF), (8, 0x00FF00FF00FF00FF), (4, 0x0F0F0F0F0F0F0F0F),
                            (2, 0x3333333333333333), (1, 0x5555555555555555)):  # fmt: skip
            v = (v | (v << shift)) & mask
        return v

    return np.asarray(spread(x) << 1 | spread(z))


def _part(box: np.ndarray, n: int, i: int, k: int) -> np.ndarray:
    """Part (i, k) of n by n of a box (2,3); neighbours share their sides exactly, and all together are the box."""
    low, size = box[0], box[1] - box[0]
    part = box.copy()
    for axis, j in ((0, i), (2, k)):
        part[0, axis] = low[axis] + size[axis] * (j / n)
        part[1, axis] = box[1, axis] if j == n - 1 else low[axis] + size[axis] * ((j + 1) / n)
    return part


class _Proof:
    """One subtree's proof: what is kept so far."""

    def __init__(self, scene: Scene, cells: CellTree, occluders: Occluders, node: int, seen: np.ndarray) -> None:
        self.scene, self.cells, self.occluders = scene, cells, occluders
        self.tests = 0
        reach = max(np.abs(scene.object_box).max(initial=0.0), np.abs(cells.box[node]).max())
        self.slack = float(_SLACK * reach)
        self.open = ~seen
        leaves = range(int(cells.start[node]), int(cells.stop[node]))
        if occluders.columns is not None and occluders.targets is not None:
            self.columns, self.targets = occluders.columns, occluders.targets
            for cell in leaves:
                self._by_columns(cells.cell_box[cell], self.open[cell - leaves.start])
        if occluders.patches is not None:
            for cell in leaves:
                self._by_patches(cells.cell_box[cell], self.open[cell - leaves.start])
        self.keep = seen | self.open

    def _by_columns(self, box: np.ndarray, open_: np.ndarray) -> None:
        """Clear open_ (N,) b1 of what columns hide from a cell's box."""
        kept = ~open_
        kept[self._touched(box)] = True
        item = np.arange(len(self.targets.object), dtype=np.int32)
        self._scout(box, item, kept)
        self._divide(box, item, kept, 0)
        open_ &= kept

    def _touched(self, box: np.ndarray) -> np.ndarray:
        """Objects that a camera inside a solid in this box may see because they touch that solid."""
        met = np.flatnonzero(_meet(self.occluders.solids.box, box) & ~self.occluders.solids.culled)
        row = self.targets.touch_row
        return np.concatenate([np.zeros(0, np.int32), *(self.targets.touch[row[s] : row[s + 1]] for s in met)])

    def _scout(self, box: np.ndarray, item: np.ndarray, kept: np.ndarray) -> None:
        """Look from a few of the smallest parts first: most of what no part can hide need not be looked at again."""
        n = int(np.prod(PARTS))
        for i, k in ((0, 0), (n - 1, n - 1), (0, n - 1), (n - 1, 0), (n // 2, n // 2)):
            self._hide(_part(box, n, i, k), item[~kept[self.targets.object[item]]], kept, last=True)

    def _divide(self, box: np.ndarray, item: np.ndarray, kept: np.ndarray, depth: int) -> None:
        """Add to `kept` (N,) b1 what a cell's part `box` cannot hide, nor all of its own parts."""
        last = depth == len(PARTS) - 1
        for i in range(PARTS[depth]):
            for k in range(PARTS[depth]):
                item = item[~kept[self.targets.object[item]]]
                part = _part(box, PARTS[depth], i, k)
                left = item[self._hide(part, item, kept, last=last)]
                if not last and len(left):
                    self._divide(part, left, kept, depth + 1)

    def _hide(self, box: np.ndarray, item: np.ndarray, kept: np.ndarray, *, last: bool) -> np.ndarray:
        """Return which items (n,) b1 may be seen from a box; adds their objects to `kept` if last."""
        columns, targets, solids = self.columns, self.targets, self.occluders.solids
        open_ = np.zeros(len(item), dtype=np.bool_)
        above, on_ground = self._above_ground(box)
        if above is None or not len(item):
            return open_
        counts = solids.culled | ~np.isnan(solids.cap_y)
        if on_ground:
            counts &= ~columns.buried
        met = np.flatnonzero(_meet(solids.box, above) & counts)
        cap = np.where(solids.side[met] == 1, solids.cap_y[met], np.inf)
        absent = np.concatenate([solids.box[met][:, 0, [0, 2]], solids.box[met][:, 1, [0, 2]], cap[:, None]], 1)
        self.tests += kernels.hide(
            above[0], above[1], item, targets.box, targets.object, targets.own[int(on_ground)],
            targets.own_cap[int(on_ground)], absent, (columns.x0, columns.z0, columns.size), self.slack, on_ground,
            columns.top, columns.bottom_on_ground if on_ground else columns.bottom, columns.under, targets.blocks,
            kept, last, open_,
        )  # fmt: skip
        return open_

    def _above_ground(self, box: np.ndarray) -> tuple[np.ndarray | None, bool]:
        """Return the part of a box that cameras can be in (None: it is all under the ground), and whether the ground
        counts for it: it is a height field under the whole of it."""
        c = self.columns
        low = np.floor((box[0, [0, 2]] - self.slack - (c.x0, c.z0)) / c.size).astype(np.int64)
        high = np.floor((box[1, [0, 2]] + self.slack - (c.x0, c.z0)) / c.size).astype(np.int64)
        if (low < 0).any() or (high >= c.domain.shape).any():
            return box, False
        part = np.s_[low[0] : high[0] + 1, low[1] : high[1] + 1]
        if not c.domain[part].all():
            return box, False
        ground = float(c.ground[part].min())
        if box[1, 1] <= ground:
            return None, True
        above = box.copy()
        above[0, 1] = max(above[0, 1], ground)
        return above, True

    def _by_patches(self, box: np.ndarray, open_: np.ndarray) -> None:
        """Clear open_ (N,) b1 of what a single patch hides from a cell's box."""
        objects = np.flatnonzero(open_)
        hidden = np.zeros(len(objects), dtype=np.bool_)
        patches = self.occluders.patches
        assert patches is not None
        patch_kernels.hide(
            box[0], box[1], objects, self.scene.object_box, patches.row, patches.edge, patches.normal, patches.span,
            patches.two_sided, self.slack, hidden,
        )  # fmt: skip
        open_[objects[hidden]] = False
