"""What do visible sets lack? Against item buffers: pictures in which every pixel names its object.

Problem  Visible sets are found by casting rays. What a graphics card shows from fresh random viewpoints is found by
         rasterising the level's file: no ray, no set, no line of code is shared with the stage.
Method   Random positions in the view space under the open sky (a picture straight up shows background in its middle), one
         random level-ish direction each. A pixel whose object is not in the set of the viewpoint's cell is missed.
Errs     Neither way by rule. Viewpoints that are indoors, or under a roof or a bridge, are not asked; of a small part of an
         object that no pixel's centre hits nothing is known.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from farfield.bake.gl.apart import child
from farfield.columns import unpack_dataclass
from farfield.evaluation.proof.draw import Drawer, Window
from farfield.evaluation.proof.level import Level
from farfield.placementdb.read import Placement
from farfield.visibility.model import VisibleSets

SIDE, TRIES = 512, 20  # pixels; positions tried for each view wanted
TAN = math.tan(math.radians(45) / 2)


def missed_apart(folder: Path, sets: list[str], views: int, seed: int) -> Any:
    """As `missed`, in a process of its own for OpenGL."""
    try:
        return child().call("farfield.experiment.item_buffers:missed", str(folder), sets, views, seed)
    finally:
        child().end()


def missed(folder: str, sets: list[str], views: int, seed: int) -> Any:
    """Return for each artifact of stage `visibility` in `sets` what `views` pictures of the level in `folder` show of it.

    {"views", "pixels", "pairs", "found": [{"missed_pixels", "missed_pairs"}, ...], "renderer"}; a pair is an object and the
    cell that it was seen from. Raises NoContext.
    """
    placement = Placement.open(Path(folder) / "placement")
    level = Level(Path(folder) / "scene.glb", placement.index["object_box"], placement.origin_m)
    drawer = Drawer(level, placement, lambda page: np.zeros((1, 1, 4), np.uint8))
    every = np.ones(len(placement.index["object_box"]), bool)
    seen = [unpack_dataclass(VisibleSets, Path(path).read_bytes()) for path in sets]
    rng = np.random.default_rng([seed, 77])
    boxes = np.array(placement.manifest["view_space"], dtype=np.float64)
    weight = np.prod(boxes[:, 1] - boxes[:, 0] + 1e-3, axis=1)
    missing = [{"missed_pixels": 0, "missed_pairs": 0} for _ in seen]
    apart: list[set[tuple[int, int]]] = [set() for _ in seen]
    drawn, pixels = 0, 0
    pairs: set[tuple[int, int]] = set()
    for _ in range(TRIES * views):
        if drawn == views:
            break
        low, high = boxes[rng.choice(len(boxes), p=weight / weight.sum())]
        position = low + (high - low) * rng.random(3)
        turn, tilt = 2 * math.pi * rng.random(), math.radians(30) * (2 * rng.random() - 1)
        if _look(drawer, placement, position, 0.0, math.pi / 2, every, 3)[1, 1] > 0:
            continue
        what = _look(drawer, placement, position, turn, tilt, every, SIDE)
        cell = placement.find_cell(position)
        objects, count = np.unique(what[what > 0] - 1, return_counts=True)
        drawn, pixels = drawn + 1, pixels + what.size
        pairs.update((cell, int(o)) for o in objects)
        for sets_of, found, lacked in zip(seen, missing, apart, strict=True):
            if sets_of.mode == "off":
                continue
            of_cell = sets_of.object[sets_of.row[cell] : sets_of.row[cell + 1]]
            lost = ~np.isin(objects, of_cell)
            found["missed_pixels"] += int(count[lost].sum())
            lacked.update((cell, int(o)) for o in objects[lost])
    for found, lacked in zip(missing, apart, strict=True):
        found["missed_pairs"] = len(lacked)
    return {"views": drawn, "pixels": pixels, "pairs": len(pairs), "found": missing, "renderer": drawer.name}


def _look(
    drawer: Drawer, placement: Placement, position: np.ndarray, turn: float, tilt: float, objects: np.ndarray, side: int
) -> np.ndarray:
    """Return (side, side) i32: object + 1 of every pixel, 0 background."""
    right = np.array([-math.sin(turn), 0.0, math.cos(turn)])
    ahead = np.array([math.cos(turn) * math.cos(tilt), math.sin(tilt), math.sin(turn) * math.cos(tilt)])
    window = Window(
        eye=position - placement.origin_m, frame=np.stack([right, np.cross(right, ahead), ahead]), tan=(TAN, TAN),
        size=(side, side), rect=(0, 0, side, side),
    )  # fmt: skip
    return np.asarray(drawer.draw(window, objects).what)
