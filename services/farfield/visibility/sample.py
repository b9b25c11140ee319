"""Find what each cell sees by global lines: one line through the level serves every cell that it crosses.

Problem  Which objects are seen from somewhere in a cell? Miss few of them, measured in pixels, and say how few.
Method   From a free camera point (`free`) a line is traced both ways; both objects at its ends are set in every cell
         that its free segment crosses. Half of the lines are `frontier`: an object that a neighbouring cell is known to
         see and this one not yet, aimed at a random point of its surface. A quarter are mutations of lines that found
         something new: another point of the same cell, the target shifted by 0.002 to 0.1 of the distance. A quarter is
         a mix: 25 % any direction, 50 % near the horizon (Laplace, 0.15), 25 % towards random objects.
Stops    when of 2**19 view-like rays that are never marked so few are unseen that the 95 % bound is below
         `visibility.missed_ppm`, or after `visibility.rays` rays a cell. The same held-out rays serve every check: sets
         only grow and do not know them, so the check passes too early only if the last set that is not good enough
         passes. The certificate does not rest on them: other rays and whole views, drawn apart, wait for the merge.
View-like A free point anywhere in the view space; a picture of 45 degrees, its middle at most 30 degrees off the horizon
         (sine uniform), any heading; a pixel of it. Rays into the sky count: they are pixels, and cannot be missed.
Errs     A cell may lack an object that it sees; that costs image error, not frame time. It never errs the other way.
Shards   Subtrees of the view-space tree. Lines start in the shard's own cells and mark wherever they lead.
Tried    Missed ppm of 90 cells of San Francisco after 4, 8 and 14 M rays, by shares of frontier / mutation / mix:
         1/4 1/4 1/2 90, 38, 20; 0 1/4 3/4 100, 43, 21; 1/4 1/10 2/3 114, 51, 29; 1/2 1/4 1/4 129, 70; 0.6 0.3 0.1 179, 87.
         Mutations from a neighbouring cell instead: 1/2 1/4 1/4 as it is. Shards of 64 cells instead of 90: a
         third more misses after merging for the same time. Stopping on pairs: they never settle, and the missing ones
         are worth few pixels.
"""

import math

import numpy as np

from farfield.geometry.cells import CellTree, subtrees
from farfield.scene.model import Scene
from farfield.settings import Settings
from farfield.visibility import kernels
from farfield.visibility.confidence import most_missed
from farfield.visibility.free import build_pool, choose_rule, is_free, places_of, whole
from farfield.visibility.model import Sightings
from farfield.visibility.rays import MISS, Rays, rays_of

SHARDS = 5  # at least as many, mostly some 8, unless that makes a shard smaller or larger than
CELLS_A_SHARD = (16, 512)  # ... these: each builds its own ray tracer, and time must stay linear in the area
HELD_OUT = 2**19  # rays a shard, for stopping
HELD_OUT_TRIES = 2**21  # points of the whole view space, for the certificate: a ray from each that is free
VIEW_TRIES, VIEW_PX = 1024, 96  # views of the whole view space, rays a side

_LINES_A_CELL, _LINES = 256, (2**13, 2**16)  # a batch
_POOL_TRIES, _POOL_LAST = 1024, 4096  # points a cell
_KEPT = 2**16  # finds to mutate
_HALF_TAN, _PITCH = math.tan(math.radians(22.5)), 0.5


def plan_shards(cells: CellTree) -> list[int]:
    """Return the nodes whose subtrees are the shards, in preorder: together they hold every leaf cell once."""
    low, high = CELLS_A_SHARD
    return subtrees(cells, most=min(high, max(low, math.ceil(cells.n_cells / SHARDS))))


def sample_cells(scene: Scene, cells: CellTree, node: int, *, rays: int, seed: int) -> np.ndarray:
    """Return (C,N) b1: which objects at most `rays` rays a cell found the C leaf cells under `node` to see."""
    sampler = Sampler(scene, cells, node, seed=seed)
    sampler.run(rays=rays)
    return sampler.witnessed()


def see(
    scene: Scene, cells: CellTree, node: int, *, settings: Settings, mode: str, seen_share: float | None
) -> Sightings:
    """Return what the leaf cells under `node` see; mode "conservative": all but what is proved hidden from them.

    seen_share  what "auto" measured, if it was asked
    """
    sampler = Sampler(scene, cells, node, seed=settings.seed)
    sampler.run(rays=settings.visibility.rays, missed_ppm=settings.visibility.missed_ppm)
    occluders: tuple[str, ...] = ()
    if mode == "conservative":
        from farfield.visibility import conservative  # late: the other mode need not load what proofs take

        sampler.keep(conservative.prove(scene, cells, node, sampler.witnessed()))
        occluders = conservative.reasons(scene, cells)
    return sampler.sightings(mode=mode, seen_share=seen_share, occluders=occluders)


