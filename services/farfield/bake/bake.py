"""Bake impostors: plan layers, clip, record, shade, crop; in batches that merge to the same bytes however cut.

Problem  Each impostor of a placement becomes textured layers that show its cluster from its whole view cell.
Method   plan -> take (gather, cut, lay out) -> record -> shade -> crop, one impostor at a time. Recording is exact
         in integers (`coverage`), on OpenGL (`gl`) or numba: the same sheet, hence the same tiles, byte for byte.
         Bytes and cost are then measured on what was stored, and never exceed the estimate that chose the impostor.
Renderer "egl" needs a context, "numba" does not; "auto" is egl where a context can be had, else numba. Which it was is
         recorded. On processors alone (llvmpipe, one thread) recording takes 3.5 to 7 times as long as with numba, but
         the whole bake 1.2 (large texel grids) to 2.6 times (60 clusters of a city: 1.5 against 0.6 s): far from any
         limit, so egl stays the default there, too.
"""

import hashlib
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

import numpy as np

from farfield.bake import coverage
from farfield.bake.area import compose, layer_starts, sample
from farfield.bake.beside import mark_beside
from farfield.bake.crop import Cropped, crop
from farfield.bake.gl.context import NoContext
from farfield.bake.model import BakedLayers
from farfield.bake.records import Surface
from farfield.bake.shade import DECODE, ENCODE, LIGHTS
from farfield.bake.textures import Pyramids, decode
from farfield.bake.thin import take
from farfield.candidates.environment import Planner
from farfield.columns import Parts, Walked, dataclass_parts, release
from farfield.hierarchy.model import Hierarchy
from farfield.impostor.kernels import cut_triangles
from farfield.impostor.plan import LayerPlan
from farfield.impostor.weight import impostor_bytes
from farfield.placement.model import Placement
from farfield.rendertime.cost import impostor_cost, pixels_bound_rect
from farfield.rendertime.model import CostModel
from farfield.scene.model import MASK, Scene
from farfield.settings import Settings

Renderer = Literal["egl", "numba", "auto"]
Record = Callable[..., np.ndarray]

MOST_IMPOSTORS = 64  # of a batch
MOST_BYTES = 48 << 20  # estimated, of a batch, unless one impostor alone is heavier


def plan_batches(placement: Placement) -> list[tuple[int, int]]:
    """Return impostor id ranges [a, b) that cover all: at most MOST_IMPOSTORS and MOST_BYTES (estimated) each."""
    batches, start, held = [], 0, 0
    for i, size in enumerate(placement.bytes.tolist()):
        if i > start and (i - start == MOST_IMPOSTORS or held + size > MOST_BYTES):
            batches.append((start, i))
            start, held = i, 0
        held += size
    if start < len(placement.bytes):
        batches.append((start, len(placement.bytes)))
    return batches


@cache
def _gl_recorder(process: int) -> Any:
    # keyed by process: a forked child must not draw with its parent's
    from farfield.bake.gl.record import RecorderApart

    return RecorderApart()


def find_recorder(renderer: Renderer) -> tuple[Record, str]:
    """Return what records sheets in this process, and its name. Raises NoContext for "egl" where there is none."""
    if renderer != "numba":
        try:
            recorder = _gl_recorder(os.getpid())
            return recorder.record, recorder.name
        except NoContext:
            if renderer == "egl":
                raise
    return coverage.record, "numba"


@dataclass
class _Rows:
    """Columns of BakedLayers as they grow."""

    impostor: list[tuple] = field(
        default_factory=list
    )  # eye, right, up, slope0, texel, resolution, bytes, cost, layers
    layer: list[tuple] = field(default_factory=list)  # plane, near, far, corners, tile, at
    tiles: dict[bytes, int] = field(default_factory=dict)
    size: list[tuple[int, int]] = field(default_factory=list)
    data: list[np.ndarray] = field(default_factory=list)

    def add_tile(self, size: tuple[int, int], data: np.ndarray) -> int:
        """Return the id of the tile (width, height; flat bytes), the old one if it is known already."""
        key = hashlib.sha256(np.array(size, "<i4").tobytes() + data.tobytes()).digest()
        if key not in self.tiles:
            self.tiles[key] = len(self.tiles)
            self.size.append(size)
            self.data.append(data)
        return self.tiles[key]

    def build(self, renderer: str, skipped: tuple[str, ...], *, texels: bool = True) -> BakedLayers:
        """texels  False: `tile_data` stays empty, the tiles are `data`"""

        def rows(values: list, width: int, dtype: type) -> np.ndarray:
            return np.array(values, dtype).reshape(-1, width) if values else np.zeros((0, width), dtype)

        i, k = list(zip(*self.impostor)) or [()] * 9, list(zip(*self.layer)) or [()] * 6
        corners = [len(c) for c in k[3]]
        return BakedLayers(
            eye=rows(list(i[0]), 3, np.float64), right=rows(list(i[1]), 3, np.float64),
            up=rows(list(i[2]), 3, np.float64), slope0=rows(list(i[3]), 2, np.float64),
            texel=rows(list(i[4]), 2, np.float64), resolution=rows(list(i[5]), 2, np.int32),
            bytes=np.array(i[6], np.int64), cost=np.array(i[7], np.int64), layer_row=_row(i[8]),
            plane=np.array(k[0], np.float64), near=np.array(k[1], np.float64), far=np.array(k[2], np.float64),
            corner_row=_row(corners), corner=np.concatenate(k[3]) if corners else np.zeros((0, 2)),
            tile=np.array(k[4], np.int32), tile_at=rows(list(k[5]), 2, np.int32),
            tile_size=rows(self.size, 2, np.int32), tile_byte=_row([len(d) for d in self.data]),
            tile_data=np.concatenate(self.data) if self.data and texels else np.zeros(0, np.uint8),
            renderer=renderer, skipped=skipped,
        )  # fmt: skip


