"""A closed room of touching blocks around a small view space: whatever a ray from within misses is a crack."""

from pathlib import Path
from typing import Any

import numpy as np
from farfield.settings import Settings, from_mapping
from levels import BOX_CORNERS, BOX_FACES, Gltf

WALL_M = 64.0  # from the middle to the outside of the walls
BLOCKS = 6  # along a wall
REPEATED = 12  # times the faces of a block: triangles are what the budget spends
SETTINGS: dict[str, Any] = {
    "budget": "1500 triangles", "camera": {"width": 120, "height": 72}, "scene": {"unit_m": 1.0, "up": "y"},
    "view_space": {"cell_m": 4.0, "boxes": [[[-2.0, -2.0, -2.0], [2.0, 2.0, 2.0]]], "interval_deg": 22.5},
    "visibility": {"mode": "off"}, "detail": {"mode": "off"},
    "placement": {"candidates": "environment", "far_m": 30.0},
}  # fmt: skip


def blocks(seed: int = 0) -> np.ndarray:
    """Return boxes (N,2,3) of six walls of BLOCKS x BLOCKS blocks, each reaching inwards to a depth of its own.

    Blocks of one wall share their sides from the outside to at least 4 m inside of every inner end; walls overlap at
    the edges: there is no way out.
    """
    rng = np.random.default_rng(seed)
    out = []
    at = np.linspace(-WALL_M, WALL_M, BLOCKS + 1)
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for sign in (-1, 1):
            for i in range(BLOCKS):
                for j in range(BLOCKS):
                    low, high = np.empty(3), np.empty(3)
                    low[u], high[u], low[v], high[v] = at[i], at[i + 1], at[j], at[j + 1]
                    inner = rng.uniform(40, 58)
                    low[axis], high[axis] = sorted((sign * inner, sign * (WALL_M + 4)))
                    out.append((low, high))
    return np.array(out).astype(np.float32).astype(np.float64)


def write_room(path: Path, boxes: np.ndarray) -> Path:
    """Write the room as a GLB, a node a block."""
    level = Gltf()
    for c in ((0.8, 0.7, 0.6, 1), (0.6, 0.3, 0.2, 1), (0.4, 0.5, 0.6, 1)):
        level.add("materials", {"pbrMetallicRoughness": {"baseColorFactor": c}})
    for i, (low, high) in enumerate(boxes):
        position = np.where(BOX_CORNERS > 0, high, low).astype(np.float32)  # no transform: shared corners stay equal
        faces = np.concatenate([BOX_FACES] * REPEATED)
        level.node(name=f"block {i}", mesh=level.mesh(level.primitive(position, faces, material=i % 3)))
    path.write_bytes(level.glb())
    return path


def room_settings() -> Settings:
    """Return settings for the room: a map around the one view cell."""
    return from_mapping(SETTINGS)
