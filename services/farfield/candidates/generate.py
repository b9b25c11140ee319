"""Generate impostor candidates: clusters with view cells from which an impostor of them would help.

Problem  Any cluster could be replaced as seen from any set of cells. Offer the optimiser, for each cluster, few view
         cells that are worth their bytes, such that every cell that can be helped is helped by some.
Method   1. Raw shafts (apex angles, directions and smallest distances in steps) and boxes (nodes of the view-space tree)
            produce sets of served cells, nothing else. Only cells count that have a problem view in which the cluster
            costs more than the cheapest impostor.
         2. Equal sets are one: named by the sum of 128 random bits a cell.
         3. Each set is weighed quickly; its efficiency is what it may gain over its bytes. From the most efficient on,
            a set is kept if enough of its gain lies in cells that no set so far holds and that no larger cluster in
            the shard serves more efficiently (`kernels.is_needed`). So every cell that any can serve is served.
         4. Shrink-wrap: the tightest shaft and the tightest box around exactly these cells; the lighter is taken, and
            serves every cell that it holds.
            With `placement.view_cells = "raw"`, the paper's way, the raw view cell stays as it is.
            Bytes, layers and cost follow from `farfield.impostor.frames`, the same plan that the bake follows.
Errs     Bytes, layers and cost are upper bounds; a view cell holds every cell that it serves.
Shards   Ranges of clusters in preorder, from a rule that knows nothing of workers.
After    Jeschke et al., I3D 2005, section 4. Changed: placement.md section 6.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np

from farfield.candidates import kernels
from farfield.candidates.model import BOX, SHAFT, Candidates
from farfield.candidates.pair_kernels import list_pairs
from farfield.columns import Parts, dataclass_parts
from farfield.geometry.cells import CellTree
from farfield.hierarchy.model import Hierarchy
from farfield.impostor.plan import precision
from farfield.impostor.weight import MAX_LAYER_TRIANGLES
from farfield.rendertime import cost as rendertime
from farfield.rendertime.model import CostModel
from farfield.scene.model import Scene
from farfield.settings import Settings
from farfield.viewspace.cost import runs_of
from farfield.viewspace.model import ProblemViews

SHARDS = 32  # about as many
STEP_DEG = 11.25  # between directions of raw shafts
ENTRIES = 48_000_000  # aimed at: candidates x problem views (docs/decisions/0010-which-candidates.md)
COUNTED_VIEWS = 256  # at least, to estimate the entries
BLOCK_PAIRS = 4_000_000  # of a cluster and a problem view that are held at once, 12 bytes each
UNFIT = 1 << 62  # bytes and cost of what cannot be fitted


def plan_shards(hierarchy: Hierarchy) -> list[tuple[int, int]]:
    """Return preorder ranges [a, b) of clusters that cover all of them. They shape the result (`reach` ends at them)."""
    n = len(hierarchy.start)
    most = max(64, -(-n // SHARDS))
    return [(a, min(n, a + most)) for a in range(0, n, most)]


def directions() -> np.ndarray:
    """Return (D,3) f64 unit vectors, STEP_DEG apart on rings that are STEP_DEG apart; y up."""
    rings = round(180 / STEP_DEG)
    out = []
    for i in range(rings + 1):
        elevation = math.radians(-90 + i * STEP_DEG)
        level = math.cos(elevation) if 0 < i < rings else 0.0
        n = max(1, math.ceil(360 / STEP_DEG * level - 1e-9))
        for j in range(n):
            azimuth = 2 * math.pi * j / n
            out.append([level * math.cos(azimuth), math.sin(elevation), level * math.sin(azimuth)])
    return np.array(out)


@dataclass(frozen=True, kw_only=True)
class _Work:
    """What all clusters share."""

    delta: float
    dl: float
    screen: np.ndarray
    coefficient: np.ndarray
    floor: int  # what the cheapest impostor costs
    shafts: bool
    boxes: bool
    alone: bool  # each for one view cell
    raw: bool  # view cells as found, not fitted
    cell_box: np.ndarray
    keys: np.ndarray
    directions: np.ndarray
    excess: np.ndarray  # (V,)
    share: float
    outdone: float


def thinning(
    hierarchy: Hierarchy, model: CostModel, views: ProblemViews, *, density: float = 1.0
) -> tuple[float, float]:  # fmt: skip
    """Return (share, outdone) of `kernels.is_needed`: stricter the more pairs of cluster and problem view there are.

    density  `placement.density`: as if there were that many times fewer pairs; above 1 also where they are few

    At (1/4, 1) nine tenths of the pairs where a cluster costs more than the cheapest impostor become entries; the
    constants were measured, see docs/decisions/0010. The pairs are counted in every k-th view.
    """
    pairs = _count_pairs(hierarchy, views, cheapest_cost(model), every=-(-len(views.cell) // COUNTED_VIEWS))
    crowding = max(1.0, 0.9 * pairs / ENTRIES)
    crowding /= density
    return min(0.25 * crowding, 0.75), min(1.0 if density <= 1 else density, (2 / crowding) ** 2)


def _count_pairs(hierarchy: Hierarchy, views: ProblemViews, floor: int, *, every: int) -> int:
    """Return about how many pairs of cluster and problem view cost more than floor, from each `every`-th view."""
    runs, some = runs_of(views), np.arange(0, len(views.cell), max(1, every))
    length = runs.row[some + 1] - runs.row[some]
    row = np.concatenate([[0], np.cumsum(length)])
    at = np.repeat(runs.row[some] - row[:-1], length) + np.arange(row[-1])
    runs = runs._replace(cost=runs.cost[some], list=runs.list[some], row=row, run=runs.run[at], before=runs.before[at])
    none = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int64)
    count = np.empty(len(hierarchy.start), dtype=np.int64)
    tree = hierarchy.start, hierarchy.stop, hierarchy.left, hierarchy.right
    list_pairs(runs, *tree, (0, len(count)), floor, count, *none)
    return int(count.sum()) * max(1, every)


def cheapest_cost(model: CostModel) -> int:
    """Return what no impostor costs less than."""
    return rendertime.impostor_cost(model, triangles=MAX_LAYER_TRIANGLES, pixels=0)


def _prepare(
    hierarchy: Hierarchy, model: CostModel, cells: CellTree, views: ProblemViews, settings: Settings
) -> _Work:  # fmt: skip
    p = precision(settings)
    share, outdone = thinning(hierarchy, model, views, density=settings.placement.density)
    wanted = settings.placement.candidates
    return _Work(
        delta=p.delta, dl=p.dl, screen=rendertime.screen(model), coefficient=_coefficient(model),
        floor=cheapest_cost(model), share=share, outdone=outdone,
        shafts="shafts" in wanted, boxes=wanted != "shafts", alone=wanted == "cells",
        raw=settings.placement.view_cells == "raw",
        cell_box=np.ascontiguousarray(cells.cell_box),
        keys=kernels.cell_keys(cells.n_cells), directions=directions(),
        excess=views.cost - model.target,
    )  # fmt: skip


def _coefficient(model: CostModel) -> np.ndarray:
    return np.array([model.per_impostor, model.per_impostor_triangle, model.per_impostor_pixel])


def generate(
    scene: Scene, hierarchy: Hierarchy, model: CostModel, cells: CellTree, views: ProblemViews, *, settings: Settings,
    nodes: tuple[int, int],
) -> Candidates:  # fmt: skip
    """Return the candidates of the clusters [a, b) = nodes. `views` must hold all problem views, sorted by cell."""
    work = _prepare(hierarchy, model, cells, views, settings)
    scratch = _Scratch(work, cells)
    rows = _Rows()
    around: list[tuple[int, np.ndarray, np.ndarray]] = []  # of the clusters around this one: stop, cells, efficiency
    for first, row, view, cost in _pairs(hierarchy, views, work, nodes):
        for k in range(len(row) - 1):
            c, pairs = first + k, slice(row[k], row[k + 1])
            if row[k] == row[k + 1]:
                continue
            given = _Given(np.ascontiguousarray(hierarchy.box[c]), view[pairs], cost[pairs], views.cell, work)
            while around and around[-1][0] <= hierarchy.start[c]:
                around.pop()
            above = np.zeros(len(given.useful))
            if around:
                _, known, efficiency = around[-1]
                above = efficiency[np.searchsorted(known, given.useful)]
            if hierarchy.replaceable[c]:
                above = _generate_one(c, given, above, work, scratch, cells, rows)
            around.append((int(hierarchy.stop[c]), given.useful, above))
    return rows.build()


def _pairs(
    hierarchy: Hierarchy, views: ProblemViews, work: _Work, nodes: tuple[int, int]
) -> Iterator[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield (first cluster, row, view, cost) for blocks of clusters: what each costs where that is above the floor."""
    tree = hierarchy.start, hierarchy.stop, hierarchy.left, hierarchy.right
    none = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int64)
    count = np.zeros(nodes[1] - nodes[0], dtype=np.int64)
    list_pairs(runs_of(views), *tree, nodes, work.floor, count, *none)
    through = np.concatenate([[0], np.cumsum(count)])
    first = 0
    while first < len(count):
        last = max(first + 1, int(np.searchsorted(through, through[first] + BLOCK_PAIRS, side="right")) - 1)
        row = through[first : last + 1] - through[first]
        view, cost = np.empty(row[-1], dtype=np.int32), np.empty(row[-1], dtype=np.int64)
        if row[-1]:
            some = nodes[0] + first, nodes[0] + last
            list_pairs(runs_of(views), *tree, some, work.floor, np.empty(last - first, np.int64), row, view, cost)
        yield nodes[0] + first, row, view, cost
        first = last


