"""Verify a finished placement against random concrete views: what would the viewer draw there, and what does it cost?

Problem  The placement says that no view costs more than the budget outside hopeless problem views. Try to refute it
         with nothing but the files that a viewer reads.
Method   Draw views: positions uniform over the boxes of the view space, directions uniform over the sphere; one in
         eight stands on a face, edge or corner of a cell and looks along edges of the intervals, one in sixteen looks
         close to straight up or down. At each: look up, cull object boxes by clipping them against the view
         pyramid (`kernels`), measure what is left on the screen, and add up by the manifest's cost model.
         Then, where asked, climb from the worst of them towards the worst view of each cell (`climb`).
         Nothing here is shared with the stages that find views and place (an import contract): own clipping, own sum.
Errs     Never downwards: a box that only touches the pyramid is drawn; costs are rounded up once, at the end.
"""

import hashlib
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from farfield.errors import ColumnsAltered
from farfield.evaluation import kernels
from farfield.evaluation.climb import climb
from farfield.evaluation.level import read_boxes, read_levels
from farfield.evaluation.resident import peak_resident
from farfield.evaluation.views import direction_in, into
from farfield.placementdb.read import Lookup, Placement

BOX_TOLERANCE = 1e-9  # of the largest coordinate: what float64 loses between two orders of the same transform


def verify(folder: Path, *, views: int = 1000, seed: int = 0, climbs: int = 0) -> dict[str, Any]:
    """Return what `views` random views of the placement in `folder` (DIR of `farfield place`) cost, as JSON values.

    climbs  in how many cells to climb from the worst view known, the worst cells first; `climb` tells what that found

    over_budget       views over the budget outside hopeless problem views; 0 in a placement that is `valid`
    over_bound        views that cost more than the bound stated for them (hopeless ones included); 0, or a defect
    outside_view_cell impostors shown to a camera outside their view cell; 0, or a defect
    too_coarse        objects drawn at a level whose error is above the pixel error there; 0, or a defect
    resident          what a viewer holds at once in the cell that needs most: `peak_resident`
    worst_ratio       largest cost / budget outside hopeless views; worst_view is where
    These five hold for climbed views, too; `views`, `in_problem_views` and `in_hopeless_views` count random ones only.
    Raises PlacementFileError where a file is missing or damaged, or scene.glb is not the level that was placed.
    """
    placement = Placement.open(folder / "placement")
    files = placement.check()
    check_level(placement, folder / "scene.glb")
    trial = Trial(placement, seed=seed, files=files)
    trial.found["resident"] = peak_resident(placement)
    for position, direction in draw_views(placement, views, seed):
        v = trial.see(position, direction)[1]
        trial.found["views"] += 1
        trial.found["in_problem_views"] += v.problem_view is not None
        trial.found["in_hopeless_views"] += v.hopeless
    if climbs:
        trial.found["climb"] = _climb(trial, climbs)
    return trial.found


class Trial:
    """A placement on trial: every view that is shown to it is counted, and the worst of all and of each cell kept."""

    def __init__(self, placement: Placement, *, seed: int, files: int) -> None:
        manifest = placement.manifest
        self.placement, self.camera, self.seed = placement, Eye(placement), seed
        self.worst: dict[int, tuple[float, np.ndarray, np.ndarray]] = {}  # of a cell: ratio, position, direction
        self.found: dict[str, Any] = {
            "views": 0, "over_budget": 0, "over_bound": 0, "outside_view_cell": 0, "too_coarse": 0,
            "in_problem_views": 0, "in_hopeless_views": 0, "worst_ratio": 0.0, "worst_view": None,
            "worst_hopeless_ratio": None, "files": files, "budget": int(manifest["budget"]["amount"]),
            "unit": manifest["budget"]["unit"], "seed": seed, "verdict": manifest["verdict"],
        }  # fmt: skip

    def see(self, position: np.ndarray, direction: np.ndarray) -> tuple[float | None, Lookup]:
        """Return (cost / budget, None in a hopeless view; what is drawn) of a view, and count it."""
        found, v = self.found, self.placement.lookup(position, direction)
        cost, n_objects = self.camera.cost(v, position, direction)
        ratio = cost / max(found["budget"], 1)
        found["over_bound"] += cost > v.cost_bound
        found["outside_view_cell"] += sum(not self.camera.held(i, position) for i in v.impostors)
        found["too_coarse"] += self.camera.too_coarse(v, position)
        if v.hopeless:
            found["worst_hopeless_ratio"] = max(found["worst_hopeless_ratio"] or 0.0, ratio)
            return None, v
        found["over_budget"] += cost > found["budget"]
        if v.cell not in self.worst or ratio > self.worst[v.cell][0]:
            self.worst[v.cell] = ratio, position, direction
        if ratio > found["worst_ratio"] or found["worst_view"] is None:
            found["worst_ratio"] = ratio
            found["worst_view"] = {
                "position": position.tolist(), "direction": direction.tolist(), "cost": cost, "cell": v.cell,
                "cost_bound": v.cost_bound, "problem_view": v.problem_view, "objects": n_objects,
                "impostors": len(v.impostors),
            }  # fmt: skip
        return ratio, v


