"""Derive what the settings leave out: where a camera may be, how large its cells are, and a budget worth trying.

Cell     A 48th of the root of the focus's ground area (a 16th of the cube root of its volume without ground), rounded
         to a power of two metres: some 2,000 cells. 16 or 32 m for a city, 0.25 m for a flat. Objects that reach four
         times farther than all others together (a sky dome, a far plain) are not part of the focus.
         Twice that where the view space would have more than 4,608.
Space    A band at eye height that follows the ground where there is some: in each column of the grid, from the lowest
         ground + 1.5 m to the highest + 1.8 m; where ground jumps by more than a cell (from the street to a roof), a
         band at each height and nothing between. Ground is the lowest surface that faces up (down, in files turned
         inside out) and is nearly level, over at least half of the convex hull of the focus's footprint (a level that
         stands askew fills little of its box; roofs without a terrain little of their hull). Else the whole focus.
Budget   Two fifths of the largest of 512 sampled views, by objects' spheres in the view's cone.
Hints    Where the file does not say: a slab on its edge that has ground with z up; objects larger than any house.
All are suggestions: `farfield inspect` and the dashboard show them with their reasons, and settings override them.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from farfield.errors import SceneOverLimit
from farfield.geometry.cells import cells_about
from farfield.scene import kernels
from farfield.scene.level import Level, measure
from farfield.settings import Box, Settings

EYE_LOW_M, EYE_HIGH_M = 1.5, 1.8
_STEEPEST = 0.5  # |normal y| of ground: up to 60 degrees
_COVERED = 0.5  # share of the samples in the footprint's hull with ground below
_SLAB = 0.25  # depth over the lesser of width and height of a level that may lie on its side
_OUTLIER = 4.0
_SAMPLES = 4  # a column and axis
_COLUMNS = 512  # an axis, at most
_MOST_SAMPLES = 1 << 29  # looked at, over all triangles: some seconds of one core, and 128 layers over the largest grid
_MOST_CELLS = 2 * 48 * 48  # of a view space that is derived
_HUMAN_HEIGHT_M, _HUMAN_SIDE_M = 2.2, 6.0
_VIEWS, _BUDGET_SHARE = 512, 0.4
_HINT_OBJECTS, _HINT_TRIANGLES, _HINT_SIZE_M = 16, 100, 250.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Suggestion:
    """What is derived from a scene, in scene metres, each with the sentence why."""

    boxes: tuple[Box, ...]
    boxes_why: str
    cell_m: float
    cell_why: str
    interval_deg: float
    interval_why: str
    budgets: tuple[str, ...]
    budgets_why: str
    hints: tuple[str, ...]  # what seems wrong with unit or axes; warnings of the scene


def suggest(level: Level, *, settings: Settings) -> Suggestion:
    """Return view space, cell and interval for a level; what `settings` fix shapes what is left open.

    Budgets are left empty: they count objects, and these are final only when the level is split (`suggest_budgets`).
    """
    low, high = focus_box(level.object_box)
    given = settings.view_space
    floor_cell_m = _nice(max(math.sqrt(_area(low, high)) / 48, float((high - low).max()) / _COLUMNS))
    ground = _ground(level, low, high, floor_cell_m)
    eye, eye_why = _eye(low, high)
    if given.cell_m is not None:
        cell_m, cell_why = given.cell_m, "as set"
        if ground is not None and given.boxes is None and cell_m != ground.step * _SAMPLES:
            ground = sample_ground(level, low=low, high=high, cell_m=cell_m)
    elif ground is not None:
        cell_m = floor_cell_m
        while cells_about(ground.columns(eye), cell_m) > _MOST_CELLS and given.boxes is None:
            cell_m *= 2
            ground = sample_ground(level, low=low, high=high, cell_m=cell_m)
        cell_why = f"about a 48th of {math.sqrt(_area(low, high)):.4g} m, the root of the ground's area"
        if cell_m != floor_cell_m:
            cell_why += f", {cell_m / floor_cell_m:g} times that: the ground has several levels"
    else:
        side = max(float(np.prod(high - low)) ** (1 / 3), float((high - low).max()) / 4)
        cell_m, cell_why = _nice(side / 16), f"about a 16th of {side:.4g} m, the mean side of the whole box"
    if given.boxes is not None:
        boxes, boxes_why = given.boxes, "as set"
    elif ground is not None:
        boxes = merged_columns(ground.columns(eye))
        under = f"{ground.covered:.0%} of the level{eye_why}"
        boxes_why = f"a band {eye[0]:.4g} to {eye[1]:.4g} m above the ground, which lies under {under}"
    else:
        boxes = (_box(low, high),)
        boxes_why = "the whole box of the level: no ground lies under most of it"
    hints = _unit_hints(level, settings) + _axis_hints(level, settings)
    return Suggestion(
        boxes=boxes, boxes_why=boxes_why, cell_m=cell_m, cell_why=cell_why, interval_deg=given.interval_deg,
        interval_why="the smallest interval of the published method; half of it gives tighter views for more work",
        budgets=(), budgets_why="", hints=hints,
    )  # fmt: skip


def grid_origin(level: Level, cell_m: float) -> np.ndarray:
    """Return origin_m (3,) f64: the point nearest to the level's middle on a grid as coarse as the level is large.

    The spacing is cell_m times a power of two: a level that grows a little keeps its origin, but for half-way cases.
    """
    low, high = level.object_box[:, 0].min(0), level.object_box[:, 1].max(0)
    cells = max(1.0, float((high - low).max()) / cell_m)
    spacing = cell_m * 2.0 ** math.ceil(math.log2(cells))
    return np.rint((low * 0.5 + high * 0.5) / spacing) * spacing + 0.0


def focus_box(box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of the union of (N,2,3) boxes without those that reach far beyond all others."""
    left = np.argsort(-np.maximum(box[:, 1, 0] - box[:, 0, 0], box[:, 1, 2] - box[:, 0, 2]), kind="stable")
    while True:
        low, high = box[left, 0].min(0), box[left, 1].max(0)
        rest = left[1:]
        if not len(rest):
            return low, high
        inner = (box[rest, 1].max(0) - box[rest, 0].min(0))[[0, 2]].max()
        if (box[left[0], 1] - box[left[0], 0])[[0, 2]].max() <= _OUTLIER * inner:
            return low, high
        left = rest