class _Given:
    """A cluster, and the cells from which it costs more than the cheapest impostor. Elsewhere cells are places in
    `useful`."""

    def __init__(self, box: np.ndarray, view: np.ndarray, cost: np.ndarray, cell: np.ndarray, work: _Work) -> None:
        useful, view_row = np.empty(len(view), dtype=np.int64), np.empty(len(view) + 1, dtype=np.int64)
        gain = np.empty(len(view), dtype=np.int64)
        n = kernels.cell_gains(view, cost, cell, work.excess, work.floor, useful, view_row, gain)
        self.box, self.view, self.cost = box, view, cost
        self.useful, self.view_row, self.gain = useful[:n], view_row[: n + 1], gain[:n]
        self.cell_box, self.keys = work.cell_box[self.useful], work.keys[self.useful]


class _Scratch:
    """Arrays that every cluster of a shard uses anew."""

    def __init__(self, work: _Work, cells: CellTree) -> None:
        d = len(work.directions)
        most_sets = len(cells.axis) + d * len(kernels.ANGLES_DEG) * kernels.DISTANCES
        slots = 1 << (2 * most_sets - 1).bit_length()
        self.bucket = np.zeros((d, len(kernels.ANGLES_DEG), kernels.DISTANCES, 2), dtype=np.uint64)
        self.bucket_count = np.zeros(self.bucket.shape[:3], dtype=np.int32)
        self.table_key, self.table_id = np.zeros((slots, 2), dtype=np.uint64), np.full(slots, -1, dtype=np.int64)
        self.slot_of = np.empty(most_sets, dtype=np.int64)
        self.source = np.zeros((most_sets, 4), dtype=np.int64)
        self.points = np.empty((8 * cells.n_cells, 3))