class Sampler:
    """One shard at work. `seen` holds the sets of all leaf cells (L,W) u64; the shard's own are [own[0], own[1])."""

    def __init__(self, scene: Scene, cells: CellTree, node: int, *, seed: int, rays: Rays | None = None) -> None:
        self.cells, self.n_objects, self.cell_m = cells, scene.n_objects, scene.cell_m
        self.view_boxes = scene.view_boxes
        self.own = np.array([cells.start[node], cells.stop[node]], dtype=np.int64)
        self.rays = rays_of(scene) if rays is None else rays
        self.seen = np.zeros((cells.n_cells, -(-scene.n_objects // 64)), dtype=np.uint64)
        streams = np.random.SeedSequence([seed, node]).spawn(4)
        pool_rng, self._rng, self._stop_rng, self._merge_rng = (np.random.default_rng(s) for s in streams)
        self.everywhere = whole(scene.view_boxes, cell_m=scene.cell_m)
        self.rule = choose_rule(self.rays, self.everywhere)
        self.places = places_of(cells, scene.view_boxes, cell_m=scene.cell_m, which=np.arange(*self.own))
        self.pool = build_pool(self.rays, self.places, self.rule, pool_rng, tries=_POOL_TRIES, last=_POOL_LAST)
        self.open = self.pool.open  # numbered from own[0], as in `pool` and `places`
        self.n_rays = 0
        self._neighbours = self._find_neighbours()
        self._found_cell, self._found_at = np.zeros(0, np.int64), np.zeros((0, 3))

    def run(self, *, rays: int, missed_ppm: float | None = None) -> None:
        """Shoot until `rays` rays a cell, or until the bound on missed pixels of the held-out rays is met."""
        if not len(self.open):
            return
        least, most = _LINES
        lines = min(most, max(least, _LINES_A_CELL * len(self.open)))
        enough = math.ceil(rays * len(self.open) / 2 / lines)
        if missed_ppm is not None:
            cell, object, count, n = self._held_out(self._stop_rng, HELD_OUT)
            allowed = most_missed(n, ppm=missed_ppm)
        for _ in range(enough):
            self._shoot(lines)
            if missed_ppm is not None and self.missed(cell, object, count) <= allowed:
                break

    def missed(self, cell: np.ndarray, object: np.ndarray, count: np.ndarray) -> int:
        """Return how many of the rays of these pairs are unseen."""
        out = np.empty(len(cell), dtype=np.bool_)
        kernels.is_seen(self.seen, cell, object, out)
        return int(count[~out].sum())

    def witnessed(self) -> np.ndarray:
        """Return the own cells' sets as (C,N) b1."""
        bits = np.unpackbits(self.seen[slice(*self.own)].view(np.uint8), axis=1, bitorder="little")
        return bits[:, : self.n_objects].astype(np.bool_)

    def keep(self, sets: np.ndarray) -> None:
        """Put sets (C,N) b1 in place of the own cells'."""
        padded = np.zeros((len(sets), 64 * self.seen.shape[1]), dtype=np.bool_)
        padded[:, : self.n_objects] = sets
        self.seen[slice(*self.own)] = np.packbits(padded, axis=1, bitorder="little").view(np.uint64)

    def sightings(self, *, mode: str, seen_share: float | None, occluders: tuple[str, ...] = ()) -> Sightings:
        """Return the shard's artifact: what was seen so far, and fresh held-out rays and views."""
        touched = np.flatnonzero(self.seen.any(1)).astype(np.int32)
        closed = np.setdiff1d(np.arange(len(self.places.row) - 1), self.open) + self.own[0]
        # The shard's share of the points of the whole view space, by volume, so that all are spread evenly over it.
        through = self.places.below[-1] / self.everywhere.below[-1]
        cell, object, count, n = self._held_out(self._merge_rng, round(HELD_OUT_TRIES * through), once=True)
        return Sightings(
            mode=mode, rule=self.rule, occluders=occluders, seen_share=seen_share, cell=touched, bits=self.seen[touched],
            closed=closed.astype(np.int32), rays=self.n_rays, held_cell=cell.astype(np.int32), held_object=object,
            held_count=count, held_out=n, **self._views(round(VIEW_TRIES * through)),
        )  # fmt: skip

    # Lines ----------------------------------------------------------------------------------------------------------

    def _shoot(self, n: int) -> None:
        """Trace and mark n lines: a quarter frontier, a quarter mutations, the rest the mix."""
        aims = [self._frontier(n // 4), self._mutations(n // 4)]
        aims.append(self._mix(n - sum(len(cell) for cell, _ in aims)))
        cell = np.concatenate([c for c, _ in aims])
        order = np.argsort(cell, kind="stable")  # lines from one cell run through the same part of the level
        cell = cell[order]
        origin = self.pool.draw(cell, self._rng.random(len(cell)))
        to = np.concatenate([t for _, t in aims])[order]
        free = np.isinf(to).any(1)
        direction = np.where(free[:, None], 0.0, to - origin)
        direction[free] = self._directions(int(free.sum()))
        self.trace(origin, _unit(direction))

    def trace(self, origin: np.ndarray, direction: np.ndarray) -> None:
        """Trace lines both ways from free points (R,3) along units (R,3), mark, and remember what was new."""
        n = len(origin)
        front, ahead, free = self.rays.seen(origin, direction)
        behind, back, free_back = self.rays.seen(origin, -direction)
        self.n_rays += 2 * n
        news = np.empty((n, 2), dtype=np.int32)
        self._mark(origin, direction, free_back, free, behind, front, news)
        for way in (1.0, -1.0):
            line, object = self.rays.passed(origin, way * direction, ahead if way > 0 else back)
            if len(line):
                none = np.full(len(line), -1, np.int32)
                passed = np.empty((len(line), 2), dtype=np.int32)
                self._mark(origin[line], direction[line], free_back[line], free[line], none, object, passed)
        cells, points = [], []
        for side, distance in ((0, -back), (1, ahead)):
            new = np.flatnonzero(news[:, side] >= 0)
            cells.append(news[new, side] - self.own[0])
            points.append(origin[new] + direction[new] * distance[new, None])
        # A line may have found something in an own cell that has no free point of its own.
        cell, at = np.concatenate(cells).astype(np.int64), np.concatenate(points)
        usable = self.pool.row[cell] < self.pool.row[cell + 1]
        self._found_cell = np.concatenate([cell[usable], self._found_cell])[:_KEPT]
        self._found_at = np.concatenate([at[usable], self._found_at])[:_KEPT]

    def _mark(self, origin, direction, back, ahead, behind, front, news) -> None:  # type: ignore[no-untyped-def]
        tree = self.cells
        kernels.mark_lines(
            tree.low, tree.high, tree.box, tree.start, origin, direction, back, ahead, behind, front, self.seen,
            self.own, news,
        )  # fmt: skip

    # Where lines go: (own cell (K,) i64, target (K,3) f64; inf: a direction of the mix) ------------------------------

    def _frontier(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        row, neighbour = self._neighbours
        sets = np.empty((len(self.open), self.seen.shape[1]), dtype=np.uint64)
        total = int(kernels.frontier(self.seen, self.open + self.own[0], row, neighbour, sets).sum())
        n = n if total else 0
        which, object = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.int32)
        kernels.pick(sets, np.sort(self._rng.integers(0, max(total, 1), n)), which, object)
        return self.open[which], self.rays.surface.points(object, self._rng.random((n, 3)))

    def _mutations(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        if not len(self._found_cell):
            return np.zeros(0, np.int64), np.zeros((0, 3))
        which = self._rng.integers(0, len(self._found_cell), n)
        cell, at = self._found_cell[which], self._found_at[which]
        middle = self.cells.cell_box[cell + self.own[0]].mean(1)
        far = np.sqrt(((at - middle) ** 2).sum(1)) * 0.002 * 50.0 ** self._rng.random(n)
        return cell, at + far[:, None] * self._rng.uniform(-1, 1, (n, 3))

    def _mix(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        cell = self.open[self._rng.integers(0, len(self.open), n)]
        to = np.full((n, 3), np.inf)
        aimed = np.arange(n) % 4 == 0
        object = self._rng.integers(0, self.n_objects, int(aimed.sum()))
        to[aimed] = self.rays.surface.points(object, self._rng.random((len(object), 3)))
        return cell, to

    def _directions(self, n: int) -> np.ndarray:
        """Return (n,3) f64: a third anywhere, two thirds near the horizon."""
        height = self._rng.laplace(0, 0.15, n)
        anywhere = np.arange(n) % 3 == 0
        height[anywhere] = self._rng.uniform(-1, 1, int(anywhere.sum()))
        return _around(self._rng.random(n), np.clip(height, -1, 1))

    # What is held out -----------------------------------------------------------------------------------------------

    def _held_out(
        self, rng: np.random.Generator, n: int, *, once: bool = False
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
        """Return (cell, object, rays of that pair, rays in all) of n view-like rays; `once`: of n points, free or not."""
        keys: list[np.ndarray] = []
        left = n
        for _ in range(1 if once else 8):
            cell, points = self.places.spread(rng.random((left, 4)))
            free = is_free(self.rays, points, self.rule)
            cell, points = cell[free] + self.own[0], points[free]
            toward = view_directions(rng.random((len(cell), 4)))
            keys.append(self._pairs(cell, points, toward))
            left -= len(cell)
            if left <= 0 or not len(cell):
                break
        key, count = np.unique(np.concatenate(keys), return_counts=True)
        cell, object = np.divmod(key, self.n_objects)
        return cell, object.astype(np.int32), count, n - left

    def _pairs(self, cell: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Return cell * N + object (K,) i64 for everything that rays from the cells (R,) see, ray by ray."""
        object, distance, _ = self.rays.seen(origin, direction)
        hit = object >= 0
        ray, passed = self.rays.passed(origin, direction, distance)
        return np.concatenate([cell[hit] * self.n_objects + object[hit], cell[ray] * self.n_objects + passed])

    def _views(self, tries: int) -> dict[str, np.ndarray]:
        """Return the columns of Sightings for the free ones of `tries` random views."""
        rng = self._merge_rng
        cell, points = self.places.spread(rng.random((tries, 4)))
        free = is_free(self.rays, points, self.rule)
        row, objects, counts = [0], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for c, point, heading in zip(cell[free] + self.own[0], points[free], rng.random((tries, 2))[free]):
            random = np.concatenate([np.tile(heading, (VIEW_PX**2, 1)), _grid(rng)], axis=1)
            key = self._pairs(np.full(len(random), c), np.tile(point, (len(random), 1)), view_directions(random))
            object, count = np.unique(key % self.n_objects, return_counts=True)
            objects.append(object)
            counts.append(count)
            row.append(row[-1] + len(object))
        return {
            "view_row": np.array(row, dtype=np.int64), "view_cell": (cell[free] + self.own[0]).astype(np.int32),
            "view_object": np.concatenate(objects).astype(np.int32), "view_count": np.concatenate(counts),
        }  # fmt: skip

    def _find_neighbours(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (rows, cells): for each open own cell those no farther than half a cell from it on any axis."""
        boxes = self.cells.cell_box
        low, high = boxes[:, 0] - self.cell_m / 2, boxes[:, 1] + self.cell_m / 2
        found = []
        for c in self.open + self.own[0]:
            near = ((low <= boxes[c, 1]) & (high >= boxes[c, 0])).all(1)
            near[c] = False
            found.append(np.flatnonzero(near))
        return np.cumsum([0, *map(len, found)]), np.concatenate([np.zeros(0, np.int64), *found])


def view_directions(random: np.ndarray) -> np.ndarray:
    """Return (K,3) f64 units through random pixels of random views; random (K,4): heading, pitch, across, up."""
    forward = _around(random[:, 0], (2 * random[:, 1] - 1) * _PITCH)
    level = np.sqrt(forward[:, 0] ** 2 + forward[:, 2] ** 2)
    zero = np.zeros(len(random))
    right = np.stack([-forward[:, 2] / level, zero, forward[:, 0] / level], 1)
    up = np.stack([right[:, 1] * forward[:, 2] - right[:, 2] * forward[:, 1],
                   right[:, 2] * forward[:, 0] - right[:, 0] * forward[:, 2],
                   right[:, 0] * forward[:, 1] - right[:, 1] * forward[:, 0]], 1)  # fmt: skip
    across, upward = ((2 * random[:, k] - 1) * _HALF_TAN for k in (2, 3))
    return _unit(forward + across[:, None] * right + upward[:, None] * up)


def _around(turn: np.ndarray, height: np.ndarray) -> np.ndarray:
    level = np.sqrt(1 - height * height)
    angle = turn * (2 * np.pi)
    return np.stack([level * np.cos(angle), height, level * np.sin(angle)], 1)


def _grid(rng: np.random.Generator) -> np.ndarray:
    """Return (VIEW_PX**2,2) f64 in [0, 1): one random point in each pixel."""
    pixel = np.stack(np.meshgrid(*(np.arange(VIEW_PX),) * 2, indexing="ij"), -1).reshape(-1, 2)
    return (pixel + rng.random((VIEW_PX**2, 2))) / VIEW_PX


def _unit(v: np.ndarray) -> np.ndarray:
    length = np.sqrt((v * v).sum(1))
    ok = (length > 0) & (length < MISS)
    return np.where(ok[:, None], v / np.where(ok, length, 1)[:, None], np.array([1.0, 0.0, 0.0]))
