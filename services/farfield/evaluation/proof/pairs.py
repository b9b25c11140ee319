"""Which impostors to look at, from where: (impostor, viewpoint) pairs drawn at random from where each is shown.

A pair is a problem view that shows the impostor, a position in its cell (one in three on the cell's boundary) and a
direction in its interval, drawn again until the impostor is in the picture. Pair k depends on the seed and k alone.
"""

from dataclasses import dataclass

import numpy as np

from farfield.evaluation.views import direction_in, into
from farfield.placementdb.read import Placement

ATTEMPTS = 24  # to get an impostor into the picture: a problem view's frustum holds more than any picture from it


@dataclass(frozen=True, slots=True)
class Pair:
    impostor: int
    position: np.ndarray  # (3,) f64  scene metres
    direction: np.ndarray  # (3,) f64  unit


class Shown:
    """Where each impostor of a placement is shown."""

    def __init__(self, placement: Placement) -> None:
        self.placement = placement
        impostor, views = [], []
        held: list[np.ndarray] = []
        for k, entry in enumerate(placement.manifest["chunks"]):
            chunk = placement.chunk(k)
            order = np.argsort(chunk["view_list"], kind="stable")
            ends = np.searchsorted(chunk["view_list"][order], np.arange(len(chunk["list_row"])))
            cell = np.searchsorted(chunk["cell_view"], order, side="right") - 1 + entry["cells"][0]
            base = sum(map(len, held))
            held.append(np.stack([cell, chunk["view_interval"][order]], 1))
            of_list = np.repeat(np.arange(len(chunk["list_row"]) - 1), np.diff(chunk["list_row"]))
            impostor.append(chunk["impostor_id"][chunk["list_impostor"]])
            views.append(np.stack([base + ends[of_list], base + ends[of_list + 1]], 1))
        ids = np.concatenate([np.zeros(0, np.int64), *impostor])
        rows = np.concatenate([np.zeros((0, 2), np.int64), *views])
        order = np.argsort(ids, kind="stable")
        self.view = np.concatenate([np.zeros((0, 2), np.int64), *held])  # cell, interval
        self.rows = rows[order]  # ranges of `view`
        self.impostors = np.unique(ids)
        self._start = np.searchsorted(ids[order], self.impostors)
        self._stop = np.searchsorted(ids[order], self.impostors, side="right")

    def pair(self, number: int, seed: int, each: int) -> tuple[Pair, bool]:
        """Return pair `number` and whether its impostor is in the picture.

        each  viewpoints an impostor, impostors in order; 0: impostors at random
        """
        rng = np.random.default_rng([seed, number])
        n = number // each if each else int(rng.integers(len(self.impostors)))
        impostor = int(self.impostors[n])
        rows = self.rows[self._start[n] : self._stop[n]]
        below = np.concatenate([[0], np.cumsum(rows[:, 1] - rows[:, 0])])
        pair = None
        for _ in range(ATTEMPTS):
            k = int(rng.integers(below[-1]))
            row = int(np.searchsorted(below, k, side="right")) - 1
            cell, interval = self.view[rows[row, 0] + k - below[row]]
            pair = Pair(impostor, self._position(rng, int(cell)), self._direction(rng, int(interval)))
            if impostor in self.placement.lookup(pair.position, pair.direction).impostors and rect_of(
                self.placement, pair
            ):
                return pair, True
        assert pair is not None
        return pair, False

    def _position(self, rng: np.random.Generator, cell: int) -> np.ndarray:
        index = self.placement.index
        low, high = index["node_box"][index["cell_node"][cell]] + self.placement.origin_m
        at = rng.random(3)
        if rng.random() < 1 / 3:
            side = rng.integers(0, 3, 3)
            at = np.where(side == 0, 0.0, np.where(side == 1, 1 - 1e-9, at))
        boxes = np.array(self.placement.manifest["view_space"], np.float64)
        return into(boxes, low + (high - low) * at)

    def _direction(self, rng: np.random.Generator, interval: int) -> np.ndarray:
        out = direction_in(self.placement, interval, rng.random(), rng.random())
        return out / np.sqrt((out * out).sum())


def frame_of(direction: np.ndarray) -> np.ndarray:
    """Return (3,3) f64: right, up, forward; no roll."""
    right = np.array([-direction[2], 0.0, direction[0]])
    level = float(np.hypot(right[0], right[2]))
    right = right / level if level > 0 else np.array([1.0, 0.0, 0.0])
    return np.stack([right, np.cross(right, direction), direction])


def tangents(placement: Placement) -> tuple[float, float]:
    """Return the tangents of half the camera's field of view, x and y."""
    camera = placement.manifest["camera"]
    y = float(np.tan(np.radians(camera["fov_deg"]) / 2))
    return y * camera["width"] / camera["height"], y


def rect_of(placement: Placement, pair: Pair) -> tuple[int, int, int, int] | None:
    """Return the pixels (x0, y0, x1, y1) of the picture that may show the impostor's cluster, None if there are none."""
    camera, (tan_x, tan_y) = placement.manifest["camera"], tangents(placement)
    width, height = camera["width"], camera["height"]
    box = placement.index["cluster_box"][placement.index["impostor_cluster"][pair.impostor]] + placement.origin_m
    corner = np.array([[box[(k >> a) & 1, a] for a in range(3)] for k in range(8)]) - pair.position
    frame = frame_of(pair.direction)
    x, y, z = ((corner * axis).sum(1) for axis in frame)
    if (z <= 0).all():
        return None
    if (z <= 1e-6 * np.abs(corner).max()).any():
        return 0, 0, width, height
    a, b = (x / z / tan_x + 1) / 2 * width, (y / z / tan_y + 1) / 2 * height
    x0, x1 = max(int(np.floor(a.min())), 0), min(int(np.ceil(a.max())), width)
    y0, y1 = max(int(np.floor(b.min())), 0), min(int(np.ceil(b.max())), height)
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None
