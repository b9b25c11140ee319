"""Find street positions of a finished placement where impostors cover much of the picture.

Problem  Of all places where a person could stand in the view space, and all directions near level, which views cost
         much as geometry, and what share of the picture's pixels belongs to objects that impostors replace there?
Method   A map from straight above says where the ground lies open (outside houses) and how high it is; eyes stand
         1.65 m over it, at least a metre from a wall. An item buffer (the object of each pixel, OpenGL through EGL)
         of the geometry gives the share. It counts pixels of replaced objects, so the viewer's own count can differ
         by the outlines of impostors only.
"""

import json
import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from farfield.bake.gl.context import context
from farfield.evaluation import kernels
from farfield.evaluation.verify import Eye
from farfield.placementdb.read import Placement

SIZE = (256, 144)  # of the item buffer; the camera's aspect comes from the placement
MAP_M = 0.5
EYE_M = 1.65
CLEAR_M = 1.0
PITCH_DEG = 20.0
NEAR_M, FAR_M = 0.2, 5000.0
_VERTEX = """#version 330
in vec3 position; in float item; uniform mat4 clip; flat out float shown;
void main() { gl_Position = clip * vec4(position, 1); shown = item; }"""
_FRAGMENT = """#version 330
flat in float shown; out float pixel;
void main() { pixel = shown; }"""
_TYPES = {5126: "<f4", 5125: "<u4", 5123: "<u2", 5121: "<u1"}


@dataclass(frozen=True, slots=True, kw_only=True)
class StreetView:
    """One view from a street, and what it costs and shows."""

    position: tuple[float, float, float]  # scene metres
    direction: tuple[float, float, float]
    geometry_cost: int
    cost: int  # of what the placement draws there
    coverage: float  # share of the picture that shows replaced objects