@dataclass(frozen=True, slots=True)
class Ground:
    """Sampled ground: heights (nx,nz) f64 at (x0 + i step, z0 + k step), inf where there is none.

    inside  (nx,2) int64: samples [k0, k1) of row i lie in the hull of the footprint
    """

    height: np.ndarray
    x0: float
    z0: float
    step: float
    inside: np.ndarray

    @property
    def covered(self) -> float:
        k = np.arange(self.height.shape[1])
        within = (k >= self.inside[:, :1]) & (k < self.inside[:, 1:])
        return float((np.isfinite(self.height) & within).sum() / max(1, within.sum()))

    def columns(self, eye: tuple[float, float]) -> np.ndarray:
        """Return (B,2,3) boxes, x-major, a box a column and level: levels are more than a column's width apart."""
        n, side = _SAMPLES, self.step * _SAMPLES
        x, z = self.height.shape[0] // n, self.height.shape[1] // n
        tiles = np.sort(self.height.reshape(x, n, z, n).transpose(0, 2, 1, 3).reshape(x, z, n * n), axis=2)
        there = np.isfinite(tiles)
        # A level begins at the first sample of a column and where the next one is far above the last, and ends there.
        apart = np.zeros_like(there[:, :, :-1])
        apart[there[:, :, 1:]] = np.diff(np.where(there, tiles, 0.0), axis=2)[there[:, :, 1:]] > side
        first = there & np.concatenate([np.ones((x, z, 1), bool), apart], axis=2)
        last = there & np.concatenate([apart | ~there[:, :, 1:], np.ones((x, z, 1), bool)], axis=2)
        i, k, _ = np.nonzero(first)
        # Samples stand at the middles of their squares.
        x0, z0 = self.x0 - self.step / 2, self.z0 - self.step / 2
        low = np.stack([x0 + i * side, tiles[first] + eye[0], z0 + k * side], 1)
        high = np.stack([x0 + (i + 1) * side, tiles[last] + eye[1], z0 + (k + 1) * side], 1)
        return np.stack([low, high], 1)


