"""Made-up placements for tests of the placement database: each stage's output by hand, seeded, self-consistent."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from farfield.bake.model import BakedLayers
from farfield.candidates.model import BOX
from farfield.detail.model import no_levels
from farfield.geometry.cells import build_cells
from farfield.hierarchy.model import Hierarchy
from farfield.placement.model import Placement
from farfield.placementdb.write import build_files
from farfield.rendertime.model import CostModel
from farfield.scene.model import Scene
from farfield.settings import BakeSettings, Settings
from farfield.visibility.model import VisibleSets
from problem_views import views_of
from towns import town

N_INTERVALS = 6 * 8 * 8
LIGHTING = {"ambient": 0.35, "sun": [0.4, 0.8, 0.45]}
TILES = ((40, 60), (17, 33), (64, 64), (9, 100), (130, 24), (5, 5), (1, 1))
WIDE_TILE = (1100, 40)  # larger than a page


def halving(scene: Scene) -> Hierarchy:
    """Return the hierarchy that halves ranges of objects."""
    rows: list[list[int]] = []

    def grow(start: int, stop: int, parent: int) -> int:
        node = len(rows)
        rows.append([start, stop, -1, -1, parent])
        if stop - start > 1:
            middle = (start + stop) // 2
            rows[node][2] = grow(start, middle, node)
            rows[node][3] = grow(middle, stop, node)
        return node

    grow(0, scene.n_objects, -1)
    start, stop, left, right, parent = (np.array(c, dtype=np.int32) for c in zip(*rows, strict=True))
    spans = list(zip(start, stop, strict=True))
    box = np.array([[scene.object_box[a:b, 0].min(0), scene.object_box[a:b, 1].max(0)] for a, b in spans])
    total = lambda column: np.array([column[a:b].sum() for a, b in spans], dtype=np.int64)  # noqa: E731
    return Hierarchy(
        start=start, stop=stop, left=left, right=right, parent=parent, box=box, calls=total(scene.object_calls),
        triangles=total(scene.object_triangles), bytes=total(scene.object_bytes),
        replaceable=np.ones(len(start), dtype=bool),
    )  # fmt: skip


def texels(width: int, height: int, k: int) -> np.ndarray:
    """Return a (height, width, 4) u1 tile: smooth colours, a disc-like cover with holes, depth falling upwards."""
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    rgb = np.stack([(x * 3 + k * 31) % 256, (y * 5 + k * 17) % 256, np.full_like(x, (k * 73) % 256)], axis=-1)
    inside = ((x + 0.5) / width - 0.5) ** 2 + ((y + 0.5) / height - 0.5) ** 2 <= 0.3
    alpha = np.where(inside & ((x // 4 + y // 4 + k) % 7 != 0), 1 + (y * 7 + k) % 252, 0)
    if width * height == 1:
        alpha[:] = 252
    return np.concatenate([rgb, alpha[..., None]], axis=-1).astype(np.uint8)


def octagon(x: float, y: float, width: float, height: float) -> np.ndarray:
    """Return the (8,2) corners of a box with cut corners, counter-clockwise."""
    u, v = width / 4, height / 4
    return np.array([[x + u, y], [x + width - u, y], [x + width, y + v], [x + width, y + height - v],
                     [x + width - u, y + height], [x + u, y + height], [x, y + height - v], [x, y + v]])  # fmt: skip


def layered(scene: Scene, hierarchy: Hierarchy, clusters: np.ndarray, wide: bool) -> BakedLayers:
    """Return one to three layers for each impostor, seen from the middle of the view space."""
    sizes = (*TILES, WIDE_TILE) if wide else TILES
    tiles = [texels(w, h, k) for k, (w, h) in enumerate(sizes)]
    eye = np.tile(scene.view_boxes[0].mean(0) + np.array([0.25, 0.5, -0.125]), (len(clusters), 1))
    centre = hierarchy.box[clusters].mean(1)
    back = eye - centre
    back /= np.sqrt((back * back).sum(1))[:, None]
    right = np.stack([back[:, 2], np.zeros(len(back)), -back[:, 0]], axis=-1)
    right /= np.sqrt((right * right).sum(1))[:, None]
    up = np.cross(back, right)
    layer_row, tile, at, corners, depth = [0], [], [], [], []
    for i in range(len(clusters)):
        for k in range(1 + i % 3):
            t = (i * 3 + k) % len(sizes)
            w, h = sizes[t]
            tile.append(t)
            at.append((3 * i, 2 * k))
            whole = np.array([[0, 0], [w, 0], [w, h], [0, h]], dtype=float)
            shape = (octagon(0, 0, w, h), whole, whole[:3], octagon(-1, 0.5, w + 2, h + 3))[(i + k) % 4]
            corners.append(shape + at[-1])
            depth.append((20.0 + 10 * k, np.inf if k == 2 else 30.0 + 10 * k))
        layer_row.append(len(tile))
    near, far = np.array(depth).reshape(-1, 2).T
    n = len(clusters)
    return BakedLayers(
        eye=eye, right=right, up=up, slope0=np.tile([-0.25, -0.125], (n, 1)), texel=np.full((n, 2), 1 / 512),
        resolution=np.full((n, 2), 256, dtype=np.int32), bytes=5000 + 16 * np.arange(n),
        cost=np.ones(n, dtype=np.int64),
        layer_row=np.array(layer_row), plane=near + 2, near=near, far=far,
        corner_row=np.concatenate([[0], np.cumsum([len(c) for c in corners], dtype=np.int64)]),
        corner=np.concatenate([np.zeros((0, 2)), *corners]), tile=np.array(tile, dtype=np.int32),
        tile_at=np.array(at, dtype=np.int32).reshape(-1, 2), tile_size=np.array(sizes, dtype=np.int32),
        tile_byte=np.concatenate([[0], np.cumsum([t.size for t in tiles], dtype=np.int64)]),
        tile_data=np.concatenate([t.ravel() for t in tiles]), renderer="made up", skipped=(),
    )  # fmt: skip


def made_up(
    *, n_objects: int = 24, n_impostors: int = 9, budget: int = 20, per_frame: int = 3, share: float = 0.02,
    visible: bool = False, detail: bool = False, wide: bool = True, seed: int = 0, view_boxes: np.ndarray | None = None,
    origin_m: tuple[float, float, float] = (160.0, 0.0, -320.0), cell_m: float = 16.0, page_format: str = "webp",
) -> dict[str, Any]:  # fmt: skip
    """Return the arguments of `build_files` by name, for a budget in calls.

    A `share` of all pairs of cell and interval are problem views; a bound is the cost of every object, so that it
    holds wherever the camera is.
    """
    rng = np.random.default_rng(seed)
    scene = town(n_objects, seed=seed, cell_m=cell_m)
    boxes = scene.view_boxes if view_boxes is None else view_boxes
    scene = replace(scene, origin_m=np.array(origin_m), view_boxes=boxes)
    hierarchy = halving(scene)
    model = CostModel(
        unit="calls", budget=budget, per_frame=per_frame, per_call=1.0, per_triangle=0.0, per_pixel=0.0,
        per_impostor=1.0, per_impostor_triangle=0.0, per_impostor_pixel=0.0, object_fixed=scene.object_calls.copy(),
        fov_deg=45.0, width=1280, height=720,
    )  # fmt: skip
    if detail:
        model = replace(model, **some_levels(scene))
    cells = build_cells(scene.view_boxes, cell_m)
    pairs = rng.random((cells.n_cells, N_INTERVALS)) < share
    pairs[cells.n_cells // 3 : cells.n_cells // 2] &= share >= 1  # some cells without any
    cell, interval = (a.astype(np.int32) for a in np.nonzero(pairs))
    n_views = len(cell)
    clusters = np.sort(rng.choice(np.arange(1, len(hierarchy.start)), n_impostors, replace=False)).astype(np.int32)
    served = [_disjoint(rng, hierarchy, clusters) for _ in range(3)] + [np.zeros(0, dtype=np.int32)]
    serve = [served[rng.integers(len(served) if n_views else 1)] for _ in range(n_views)]
    replaced = [int((hierarchy.stop - hierarchy.start)[clusters[s]].sum()) - len(s) for s in serve]
    view_cost = n_objects - np.array(replaced, dtype=np.int64)
    views = replace(
        views_of(cell, interval, [np.arange(n_objects)] * n_views, np.ones((n_views, n_objects), np.int64)),
        cell_cost=np.where(pairs.any(1), n_objects, 0).astype(np.int64), worst_nonproblem=model.target - 1,
    )  # fmt: skip
    baked = layered(scene, hierarchy, clusters, wide)
    hopeless = view_cost > model.target
    view_cell = np.zeros((n_impostors, 9))
    view_cell[:, :6] = np.concatenate([cells.box[0, 0], cells.box[0, 1]])
    n_hopeless = int(hopeless.sum())
    placement = Placement(
        cluster=clusters, kind=np.full(n_impostors, BOX, dtype=np.uint8), view_cell=view_cell, bytes=baked.bytes,
        layers=np.diff(baked.layer_row).astype(np.int32), cost=baked.cost,
        serve_row=np.concatenate([[0], np.cumsum([len(s) for s in serve], dtype=np.int64)]),
        serve=np.concatenate([np.zeros(0, np.int32), *serve]), view_cost=view_cost,
        view_target=np.where(hopeless, view_cost, model.target), view_best=np.where(hopeless, view_cost, 1),
        hopeless=hopeless,
        culprit_row=np.arange(n_hopeless + 1, dtype=np.int64) * 2,
        culprit=np.tile(np.arange(2, dtype=np.int32), n_hopeless),
        smallest_budget=int(view_cost.max(initial=0)) + per_frame,
        curve_budget=np.arange(3), curve_bytes=np.arange(3, 0, -1), curve_over=np.zeros(3, np.int64), stopped=False,
    )  # fmt: skip
    sets = VisibleSets(mode="off", row=np.zeros(0, np.int64), object=np.zeros(0, np.int32))
    if visible:
        some = [np.flatnonzero(rng.random(n_objects) < 0.6) for _ in range(3)]
        lists = [some[c // 2 % 3] for c in range(cells.n_cells)]
        sets = VisibleSets(
            mode="sampled", row=np.concatenate([[0], np.cumsum([len(x) for x in lists])]),
            object=np.concatenate(lists).astype(np.int32),
        )  # fmt: skip
    return {
        "scene": scene, "hierarchy": hierarchy, "model": model, "cells": cells, "visible": sets, "views": views,
        "placement": placement, "baked": baked,
        "settings": Settings(budget=f"{budget} calls", bake=BakeSettings(page_format=page_format)),
        "digests": {"scene": "00" * 32, "scene.glb": "11" * 32}, "lighting": LIGHTING, "threads": 1,
        "levels": None if detail else no_levels(),  # those of `some_levels` are numbers without meshes
    }  # fmt: skip


def some_levels(scene: Scene) -> dict[str, np.ndarray]:
    """Return columns of CostModel: up to three levels an object, from distances within the town, 12 / 2^k triangles."""
    rng = np.random.default_rng(17)
    count = rng.integers(0, 4, scene.n_objects)
    row = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    level = np.concatenate([np.arange(1, n + 1) for n in count])
    return {
        "level_row": row, "level_from": np.concatenate([np.sort(rng.uniform(0, 80, n)) for n in count]),
        "level_fixed": np.ones(row[-1], np.int64), "level_triangles": 12 >> level,
    }  # fmt: skip


def _disjoint(rng: np.random.Generator, hierarchy: Hierarchy, clusters: np.ndarray) -> np.ndarray:
    chosen: list[int] = []
    for i in rng.permutation(len(clusters) - 1):  # the last one is shown nowhere
        a, b = hierarchy.start[clusters[i]], hierarchy.stop[clusters[i]]
        if (
            all(b <= hierarchy.start[clusters[k]] or a >= hierarchy.stop[clusters[k]] for k in chosen)
            and len(chosen) < 5
        ):
            chosen.append(int(i))
    return np.array(sorted(chosen), dtype=np.int32)


def glb(scene: Scene) -> bytes:
    """Return the level as a GLB: a node per object under one that holds origin_m, ids in extras."""
    root = {"children": list(range(1, scene.n_objects + 1)), "translation": scene.origin_m.tolist()}
    nodes: list[dict[str, Any]] = [root]
    for i, matrix in enumerate(scene.object_matrix):
        columns = np.vstack([matrix, [0, 0, 0, 1]]).T.ravel().tolist()
        nodes.append({"mesh": int(scene.object_mesh[i]), "matrix": columns, "extras": {"object": i}})
    positions, indices = scene.position.astype("<f4").tobytes(), scene.index.astype("<u4").tobytes()
    meshes, accessors = [], []
    for p in range(len(scene.primitive_material)):
        first, stop = scene.primitive_triangle[p : p + 2]
        accessors.append({"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": len(scene.position)})
        accessors.append({"bufferView": 1, "byteOffset": int(first) * 12, "componentType": 5125, "type": "SCALAR",
                          "count": int(stop - first) * 3})  # fmt: skip
        meshes.append({"primitives": [{"attributes": {"POSITION": 2 * p}, "indices": 2 * p + 1}]})
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes, "meshes": meshes,
        "accessors": accessors, "buffers": [{"byteLength": len(positions) + len(indices)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(positions)},
                        {"buffer": 0, "byteOffset": len(positions), "byteLength": len(indices)}],
    }  # fmt: skip
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary = positions + indices
    body = len(text).to_bytes(4, "little") + b"JSON" + text + len(binary).to_bytes(4, "little") + b"BIN\0" + binary
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(body)).to_bytes(4, "little") + body


def save(made: dict[str, Any], folder: Path) -> Path:
    """Write what `farfield place` would: placement/ and scene.glb."""
    level = glb(made["scene"])
    made = made | {"digests": {"scene.glb": hashlib.sha256(level).hexdigest()}}
    for name, content in build_files(**made).items():
        (folder / "placement" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "placement" / name).write_bytes(content)
    (folder / "scene.glb").write_bytes(level)
    return folder