def _climb(trial: Trial, most_cells: int) -> dict[str, Any]:
    """Climb in the worst `most_cells` cells; return what that found beside the random views.

    Cells come in the order of their worst random view; then those that no random view fell into, from their middle along
    the interval for which the highest cost is stated.
    """
    placement, by_chance = trial.placement, trial.found["worst_ratio"]
    boxes = np.array(placement.manifest["view_space"], dtype=np.float64)
    cell_boxes = placement.index["node_box"][placement.index["cell_node"]] + placement.origin_m
    for cell in range(len(cell_boxes) if len(trial.worst) < most_cells else 0):
        if cell not in trial.worst:
            direction = _worst_stated(placement, cell)
            if direction is not None:
                trial.see(into(boxes, cell_boxes[cell].mean(0)), direction)
    order = sorted(trial.worst, key=lambda c: (-trial.worst[c][0], c))[:most_cells]
    climbs = []
    for cell in order:
        ratio, position, direction = trial.worst[cell]
        climbs.append(
            climb(
                position, direction, cell_boxes[cell], lambda p, d: trial.see(into(boxes, p), d)[0], start=ratio,
                seed=(trial.seed, cell),
            )
        )  # fmt: skip
    gains = sorted(c.found / c.start for c in climbs if c.start > 0)
    return {
        "cells": len(climbs), "of_cells": len(cell_boxes), "views": sum(c.views for c in climbs),
        "random_worst_ratio": by_chance, "worst_ratio": max((c.found for c in climbs), default=0.0),
        "median_gain": gains[len(gains) // 2] if gains else None, "largest_gain": gains[-1] if gains else None,
    }  # fmt: skip


def _worst_stated(placement: Placement, cell: int) -> np.ndarray | None:
    """Return a direction in the interval whose stated cost is the highest of the cell's that are not hopeless."""
    k = placement.chunk_of(cell)
    if k is None:
        return None
    chunk, local = placement.chunk(k), cell - placement.manifest["chunks"][k]["cells"][0]
    a, b = chunk["cell_view"][local : local + 2]
    cost = np.where(chunk["view_hopeless"][a:b] != 0, -1, chunk["view_cost"][a:b])
    if not len(cost) or cost.max() < 0:
        return None
    return direction_in(placement, int(chunk["view_interval"][a + int(cost.argmax())]))


def merge_found(found: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return one result for several calls of `verify` on the same placement (shards with different seeds)."""
    parts = list(found)
    assert parts
    sums = ("views", "over_budget", "over_bound", "outside_view_cell", "too_coarse", "in_problem_views",
            "in_hopeless_views")  # fmt: skip
    hopeless = [p["worst_hopeless_ratio"] for p in parts if p["worst_hopeless_ratio"] is not None]
    worst = max(parts, key=lambda p: (p["worst_view"] is not None, p["worst_ratio"]))
    return {
        **worst, **{key: sum(p[key] for p in parts) for key in sums}, "seed": min(p["seed"] for p in parts),
        "worst_hopeless_ratio": max(hopeless, default=None),
    }  # fmt: skip


def refuted(found: Mapping[str, Any]) -> bool:
    """Return whether a result of `verify` contradicts what the placement promises."""
    return bool(found["over_budget"] or found["over_bound"] or found["outside_view_cell"] or found["too_coarse"])


class Eye:
    """The placement's camera: exact costs of what the viewer draws."""

    def __init__(self, placement: Placement) -> None:
        manifest, self.placement = placement.manifest, placement
        camera, self.price = manifest["camera"], manifest["cost_model"]
        self.tan_y = math.tan(math.radians(camera["fov_deg"]) / 2)
        self.tan_x = self.tan_y * camera["width"] / camera["height"]
        self.pixels = camera["width"] * camera["height"]
        self._polygons: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def frame(self, direction: np.ndarray) -> np.ndarray:
        """Return (3,3) f64: right / tan_x, up / tan_y, forward; no roll, and -z is up when looking straight down."""
        forward = direction / np.abs(direction).max()
        forward = forward / math.sqrt(float((forward * forward).sum()))
        right = np.array([-forward[2], 0.0, forward[0]])
        level = math.hypot(right[0], right[2])
        right = right / level if level > 0 else np.array([1.0, 0.0, 0.0])
        up = np.cross(right, forward)
        return np.stack([right / self.tan_x, up / self.tan_y, forward])

    def cost(self, v: Lookup, position: np.ndarray, direction: np.ndarray) -> tuple[int, int]:
        """Return (cost of the frame, objects drawn) of a lookup, in the budget's unit, per_frame included."""
        index, price = self.placement.index, self.price
        eye, frame = position - self.placement.origin_m, self.frame(direction)
        share = np.empty(len(v.objects))
        kernels.boxes_share(index["object_box"], v.objects, eye, frame, share)
        drawn = share >= 0
        cost = int(price["per_frame"]) + self.geometry_cost(v.objects[drawn], v.levels[drawn])
        cost += len(v.impostors) * price["per_impostor"]
        cost += price["per_impostor_triangle"] * int(index["impostor_triangles"][v.impostors].sum())
        cost += price["per_pixel"] * self.pixels * math.fsum(share[drawn])
        if price["per_impostor_pixel"] > 0:
            shares = [kernels.polygons_share(*self.polygons(int(i)), eye, frame) for i in v.impostors]
            cost += price["per_impostor_pixel"] * self.pixels * math.fsum(shares)
        return math.ceil(cost), int(drawn.sum())

    def geometry_cost(self, objects: np.ndarray, levels: np.ndarray) -> int:
        """Return what objects (n,) cost without their pixels at levels (n,), 0 the object itself."""
        return int(self.geometry_costs(objects, levels).sum())

    def geometry_costs(self, objects: np.ndarray, levels: np.ndarray) -> np.ndarray:
        """Return the same of each, (n,) i64."""
        index = self.placement.index
        cost = index["object_cost"][objects].astype(np.int64)
        if levels.any():
            coarse = np.flatnonzero(levels)
            cost[coarse] = index["level_cost"][index["level_row"][objects[coarse]] + levels[coarse] - 1]
        return cost

    def too_coarse(self, v: Lookup, position: np.ndarray) -> int:
        """Return how many objects of a lookup are nearer to the position than their level allows (float64 slack)."""
        if not v.levels.any():
            return 0
        index, some = self.placement.index, np.flatnonzero(v.levels)
        box, q = index["object_box"][v.objects[some]], position - self.placement.origin_m
        away = np.abs(q - np.clip(q, box[:, 0], box[:, 1]))
        least = index["level_from"][index["level_row"][v.objects[some]] + v.levels[some] - 1]
        slack = 1e-9 * (1 + float(np.abs(position).max()))
        return int(((away**2).sum(1) < np.maximum(least - slack, 0) ** 2).sum())

    def polygons(self, impostor: int) -> tuple[np.ndarray, np.ndarray]:
        """Return (corners (Q,3) f64 relative to origin_m, CSR rows) of all layers of an impostor."""
        if impostor not in self._polygons:
            layers = self.placement.impostors[impostor].layers
            corners = [layer.corners - self.placement.origin_m for layer in layers]
            row = np.cumsum([0, *(len(c) for c in corners)])
            self._polygons[impostor] = np.concatenate([np.zeros((0, 3)), *corners]), row
        return self._polygons[impostor]

    def held(self, impostor: int, position: np.ndarray) -> bool:
        """Return whether the impostor is valid from the position: whether its view cell holds it (float64 slack)."""
        cell = self.placement.index["impostor_view_cell"][impostor]
        q = position - self.placement.origin_m
        slack = 1e-9 * (1 + float(np.abs(cell[:6]).max()) + float(np.abs(position).max()))
        if self.placement.index["impostor_kind"][impostor] == 1:
            return bool(((cell[:3] - slack <= q) & (q <= cell[3:6] + slack)).all())
        apex, axis, (tangent, near, far) = cell[:3], cell[3:6], cell[6:].tolist()
        along = float(((q - apex) * axis).sum())
        across = math.sqrt(float(((q - apex - along * axis) ** 2).sum()))
        return near - slack <= along <= far + slack and across <= tangent * along + slack * (1 + tangent)


def draw_views(placement: Placement, n: int, seed: int) -> Iterable[tuple[np.ndarray, np.ndarray]]:
    """Yield n positions (3, scene metres) and directions (3, unit), see the module's head. Overlaps count twice."""
    rng = np.random.default_rng(seed)
    boxes = np.array(placement.manifest["view_space"], dtype=np.float64)
    size = boxes[:, 1] - boxes[:, 0]
    weight = np.prod(size + 1e-3, axis=1)  # a millimetre keeps flat boxes in
    of_box = rng.choice(len(boxes), size=n, p=weight / weight.sum())
    cells = placement.index["node_box"][placement.index["cell_node"]] + placement.origin_m
    edges = np.array(placement.manifest["interval_edges"])
    for k in range(n):
        low, high = boxes[of_box[k]]
        position = low + (high - low) * rng.random(3)
        direction = rng.normal(size=3)
        if k % 8 == 7:
            inner_low, inner_high = cells[rng.integers(len(cells))]
            side = rng.integers(0, 3, 3)  # low, high, or between, on each axis
            inside = inner_low + (inner_high - inner_low) * rng.random(3)
            position = np.select([side == 0, side == 1], [inner_low, inner_high], inside)
            position = into(boxes, position)
            m = rng.integers(3)
            direction = rng.choice(edges, 3)
            direction[m] = rng.choice([-1.0, 1.0])
        elif k % 16 == 3:
            direction[[0, 2]] *= 10.0 ** -rng.uniform(1, 9)
            direction[1] = math.copysign(1.0, direction[1])
        yield position, direction / math.sqrt(float((direction * direction).sum()))


def check_level(placement: Placement, path: Path) -> None:
    """Refuse a scene.glb that is not the level that was placed: by digest where stated, and by its objects' boxes."""
    boxes, levels = read_boxes(path), read_levels(path)
    stated = placement.manifest.get("scene")
    with path.open("rb") as file:
        if stated and hashlib.file_digest(file, "sha256").hexdigest() != stated["sha256"]:
            raise ColumnsAltered(path.name, "its SHA-256 is not what the placement's manifest states")
    index = placement.index["object_box"] + placement.origin_m
    if sorted(boxes) != list(range(len(index))):
        raise ColumnsAltered(path.name, f"it holds {len(boxes)} objects where the placement has {len(index)}")
    row = placement.index.get("level_row", np.zeros(len(index) + 1, np.int64))
    of_levels = placement.index.get("level_triangles", row)
    for i in range(len(index)):
        if levels.get(i, []) != of_levels[row[i] : row[i + 1]].tolist():
            raise ColumnsAltered(path.name, f"the levels of object {i} are not those of the placement's index")
    for i, box in enumerate(index):
        slack = BOX_TOLERANCE * (1 + float(np.abs(box).max()) + float(np.abs(placement.origin_m).max()))
        if not np.allclose(boxes[i], box, rtol=0, atol=slack):
            raise ColumnsAltered(path.name, f"object {i} is not where the placement's index has it")