def sample_ground(level: Level, *, low: np.ndarray, high: np.ndarray, cell_m: float) -> Ground:
    """Return the lowest surface that faces up over the columns of the grid that overlap [low, high].

    A column is cell_m wide, or a power of two times that, so that 4 to 512 stand in the longer row.
    """
    longest = float((high - low)[[0, 2]].max())
    while longest > _COLUMNS * cell_m:
        cell_m *= 2
    while 0 < longest < 4 * cell_m:
        cell_m /= 2
    first = np.floor(low[[0, 2]] / cell_m)
    last = np.maximum(np.ceil(high[[0, 2]] / cell_m), first + 1)
    step = cell_m / _SAMPLES
    shape = ((last - first) * _SAMPLES).astype(np.int64)
    x0, z0 = (first * cell_m + step / 2).tolist()
    floor_y = float(low[1] - (high[1] - low[1]) - cell_m)
    ends = level.mesh_triangles()
    best: Ground | None = None
    left = _MOST_SAMPLES
    reach = np.stack([np.full(int(shape[0]), np.inf), np.full(int(shape[0]), -np.inf)], 1)  # of z, a row
    for facing in (1.0, -1.0):
        height = np.full((int(shape[0]), int(shape[1])), np.inf)
        for o, mesh in enumerate(level.object_mesh.tolist()):
            box = level.object_box[o]
            if (box[1, [0, 2]] < low[[0, 2]]).any() or (box[0, [0, 2]] > high[[0, 2]]).any():
                continue
            index = level.index[ends[mesh] : ends[mesh + 1]]
            start, stop = level.mesh_vertices()[mesh : mesh + 2]
            placed = np.empty((stop - start, 3))
            matrix = np.ascontiguousarray(level.object_matrix[o])
            kernels.place(level.position[start:stop], matrix, placed)
            turned = -facing if np.linalg.det(matrix[:, :3]) < 0 else facing
            if best is None:
                kernels.row_reach(placed, low, high, x0, step, reach)
            corner = placed[index - start]
            left -= kernels.lowest_surface(corner, turned, _STEEPEST, floor_y, x0, z0, step, height, left)
            if left < 0:
                raise SceneOverLimit("The surfaces of the scene lie one over another too often to find its ground.")
        inside = hull_rows(reach, z0=z0, step=step, n=int(shape[1]))
        found = Ground(height, x0, z0, step, inside)
        if best is None or found.covered > best.covered:
            best = found
        if best.covered >= _COVERED:
            break
    assert best is not None
    return best


def hull_rows(reach: np.ndarray, *, z0: float, step: float, n: int) -> np.ndarray:
    """Return (nx,2) int64 [k0, k1): the samples z0 + k step, k in [0, n), in the convex hull of rows.

    reach  (nx,2) f64 least and largest z of row i; inf, -inf where the row has no point
    """
    rows = np.flatnonzero(reach[:, 0] <= reach[:, 1])
    out = np.zeros((len(reach), 2), dtype=np.int64)
    if not len(rows):
        return out
    x = np.arange(len(reach), dtype=np.float64)
    ends = []
    for sign, z in ((1.0, reach[rows, 0]), (-1.0, reach[rows, 1])):
        chain: list[tuple[float, float]] = []  # lower hull of (row, sign z)
        for p in zip(rows.tolist(), (sign * z).tolist(), strict=True):
            while len(chain) > 1 and _turns_right(chain[-2], chain[-1], p):
                chain.pop()
            chain.append(p)
        ends.append(sign * np.interp(x, *np.array(chain).T))
    inner = slice(rows[0], rows[-1] + 1)
    out[inner, 0] = np.ceil(np.clip((ends[0][inner] - z0) / step, 0, n))
    out[inner, 1] = np.floor(np.clip((ends[1][inner] - z0) / step, -1, n - 1)) + 1
    return out


def _turns_right(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) <= 0


def merged_columns(columns: np.ndarray) -> tuple[Box, ...]:
    """Join neighbouring columns (B,2,3) of equal height, along z and then along x, into fewer boxes."""
    rows = [c.copy() for c in columns]
    for axis, other in ((2, 0), (0, 2)):
        rows.sort(key=lambda c: (c[0, 1], c[1, 1], c[0, other], c[1, other], c[0, axis]))
        joined: list[np.ndarray] = []
        for row in rows:
            last = joined[-1] if joined else None
            if (
                last is not None
                and last[1, axis] == row[0, axis]
                and all((last[:, a] == row[:, a]).all() for a in (1, other))
            ):
                last[1, axis] = row[1, axis]
            else:
                joined.append(row)
        rows = joined
    rows.sort(key=lambda c: tuple(c.reshape(-1)))
    return tuple(_box(c[0], c[1]) for c in rows)


def _ground(level: Level, low: np.ndarray, high: np.ndarray, cell_m: float) -> Ground | None:
    if not _area(low, high) > 0:
        return None
    ground = sample_ground(level, low=low, high=high, cell_m=cell_m)
    return ground if ground.covered >= _COVERED else None


def _unit_hints(level: Level, settings: Settings) -> tuple[str, ...]:
    if settings.scene.unit_m is not None or len(level.object_box) < _HINT_OBJECTS:
        return ()
    side = level.object_box[:, 1] - level.object_box[:, 0]
    middle = float(np.median(np.sqrt((side * side).sum(1))))
    if middle <= _HINT_SIZE_M:
        return ()
    return (
        f"Half of the objects are larger than {middle:.4g} m. If the file is not in metres, set scene.unit_m: "
        "0.001 for millimetres, 0.01 for centimetres.",
    )