def _row(counts: Sequence[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(np.array(counts, np.int64))]).astype(np.int64)


def bake_batch(
    scene: Scene, hierarchy: Hierarchy, model: CostModel, placement: Placement, *, settings: Settings,
    impostors: tuple[int, int], renderer: Renderer = "auto",
) -> BakedLayers:  # fmt: skip
    """Return the baked impostors [a, b) of `placement`, in id order.

    The layers follow `farfield.candidates.environment.Planner` on the placement's view cells. Raises NoContext for renderer
    "egl" without EGL, SceneUnreadable for a texture that does not decode, ImpostorError for a view cell that no
    impostor serves.
    """
    record, name = find_recorder(renderer)
    planner = Planner(hierarchy, settings)
    rows, skipped = _Rows(), []
    ids = range(*impostors)
    spans = [(int(hierarchy.start[c]), int(hierarchy.stop[c])) for c in placement.cluster[list(ids)]]
    pyramids = decode(scene, _materials(scene, spans))
    for i, (a, b) in zip(ids, spans, strict=True):
        cluster, kind, cell = int(placement.cluster[i]), int(placement.kind[i]), placement.view_cell[i]
        plan = planner.plan(kind, cell, cluster)
        skipped += [
            f"{scene.object_name[o]}: blended, left out" for o in range(a, b) if not scene.object_replaceable[o]
        ]
        surface = _surface(scene, (a, b), pyramids)
        sources, pieces, slabs, sheets = take(scene, (a, b), plan, surface, record, kind=kind, view_cell=cell)
        first, texels, triangles, pixels = len(rows.layer), 0, 0, 0.0
        start = layer_starts(slabs)
        rgba, points = np.zeros((int(start[-1]), 4), np.uint8), np.zeros(int(start[-1]), np.uint16)
        for layers, size in sheets:
            sheet = record(sources, pieces, slabs, surface, layers, size)
            sample(sources, pieces, slabs, surface, layers, sheet, start, rgba, points)
        beside = mark_beside(scene, (a, b), hierarchy.box[cluster], plan, slabs, start)
        rgba = compose(slabs, surface, start, rgba, points, beside)
        for k, (width, height) in enumerate(slabs.size.tolist()):
            cropped = _cropped(model, plan, k, rgba[start[k] : start[k + 1]].reshape(height, width, 4))
            for tile, (x, y), corners in cropped:
                low = slabs.low[k].astype(np.int64)
                at = (int(low[0]) + x, int(low[1]) + y)
                size_k = (tile.shape[1], tile.shape[0])
                tile_id = rows.add_tile(size_k, tile.reshape(-1))
                plane = float(plan.plane[k])
                rows.layer.append((plane, float(plan.near[k]), float(plan.far[k]), corners + low, tile_id, at))
                texels += size_k[0] * size_k[1]
                triangles += len(corners) - 2 + cut_triangles(*size_k)
                pixels += layer_pixels(model, plan, k, size_k)
        release(scene.position)  # the other columns of a scene lie in the same file
        rows.impostor.append((
            plan.eye, plan.right, plan.up, plan.slope0, plan.texel, plan.resolution,
            impostor_bytes(texels, len(rows.layer) - first), impostor_cost(model, triangles=triangles, pixels=pixels),
            len(rows.layer) - first,
        ))  # fmt: skip
    return rows.build(name, tuple(skipped))