def _generate_one(
    cluster: int, given: _Given, above: np.ndarray, work: _Work, scratch: _Scratch, cells: CellTree, rows: "_Rows"
) -> np.ndarray:
    """Add the candidates of one cluster; return (U,) f64, what it and the clusters around it reach in its cells."""
    box, useful = given.box, given.useful
    middle, size = (box[0] + box[1]) / 2, float(np.sqrt(((box[1] - box[0]) ** 2).sum()))
    hold = np.empty((len(work.directions), len(useful)), dtype=np.uint8)
    n = kernels.find_sets(
        middle, size, useful, given.cell_box, given.keys, work.directions, cells.start, cells.low, cells.high,
        work.shafts, work.boxes, scratch.bucket, scratch.bucket_count, hold, scratch.table_key, scratch.table_id,
        scratch.slot_of, scratch.source,
    )  # fmt: skip
    source = scratch.source[:n]
    row, member = np.empty(n + 1, dtype=np.int64), np.empty(source[:, 3].sum(), dtype=np.int32)
    kernels.list_members(n, source, useful, hold, cells.start, cells.stop, row, member)
    weight, efficiency = np.empty(n), np.empty(n)
    raw = np.empty((n if work.raw else 0, 9))
    if work.raw:
        kernels.raw_cells(source, middle, size, work.directions, cells.box, raw)
    kernels.weigh_sets(
        row, member, given.gain, given.cell_box, box, work.delta, work.dl, source, raw, weight, efficiency
    )  # fmt: skip
    if work.alone:
        weight[np.diff(row) > 1], efficiency[np.diff(row) > 1] = np.inf, 0.0
    order = np.argsort(-efficiency, kind="stable")
    inside, view_cell = np.empty((n, len(useful)), dtype=np.int32), np.zeros((n, 9))
    number, served = np.empty((n, 3), np.int64), np.empty((n, 3), np.int64)
    reach = np.empty(len(useful))
    count = kernels.choose_sets(
        order, row, member, given.gain, given.cell_box, box, work.shafts, work.boxes, work.delta, work.dl,
        work.screen, work.coefficient, given.cost, given.view_row, weight, efficiency, above, work.share,
        work.outdone, scratch.points, source, raw, inside, view_cell, number, served, reach,
    )  # fmt: skip
    for i in rows.start(cluster, count, view_cell, number, served):
        view, saved = np.empty(served[i, 2], dtype=np.int32), np.empty(served[i, 2], dtype=np.int64)
        kernels.list_served(
            given.view, given.cost, given.view_row, inside[i, : served[i, 1]], served[i, 0], view, saved
        )
        rows.view.append(view)
        rows.saved.append(saved)
    return reach