def _axis_hints(level: Level, settings: Settings) -> tuple[str, ...]:
    """Return a hint where the level is a slab that stands on its edge, with ground below it if z is up."""
    low, high = focus_box(level.object_box)
    width, height, depth = (high - low).tolist()
    few = object_counts(level)[1].sum() < _HINT_TRIANGLES
    if few or settings.scene.up is not None or depth > _SLAB * min(width, height):
        return ()
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    turned = replace(level, object_matrix=(turn[:, :, None] * level.object_matrix[:, None]).sum(2))
    measure(turned)
    low, high = focus_box(turned.object_box)
    ground = _ground(
        turned, low, high, _nice(max(math.sqrt(_area(low, high)) / 48, float((high - low).max()) / _COLUMNS))
    )
    if ground is None:
        return ()
    return (
        f"The level is {height:.4g} m high and only {depth:.4g} m deep, and ground lies under {ground.covered:.0%} of it "
        'if z is up: if it lies on its side, set scene.up = "z".',
    )


def _eye(low: np.ndarray, high: np.ndarray) -> tuple[tuple[float, float], str]:
    size = high - low
    if size[1] >= _HUMAN_HEIGHT_M and min(size[0], size[2]) >= _HUMAN_SIDE_M:
        return (EYE_LOW_M, EYE_HIGH_M), ""
    scale = float(size[1]) / 10 / EYE_HIGH_M
    return (
        EYE_LOW_M * scale,
        EYE_HIGH_M * scale,
    ), "; the level is too small for a person, so this is a tenth of its height"


def suggest_budgets(found: Suggestion, level: Level, *, settings: Settings) -> Suggestion:
    """Return `found` with budgets for the level as it is drawn: after it was split."""
    budgets, why = _budgets(level, found.boxes, settings)
    return replace(found, budgets=budgets, budgets_why=why)


def _budgets(level: Level, boxes: tuple[Box, ...], settings: Settings) -> tuple[tuple[str, ...], str]:
    rng = np.random.default_rng(0)
    corners = np.array(boxes)
    size = corners[:, 1] - corners[:, 0]
    weight = np.cumsum((size[:, 0] + 1e-9) * (size[:, 2] + 1e-9))
    at = np.searchsorted(weight, rng.random(_VIEWS) * weight[-1], side="right").clip(0, len(corners) - 1)
    eye = corners[at, 0] + size[at] * rng.random((_VIEWS, 3))
    turn = rng.random(_VIEWS) * (2 * np.pi)
    axis = np.stack([np.cos(turn), np.zeros(_VIEWS), np.sin(turn)], 1)
    camera = settings.camera
    half = math.tan(math.radians(camera.fov_deg) / 2)
    cone = math.atan(half * math.hypot(1.0, camera.width / camera.height))
    middle = level.object_box[:, 0] * 0.5 + level.object_box[:, 1] * 0.5
    side = level.object_box[:, 1] - level.object_box[:, 0]
    radius = np.sqrt((side * side).sum(1)) / 2
    calls_of, triangles_of = object_counts(level)
    calls = triangles = 0
    for e, d in zip(eye, axis):
        to = middle - e
        distance = np.sqrt((to * to).sum(1))
        along = to[:, 0] * d[0] + to[:, 2] * d[2]
        with np.errstate(invalid="ignore", divide="ignore"):
            off = np.arccos(np.clip(along / distance, -1, 1)) - np.arcsin(np.clip(radius / distance, 0, 1))
        seen = (distance <= radius) | (off <= cone)
        calls, triangles = max(calls, int(calls_of[seen].sum())), max(triangles, int(triangles_of[seen].sum()))
    found = (f"{_round(calls * _BUDGET_SHARE)} calls", f"{_round(triangles * _BUDGET_SHARE)} triangles", "16 ms")
    return found, (
        f"two fifths of the fullest of {_VIEWS} sampled views ({calls} calls, {triangles} triangles); "
        "16 ms is a frame at 60 Hz on the device profile"
    )


def object_counts(level: Level) -> tuple[np.ndarray, np.ndarray]:
    """Return draw calls and triangles of each object, (N,) int64."""
    calls, triangles = np.diff(level.mesh_primitive), np.diff(level.mesh_triangles())
    return calls[level.object_mesh].astype(np.int64), triangles[level.object_mesh].astype(np.int64)


def _round(value: float) -> int:
    """Two significant digits, at least 1."""
    digits = 10 ** max(0, math.floor(math.log10(max(value, 1))) - 1)
    return max(1, round(value / digits) * digits)


def _nice(length: float) -> float:
    """The power of two nearest in ratio; 1 where there is no length."""
    return 2.0 ** math.floor(math.log2(length) + 0.5) if length > 0 else 1.0


def _area(low: np.ndarray, high: np.ndarray) -> float:
    size = high - low
    return float(size[0] * size[2])


def _box(low: np.ndarray, high: np.ndarray) -> Box:
    (a, b, c), (d, e, f) = low.tolist(), high.tolist()
    return (a, b, c), (d, e, f)
