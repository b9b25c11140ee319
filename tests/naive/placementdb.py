"""The slow, obvious answer of a lookup, from the arrays that went into `build_files`; and the slow mip levels."""

import math
from typing import Any

import numpy as np


def find_cell(made: dict[str, Any], position: np.ndarray) -> int | None:
    """Return the leaf cell by looking at the boxes of all of them."""
    scene, cells = made["scene"], made["cells"]
    boxes = scene.view_boxes
    q = position - scene.origin_m
    if not any(((low <= q) & (q <= high)).all() for low, high in boxes):
        public = boxes + scene.origin_m
        held = [b for b, (low, high) in enumerate(public) if ((low <= position) & (position <= high)).all()]
        if not held:
            return None
        q = np.clip(q, boxes[held[0], 0], boxes[held[0], 1])
    held = [(low, high) for low, high in boxes if ((low <= q) & (q <= high)).all()]
    if not any(((q < high) | (low == high)).all() for low, high in held):
        low, high = held[0]
        q = np.where((q == high) & (low < high), np.nextafter(q, low), q)
    closed = [c for c, (low, high) in enumerate(cells.cell_box) if ((low <= q) & (q <= high)).all()]
    half_open = [
        c for c in closed if ((q < cells.cell_box[c, 1]) | (cells.cell_box[c, 0] == cells.cell_box[c, 1])).all()
    ]
    (cell,) = half_open or closed
    return cell


def find_interval(direction: np.ndarray, n: int = 8) -> int:
    """Return the interval by walking over the tangents of the angles."""
    m = next(k for k in range(3) if abs(direction[k]) == np.abs(direction).max())
    ratio = [direction[(m + k) % 3] / abs(direction[m]) for k in (1, 2)]
    found = []
    for r in ratio:
        k = 0
        while k + 1 < n and r >= _edge(k + 1, n):
            k += 1
        found.append(k)
    return ((2 * m + int(direction[m] < 0)) * n + found[1]) * n + found[0]


def _edge(k: int, n: int) -> float:
    half = n // 2
    return float(np.tan(np.pi / 2 / n * (k - half))) if k > half else -float(np.tan(np.pi / 2 / n * (half - k)))


def lookup(made: dict[str, Any], position: Any, direction: Any) -> dict[str, Any] | None:
    """Return the answer as plain values, or None outside the view space."""
    position, direction = (np.asarray(x, dtype=np.float64) for x in (position, direction))
    views, placement, hierarchy, visible = made["views"], made["placement"], made["hierarchy"], made["visible"]
    cell = find_cell(made, position)
    if cell is None:
        return None
    interval = find_interval(direction)
    match = [v for v in range(len(views.cell)) if views.cell[v] == cell and views.interval[v] == interval]
    view = match[0] if match else None
    shown = [] if view is None else placement.serve[placement.serve_row[view] : placement.serve_row[view + 1]].tolist()
    replaced: set[int] = set()
    for i in shown:
        replaced |= set(range(hierarchy.start[placement.cluster[i]], hierarchy.stop[placement.cluster[i]]))
    seen = range(made["scene"].n_objects)
    if visible.row.size:
        seen = visible.object[visible.row[cell] : visible.row[cell + 1]].tolist()
    objects = [o for o in seen if o not in replaced]
    cost = views.worst_nonproblem if view is None else int(placement.view_cost[view])
    return {
        "cell": cell, "interval": interval, "problem_view": view, "impostors": shown,
        "hopeless": bool(view is not None and placement.hopeless[view]),
        "objects": objects, "levels": [level_of(made, cell, o) for o in objects],
        "cost_bound": cost + made["model"].per_frame,
    }  # fmt: skip


def level_of(made: dict[str, Any], cell: int, o: int) -> int:
    """Return the coarsest level of object o whose distance the cell keeps, by looking at all of them."""
    model, (low, high) = made["model"], made["cells"].cell_box[cell]
    if not len(model.level_row):
        return 0
    box = made["scene"].object_box[o]
    away = [max(box[0, k] - high[k], low[k] - box[1, k], 0.0) for k in range(3)]
    far = model.level_from[model.level_row[o] : model.level_row[o + 1]].tolist()
    return max((k + 1 for k, least in enumerate(far) if math.hypot(*away) >= least), default=0)


def to_linear(byte: float) -> float:
    c = byte / 255
    return c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4


def coarser(texels: np.ndarray, level: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (alpha (h,w) u1, colour (h,w,3) f64 in linear light) of a level of one block, texel by texel."""
    step = 2**level
    rows, columns = -(-texels.shape[0] // step), -(-texels.shape[1] // step)
    alpha, colour = np.zeros((rows, columns), dtype=np.uint8), np.zeros((rows, columns, 3))
    covered = np.zeros((rows, columns), dtype=bool)
    for j, i in np.ndindex(rows, columns):
        under = texels[j * step : (j + 1) * step, i * step : (i + 1) * step].reshape(-1, 4)
        alpha[j, i] = under[:, 3].max()
        covered[j, i] = alpha[j, i] > 0
        if covered[j, i]:
            chosen = under[under[:, 3] > 0]
            colour[j, i] = [np.mean([to_linear(float(x)) for x in chosen[:, k]]) for k in range(3)]
    if level == 0:  # as the bake bled it
        return alpha, np.array([[[to_linear(float(x)) for x in texel[:3]] for texel in row] for row in texels])
    for j, i in np.argwhere(~covered):
        near = np.s_[max(j - 1, 0) : j + 2, max(i - 1, 0) : i + 2]
        if covered[near].any():
            colour[j, i] = colour[near][covered[near]].mean(0)
    return alpha, colour
