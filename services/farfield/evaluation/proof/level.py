"""The level as a graphics card draws it: scene.glb and its own reader's columns, nothing of the bake.

Vertices stay in their meshes; a *row* is one primitive of one object, with its matrix relative to the camera.
"""

import io
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from farfield.errors import ColumnsAltered
from farfield.scene.files import Folder
from farfield.scene.gltf import read_gltf
from farfield.scene.limits import Limits
from farfield.scene.model import BLEND, MASK
from farfield.scene.raw import RawMaterial, RawScene

DOUBLE_SIDED, MASKED, UNLIT, MIRRORED = 1, 2, 4, 8
TEXTURED, GLOWING = 1, 2

ROW = np.dtype([("matrix", "<f4", (3, 4)), ("base", "<f4", 4), ("glow", "<f4", 4), ("what", "<i4", 4)])
COMMAND = np.dtype([("count", "<u4"), ("instances", "<u4"), ("first", "<u4"), ("vertex", "<i4"), ("row", "<u4")])


class Level:
    """What of a level is drawn, without blended materials, which never are in an impostor."""

    def __init__(self, path: Path, object_box: np.ndarray, origin_m: np.ndarray) -> None:
        """object_box (N,2,3) f64 relative to origin_m (3,): that of the placement. Raises ColumnsAltered, SceneError."""
        raw = read_gltf(path.read_bytes(), Folder(path, Limits()), Limits())
        if len(raw.nodes) != len(object_box):
            raise ColumnsAltered(path.name, f"it holds {len(raw.nodes)} objects, the placement {len(object_box)}")
        self.raw = raw
        self.images: dict[int, np.ndarray] = {}
        self._stack(raw)
        self.matrix = np.array([node.matrix[:3] for node in raw.nodes], np.float64).reshape(-1, 3, 4)
        self.matrix[:, :, 3] -= origin_m
        self.mirrored = np.linalg.det(self.matrix[:, :, :3]) < 0
        self._rows(raw)
        for i in range(0, len(raw.nodes), max(1, len(raw.nodes) // 64)):
            corner = self.triangles(np.array([i]), np.zeros(3)).reshape(-1, 3)
            low, high = object_box[i]
            slack = 1e-5 * (1 + float(np.abs(object_box[i]).max()) + float(np.abs(origin_m).max()))
            if len(corner) and ((corner < low - slack) | (corner > high + slack)).any():
                raise ColumnsAltered(path.name, f"object {i} is not where the placement's index has it")

    def _stack(self, raw: RawScene) -> None:
        position, normal, uv, color, index = [], [], [], [], []
        self.part: list[list[tuple[int, int, int, int]]] = []  # of a mesh: first index, count, first vertex, material
        vertices = corners = 0
        for mesh in raw.meshes:
            parts = []
            for p in mesh:
                n = len(p.position)
                base = np.zeros((n, 2), np.float32) if p.uv is None else p.uv
                glow = base if p.emissive_uv is None else p.emissive_uv
                position.append(p.position.astype(np.float32))
                normal.append(np.zeros((n, 3), np.float32) if p.normal is None else p.normal)
                uv.append(np.concatenate([base, glow], 1).astype(np.float32))
                color.append(np.ones((n, 4), np.float32) if p.color is None else p.color)
                index.append(p.index.reshape(-1).astype(np.uint32))
                parts.append((corners, len(index[-1]), vertices, p.material))
                vertices, corners = vertices + n, corners + len(index[-1])
            self.part.append(parts)

        def column(parts: list[np.ndarray], width: int, dtype: Any) -> np.ndarray:
            out = np.zeros((vertices, width), dtype)
            at = 0
            for part in parts:
                out[at : at + len(part), : part.shape[1]] = part
                at += len(part)
            return out

        self.position, self.normal = column(position, 3, np.float32), column(normal, 4, np.float16)
        self.uv, self.color = column(uv, 4, np.float32), column(color, 4, np.float16)
        self.index = np.concatenate(index) if index else np.zeros(0, np.uint32)

    def _rows(self, raw: RawScene) -> None:
        default = RawMaterial(double_sided=raw.default_double_sided)
        found = []
        for o, node in enumerate(raw.nodes):
            for first, count, vertex, k in self.part[node.mesh]:
                m = raw.materials[k] if k >= 0 else default
                if m.alpha_mode != BLEND:
                    found.append((m.texture, m.emissive_texture, o, first, count, vertex, k))
        found.sort()
        n = len(found)
        self.row, self.command = np.zeros(n, ROW), np.zeros(n, COMMAND)
        self.row_object = np.array([f[2] for f in found], np.int64)
        self.row_textures = np.array([f[:2] for f in found], np.int64).reshape(n, 2)
        for r, (texture, glow, o, first, count, vertex, k) in enumerate(found):
            m = raw.materials[k] if k >= 0 else default
            flags = DOUBLE_SIDED * m.double_sided | MASKED * (m.alpha_mode == MASK) | UNLIT * m.unlit
            self.row[r]["base"], self.row[r]["glow"] = m.base_color, (*m.emissive, m.alpha_cutoff)
            self.row[r]["what"] = (
                o, flags | MIRRORED * bool(self.mirrored[o]), TEXTURED * (texture >= 0) | GLOWING * (glow >= 0), 0,
            )  # fmt: skip
            self.command[r] = (count, 1, first, vertex, r)
        self.row["matrix"][:, :, :3] = self.matrix[self.row_object][:, :, :3]

    def triangles(self, objects: np.ndarray, eye: np.ndarray) -> np.ndarray:
        """Return (T,3,3) f32: the corners of these objects' opaque and masked triangles, relative to `eye` (3,) f64,
        which is relative to origin_m."""
        out = []
        for o in objects.tolist():
            m = self.matrix[o]
            for first, count, vertex, k in self.part[self.raw.nodes[o].mesh]:
                if k >= 0 and self.raw.materials[k].alpha_mode == BLEND:
                    continue
                local = self.position[vertex + self.index[first : first + count].astype(np.int64)].astype(np.float64)
                moved = sum(local[:, c, None] * m[:, c] for c in range(3)) + (m[:, 3] - eye)
                out.append(moved.astype(np.float32))
        return np.concatenate(out).reshape(-1, 3, 3) if out else np.zeros((0, 3, 3), np.float32)

    def image(self, texture: int) -> np.ndarray:
        """Return (h,w,4) u1: a texture, decoded."""
        with Image.open(io.BytesIO(self.raw.textures[texture].data)) as image:
            return np.asarray(image.convert("RGBA"))