class _Rows:
    """Columns of Candidates as they grow, a cluster at a time, sorted by kind and view cell within it."""

    def __init__(self) -> None:
        self.parts: list[tuple[np.ndarray, ...]] = []
        self.view: list[np.ndarray] = []
        self.saved: list[np.ndarray] = []

    def start(self, cluster: int, n: int, view_cell: np.ndarray, number: np.ndarray, served: np.ndarray) -> np.ndarray:
        """Add the n candidates of a cluster but for their views, which must follow in the order that is returned."""
        order = np.lexsort((*view_cell[:n].T[::-1], number[:n, 0]))
        self.parts.append((np.full(n, cluster), view_cell[order], number[order], served[order]))
        return order

    def build(self) -> Candidates:
        cluster, view_cell, number, served = (
            (np.concatenate(column) for column in zip(*self.parts, strict=True))
            if self.parts
            else (np.zeros(0), np.zeros((0, 9)), np.zeros((0, 3)), np.zeros((0, 3)))
        )
        return Candidates(
            cluster=cluster.astype(np.int32), kind=number[:, 0].astype(np.uint8), view_cell=view_cell,
            bytes=number[:, 1].astype(np.int64), layers=number[:, 2].astype(np.int32),
            cost=served[:, 0].astype(np.int64), row=np.concatenate([[0], np.cumsum(served[:, 2])]).astype(np.int64),
            view=np.concatenate(self.view) if self.view else np.zeros(0, np.int32),
            saved=np.concatenate(self.saved) if self.saved else np.zeros(0, np.int64),
        )  # fmt: skip


def merge(parts: Sequence[Candidates]) -> Candidates:
    """Return the candidates of all shards, which must come in order of their clusters; ids are final."""
    if not parts:
        return _Rows().build()
    merged = joined(parts)
    assert (np.diff(merged.cluster) >= 0).all()
    return merged


def merged_parts(parts: Sequence[Candidates]) -> Parts:
    """Return the artifact of what `merge` returns, its columns still in the shards' own: some hundred megabytes."""
    return dataclass_parts(parts[0], **_columns(parts)) if parts else dataclass_parts(merge(parts))


def joined(parts: Sequence[Candidates]) -> Candidates:
    """Return the candidates of one or more shards as one, in the shards' order."""
    columns = _columns(parts)
    return Candidates(row=columns.pop("row")[0], **{name: np.concatenate(column) for name, column in columns.items()})


def _columns(parts: Sequence[Candidates]) -> dict[str, list[np.ndarray]]:
    offset = np.concatenate([[0], np.cumsum([p.row[-1] for p in parts])])
    row = np.concatenate([[0], *(p.row[1:] + o for p, o in zip(parts, offset[:-1], strict=True))]).astype(np.int64)
    names = [f.name for f in fields(Candidates) if f.name != "row"]
    return {"row": [row]} | {name: [getattr(p, name) for p in parts] for name in names}


def refit(
    cluster_box: np.ndarray, cell_boxes: np.ndarray, *, model: CostModel, settings: Settings
) -> tuple[int, np.ndarray, int, int, int]:
    """Return (kind, view cell (9,), bytes, layers, cost) of the best fit to exactly these cells, as `generate` fits.

    cluster_box  (2,3) f64; cell_boxes  (K,2,3) f64, K >= 1
    Where no impostor can be fitted, bytes and cost are UNFIT: heavier than anything.
    """
    boxes = np.ascontiguousarray(cell_boxes, dtype=np.float64).reshape(-1, 2, 3)
    p, wanted = precision(settings), settings.placement.candidates
    view_cell = np.zeros(9)
    kind, size, layers, cost = kernels.fit_best(
        np.ascontiguousarray(cluster_box, dtype=np.float64), boxes, np.arange(len(boxes)), "shafts" in wanted,
        wanted != "shafts", p.delta, p.dl, rendertime.screen(model), _coefficient(model), view_cell,
        np.empty((8 * len(boxes), 3)),
    )  # fmt: skip
    if kind < 0:
        return SHAFT if "shafts" in wanted else BOX, view_cell, UNFIT, 0, UNFIT
    return int(kind), view_cell, int(size), int(layers), int(cost)
