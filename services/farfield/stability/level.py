"""Small made-up levels as GLB files: meshes of triangles, nodes that place them. As wrong as they are told to be."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from farfield.settings import Settings, from_mapping

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])  # fmt: skip
STEP_M = 2.0**-8  # coordinates are odd multiples: sums stay exact in float64, also 2**24 m away
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Level:
    """Boxes (N,2,3) f64 in units of `unit_m`, one object each, and a box in which the camera may be."""

    box: np.ndarray
    view: tuple[Vector, Vector] = ((-24.0, 1.0, -4.0), (-8.0, 2.0, 4.0))
    cell: float = 8.0
    unit_m: float = 1.0
    shift: Vector = (0.0, 0.0, 0.0)
    order: Sequence[int] | None = None  # of the nodes in the file
    faces: np.ndarray | None = None  # (T,3) of every box; None: the twelve of a box, once to three times
    spoil: Any = None  # called with (position (8,3) f32, number of the box); changes it in place
    shared: bool = False  # one mesh for all: the boxes must be alike

    def write(self, path: Path) -> Path:
        """Write the GLB and return its path."""
        content = bytearray()
        views: list[dict[str, Any]] = []
        accessors: list[dict[str, Any]] = []
        meshes: list[dict[str, Any]] = []
        nodes: list[dict[str, Any]] = []

        def add(array: np.ndarray, component: int, kind: str) -> int:
            views.append({"buffer": 0, "byteOffset": len(content), "byteLength": array.nbytes})
            content.extend(array.tobytes() + bytes(-array.nbytes % 4))
            count = len(array) if kind == "VEC3" else array.size
            accessors.append({"bufferView": len(views) - 1, "componentType": component, "type": kind, "count": count})
            return len(accessors) - 1

        for i in self.order if self.order is not None else range(len(self.box)):
            low, high = self.box[i]
            if not (self.shared and meshes):
                position = (CORNERS * (high - low)).astype("<f4")
                if self.spoil is not None:
                    self.spoil(position, i)
                faces = self.faces if self.faces is not None else np.concatenate([FACES] * (1 + int(i) % 3))
                primitive = {
                    "attributes": {"POSITION": add(position, 5126, "VEC3")}, "material": int(i) % 2,
                    "indices": add(np.asarray(faces, "<u2").reshape(-1), 5123, "SCALAR"),
                }  # fmt: skip
                meshes.append({"primitives": [primitive]})
            nodes.append(
                {"name": f"house {i}", "mesh": len(meshes) - 1, "translation": (low + np.array(self.shift)).tolist()}
            )
        materials = [{"pbrMetallicRoughness": {"baseColorFactor": c}} for c in ([0.8, 0.7, 0.6, 1], [0.6, 0.3, 0.2, 1])]
        document = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes,
            "meshes": meshes, "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(content)}],
            "materials": materials,
        }  # fmt: skip
        if not nodes:  # glTF has no empty lists
            document = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{}]}
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        word = lambda n: n.to_bytes(4, "little")  # noqa: E731
        head = b"glTF" + word(2) + word(28 + len(text) + len(content)) + word(len(text)) + b"JSON" + text
        path.write_bytes(head + word(len(content)) + b"BIN\0" + bytes(content))
        return path

    def settings(self, **more: Any) -> Settings:
        """Return settings for the level; keys of `more` are dotted with two underscores."""
        low, high = ([(x + d) * self.unit_m for x, d in zip(p, self.shift, strict=True)] for p in self.view)
        values: dict[str, Any] = {
            "camera": {"width": 320, "height": 180}, "scene": {"unit_m": self.unit_m, "up": "y"},
            "view_space": {"cell_m": self.cell * self.unit_m, "boxes": [[low, high]]}, "visibility": {"mode": "off"},
            "proof": {"mode": "off"}, "placement": {"bound": "off"},
        }  # fmt: skip
        for key, value in more.items():
            *path, last = key.split("__")
            node = values
            for part in path:
                node = node.setdefault(part, {})
            node[last] = value
        return from_mapping(values)

    def mirrored(self, axis: int) -> "Level":
        """Return the level reflected in the plane through the origin across an axis."""
        flip = np.ones(3)
        flip[axis] = -1
        low, high = np.sort(np.array(self.view) * flip, axis=0).tolist()
        return replace(self, box=np.sort(self.box * flip, axis=1), view=(tuple(low), tuple(high)))


def street(n: int = 40, *, seed: int = 0, far: float = 160.0) -> Level:
    """Return houses along x that begin before the view space; no two alike, no corner on a border of cells."""
    rng = np.random.default_rng(seed)
    low = np.stack([rng.uniform(4, far, n), np.zeros(n), rng.uniform(-30, 30, n)], 1)
    size = np.stack([rng.uniform(3, 7, n), rng.uniform(3, 12, n), rng.uniform(3, 7, n)], 1)
    low = _odd_steps(low)
    return Level(np.stack([low, low + _odd_steps(size) + STEP_M], 1))


def _odd_steps(x: np.ndarray) -> np.ndarray:
    return (2 * np.floor(x / (2 * STEP_M)) + 1) * STEP_M