def _cropped(model: CostModel, plan: LayerPlan, layer: int, rgba: np.ndarray) -> list[Cropped]:
    """Return the pieces of a layer, or the one that holds it all where pieces would cost more to draw than that."""
    pieces = crop(rgba)
    if len(pieces) < 2:
        return pieces
    whole = crop(rgba, 1)

    def cost(found: list[Cropped]) -> tuple[int, float]:
        sizes = [(tile.shape[1], tile.shape[0]) for tile, _, _ in found]
        triangles = sum(cut_triangles(*size) for size in sizes)
        return triangles, sum(layer_pixels(model, plan, layer, size) for size in sizes)

    cut, pixels = cost(pieces)
    most_cut, most_pixels = cost(whole)
    return pieces if cut <= most_cut and pixels <= most_pixels else whole


def layer_pixels(model: CostModel, plan: LayerPlan, layer: int, size: tuple[int, int]) -> float:
    """Return the most pixels that a layer's rectangle of `size` texels covers, from anywhere in the view cell."""
    plane = float(plan.plane[layer])
    return pixels_bound_rect(
        model, width=size[0] * float(plan.texel[0]) * plane, height=size[1] * float(plan.texel[1]) * plane,
        distance=plane - plan.depth,
    )  # fmt: skip


def merge(parts: Sequence[BakedLayers]) -> BakedLayers:
    """Return the batches, given in id order, as one: equal tiles of different batches are stored once.

    The same for every way of cutting the impostors into batches. Renderers that differ are all named, in order.
    """
    rows, names, skipped = _merged(parts)
    return rows.build(names, skipped)


def merge_parts(parts: Sequence[BakedLayers]) -> Parts:
    """Return what `merge` returns, packed: its texels stay in the files that the batches are mapped from, and are read as they
    are written. A city's are a gigabyte."""
    rows, names, skipped = _merged(parts)
    packed = dataclass_parts(rows.build(names, skipped, texels=False), tile_data=rows.data or [np.zeros(0, np.uint8)])
    return Walked(packed, [p.tile_data for p in parts])


def _merged(parts: Sequence[BakedLayers]) -> tuple[_Rows, str, tuple[str, ...]]:
    rows = _Rows()
    names: list[str] = []
    skipped: list[str] = []
    for p in parts:
        tiles = [
            rows.add_tile((int(w), int(h)), p.tile_data[p.tile_byte[t] : p.tile_byte[t + 1]])
            for t, (w, h) in enumerate(p.tile_size)
        ]
        layers = np.diff(p.layer_row).tolist()
        rows.impostor += zip(
            p.eye, p.right, p.up, p.slope0, p.texel, p.resolution, p.bytes, p.cost, layers, strict=True
        )
        corners = np.split(p.corner, p.corner_row[1:-1]) if len(p.plane) else []
        own = [tiles[t] for t in p.tile]
        rows.layer += zip(p.plane, p.near, p.far, corners, own, p.tile_at.tolist(), strict=True)
        names += [n for n in p.renderer.split(" + ") if n not in names]
        skipped += p.skipped
        release(p.tile_data, 0)
    return rows, " + ".join(names), tuple(skipped)


def _materials(scene: Scene, spans: list[tuple[int, int]]) -> np.ndarray:
    """Return the materials that objects of these ranges use."""
    used = np.zeros(scene.n_objects, np.bool_)
    for a, b in spans:
        used[a:b] = True
    primitives = [
        np.arange(scene.mesh_primitive[m], scene.mesh_primitive[m + 1]) for m in np.unique(scene.object_mesh[used])
    ]
    return np.unique(scene.primitive_material[np.concatenate(primitives)] if primitives else np.zeros(0, np.int32))


def _surface(scene: Scene, objects: tuple[int, int], pyramids: Pyramids) -> Surface:
    linear = scene.object_matrix[objects[0] : objects[1], :, :3]
    a, b, c = linear[:, :, 0], linear[:, :, 1], linear[:, :, 2]
    cofactor = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], -1)
    determinant = (a * cofactor[:, :, 0]).sum(-1)
    masked = scene.material_alpha_mode == MASK
    return Surface(
        uv=scene.uv, emissive_uv=scene.emissive_uv if len(scene.emissive_uv) else scene.uv, color=scene.color,
        normal=scene.normal, unlit=scene.material_unlit, emissive_texture=scene.material_emissive_texture,
        turn=np.ascontiguousarray(cofactor * np.where(determinant < 0, -1.0, 1.0)[:, None, None]),
        base_color=scene.material_base_color, emissive=scene.material_emissive, masked=masked,
        double_sided=scene.material_double_sided.astype(np.bool_),
        cutoff=scene.material_alpha_cutoff, texture=scene.material_texture, level_row=pyramids.level_row,
        level_size=pyramids.level_size, level_byte=pyramids.level_byte, texel=pyramids.texel, wrap=scene.texture_wrap,
        linear=scene.texture_linear, smooth=scene.texture_smooth, decode=DECODE, encode=ENCODE, lights=LIGHTS,
    )  # fmt: skip