class Streets:
    """The level of a placement folder in OpenGL, and the map of its open ground."""

    def __init__(self, folder: Path, *, ground: str = "Terrain") -> None:
        """`ground` begins the names of the objects that are the ground."""
        self.placement = Placement.open(folder)
        self.eye = Eye(self.placement)
        triangles, item, names = _read_level(folder / "scene.glb")
        self.boxes = np.array(self.placement.manifest["view_space"], dtype=np.float64)
        self.objects = np.arange(len(self.placement.index["object_box"]))
        self._first = np.searchsorted(item, np.arange(len(self.objects) + 1))
        ctx = self._ctx = context()
        self._program = ctx.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
        vertices = np.concatenate([triangles, item[:, None] + 1], 1).astype(np.float32)
        layout = [(ctx.buffer(vertices.tobytes()), "3f 1f", "position", "item")]
        self._level = ctx.vertex_array(self._program, layout)
        self._target = self._make_target(*SIZE)
        low, high = triangles.min(0) - 1, triangles.max(0) + 1
        self._x, self._y, self._z = self._find_streets(low, high, np.array([names[i][: len(ground)] == ground
                                                                            for i in self.objects]))  # fmt: skip

    def sample(self, n: int, *, at_least: int, seed: int = 0, tries: int = 100_000) -> list[StreetView]:
        """Return n random street views (fewer after so many `tries`) whose geometry costs `at_least` that much."""
        rng = np.random.default_rng(seed)
        found: list[StreetView] = []
        for _ in range(tries):
            if len(found) == n:
                break
            k = rng.integers(len(self._x))
            position = np.array([self._x[k], self._y[k] + EYE_M, self._z[k]])
            yaw, pitch = rng.uniform(0, 2 * math.pi), math.radians(rng.uniform(-PITCH_DEG, PITCH_DEG))
            if view := self.look(position, yaw, pitch, at_least):
                found.append(view)
        return found

    def improve(self, view: StreetView, *, at_least: int, seed: int = 0, steps: int = 60) -> StreetView:
        """Return the best of some views near this one: a few metres and degrees away."""
        rng = np.random.default_rng(seed)
        for _ in range(steps):
            x, _, z = view.position
            near = np.flatnonzero(np.maximum(np.abs(self._x - x), np.abs(self._z - z)) <= 8)
            k = rng.choice(near)
            yaw = math.atan2(view.direction[2], view.direction[0]) + rng.normal() * 0.1
            pitch = math.asin(view.direction[1]) + rng.normal() * 0.05
            position = np.array([self._x[k], self._y[k] + EYE_M, self._z[k]])
            other = self.look(position, yaw, pitch, at_least)
            if other and other.coverage > view.coverage and abs(pitch) <= math.radians(PITCH_DEG):
                view = other
        return view

    def look(self, position: np.ndarray, yaw: float, pitch: float, at_least: int) -> StreetView | None:
        """Return the view, or None if the position is outside the view space or its geometry costs less."""
        if not ((self.boxes[:, 0] <= position) & (position <= self.boxes[:, 1])).all(1).any():
            return None
        level = math.cos(pitch)
        direction = np.array([math.cos(yaw) * level, math.sin(pitch), math.sin(yaw) * level])
        share = np.empty(len(self.objects))
        frame = self.eye.frame(direction)
        index = self.placement.index
        kernels.boxes_share(index["object_box"], self.objects, position - self.placement.origin_m, frame, share)
        in_view = np.flatnonzero(share >= 0)
        geometry = int(self.placement.manifest["cost_model"]["per_frame"]) + int(index["object_cost"][in_view].sum())
        if geometry < at_least:
            return None
        shown = self.placement.lookup(position, direction)
        replaced = np.ones(len(self.objects) + 1, dtype=bool)
        replaced[shown.objects] = False
        replaced[-1] = False  # the sky
        pixels = self._item_buffer(position, frame, in_view)
        return StreetView(
            position=tuple(position.tolist()), direction=tuple(direction.tolist()), geometry_cost=geometry,
            cost=self.eye.cost(shown, position, direction)[0], coverage=float(replaced[pixels].mean()),
        )  # fmt: skip

    def _item_buffer(self, position: np.ndarray, frame: np.ndarray, objects: np.ndarray) -> np.ndarray:
        """Return the object of each pixel, -1 for the sky. `frame` is that of `Eye`."""
        clip = np.zeros((4, 4))
        clip[0, :3], clip[1, :3], clip[3, :3] = frame
        clip[2, :3] = frame[2] * (FAR_M + NEAR_M) / (FAR_M - NEAR_M)
        clip[:, 3] = -(clip[:, :3] * position).sum(1)
        clip[2, 3] -= 2 * FAR_M * NEAR_M / (FAR_M - NEAR_M)
        return self._draw(self._target, clip, objects)

    def _find_streets(self, low: np.ndarray, high: np.ndarray, is_ground: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return x, y, z of points of open ground under the view space, CLEAR_M from anything that stands on it."""
        low, high = np.maximum(low, self.boxes[:, 0].min(0) - 9), np.minimum(high, self.boxes[:, 1].max(0) + 9)
        low[1], high[1] = -1e3, 1e3
        wide, deep = (int(x) for x in np.ceil((high - low)[[0, 2]] / MAP_M))
        clip = np.zeros((4, 4))
        for row, axis, sign in ((0, 0, 1), (1, 2, 1), (2, 1, -1)):
            clip[row, axis] = sign * 2 / (high[axis] - low[axis])
            clip[row, 3] = -sign * (high[axis] + low[axis]) / (high[axis] - low[axis])
        clip[3, 3] = 1
        target = self._make_target(wide, deep)
        top = self._draw(target, clip, self.objects)
        depth = np.frombuffer(target.read(components=1, attachment=-1, dtype="f4"), np.float32).reshape(deep, wide)
        for part in (*target.color_attachments, target.depth_attachment, target):
            part.release()
        street = (top >= 0) & is_ground[np.maximum(top, 0)]
        for _ in range(round(CLEAR_M / MAP_M)):
            grown = np.pad(street, 1)
            around = (grown[1:-1, :-2], grown[1:-1, 2:], grown[:-2, 1:-1], grown[2:, 1:-1])
            street = np.logical_and.reduce([street, *around])
        k, i = np.nonzero(street)
        return low[0] + (i + 0.5) * MAP_M, high[1] - depth[k, i] * (high[1] - low[1]), low[2] + (k + 0.5) * MAP_M

    def _make_target(self, width: int, height: int) -> Any:
        ctx = self._ctx
        return ctx.framebuffer([ctx.texture((width, height), 1, dtype="f4")], ctx.depth_texture((width, height)))

    def _draw(self, target: Any, clip: np.ndarray, objects: np.ndarray) -> np.ndarray:
        ctx = self._ctx
        ctx.enable_only(ctx.DEPTH_TEST)
        target.use()
        ctx.viewport = (0, 0, *target.size)
        target.clear()
        self._program["clip"].write(clip.T.astype(np.float32).tobytes())
        cut = np.flatnonzero(np.diff(objects) > 1)
        first, last = self._first[objects[np.r_[0, cut + 1]]], self._first[objects[np.r_[cut, len(objects) - 1]] + 1]
        zero = np.zeros(len(first))
        commands = np.stack([last - first, zero + 1, first, zero, zero], 1).astype(np.uint32)
        buffer = ctx.buffer(commands.tobytes())
        self._level.render_indirect(buffer, count=len(first))
        buffer.release()
        pixels = np.frombuffer(target.read(components=1, dtype="f4"), np.float32)
        return pixels.reshape(target.size[::-1]).astype(np.int64) - 1


def apart(views: list[StreetView], n: int, *, metres: float) -> list[StreetView]:
    """Return the n views of most coverage, none nearer than so many metres to another."""
    chosen: list[StreetView] = []
    for view in sorted(views, key=lambda v: -v.coverage):
        if len(chosen) < n and all(math.dist(view.position, c.position) >= metres for c in chosen):
            chosen.append(view)
    return chosen


def _read_level(path: Path) -> tuple[np.ndarray, np.ndarray, dict[int, str]]:
    """Return triangle corners (T*3,3) f32 in scene metres, the object id of each, ascending, and the objects' names."""
    content = path.read_bytes()
    (length,) = struct.unpack_from("<I", content, 12)
    document, binary = json.loads(content[20 : 20 + length]), content[28 + length :]

    def accessor(number: int, width: int) -> np.ndarray:
        row = document["accessors"][number]
        view = document["bufferViews"][row["bufferView"]]
        dtype = np.dtype(_TYPES[row["componentType"]])
        start, stride = view.get("byteOffset", 0) + row.get("byteOffset", 0), view.get("byteStride")
        strides = (stride or dtype.itemsize * width, dtype.itemsize)
        return np.ndarray((row["count"], width), dtype, binary, offset=start, strides=strides)

    corners, items, names = [], [], {}
    for node in sorted((n for n in document["nodes"] if "mesh" in n), key=lambda n: n["extras"]["object"]):
        assert not {"rotation", "scale", "children"} & set(node), "the demo's nodes are only moved"
        moved = np.array(node.get("translation", (0.0, 0.0, 0.0)))
        if "matrix" in node:
            matrix = np.array(node["matrix"]).reshape(4, 4).T
            assert np.array_equal(matrix[:3, :3], np.eye(3)), "the demo's nodes are only moved"
            moved = matrix[:3, 3]
        names[node["extras"]["object"]] = node["name"]
        for primitive in document["meshes"][node["mesh"]]["primitives"]:
            position = accessor(primitive["attributes"]["POSITION"], 3)
            if "indices" in primitive:
                position = position[accessor(primitive["indices"], 1)[:, 0]]
            corners.append((position + moved).astype(np.float32))
            items.append(np.full(len(position), node["extras"]["object"]))
    return np.concatenate(corners), np.concatenate(items), names
