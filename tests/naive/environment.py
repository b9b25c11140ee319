"""The slow, obvious environment map: which objects are in it, and what of it a ray meets."""

from typing import Any

import numpy as np


def gaps(box: np.ndarray, cell: np.ndarray) -> list[float]:
    """Return how far a box lies beyond each of the six faces of a cell, negative where it does not."""
    return [x for axis in range(3) for x in (box[0, axis] - cell[1, axis], cell[0, axis] - box[1, axis])]


def far_clusters(hierarchy: Any, cell: np.ndarray, far_m: float, reach: float) -> list[tuple[int, int]]:
    """Return (cluster, face) of the largest replaceable clusters that lie beyond and within reach of their face."""

    def fits(c: int) -> int | None:
        box = hierarchy.box[c]
        beyond = gaps(box, cell)
        face = int(np.argmax(beyond))
        if beyond[face] < far_m or not hierarchy.replaceable[c]:
            return None
        aside = [abs(box[end, k] - cell[:, k].mean()) for end in (0, 1) for k in range(3) if k != face // 2]
        return face if max(aside) / beyond[face] <= (reach if hierarchy.left[c] >= 0 else 2 * reach) else None

    def below(c: int) -> list[tuple[int, int]]:
        face = fits(c)
        if face is not None:
            return [(c, face)]
        return below(int(hierarchy.left[c])) + below(int(hierarchy.right[c])) if hierarchy.left[c] >= 0 else []

    return below(0)


def meets_layers(
    placement: Any, pages: list[np.ndarray], impostors: Any, eye: np.ndarray, ray: np.ndarray
) -> np.ndarray:
    """Return (R,) bool: which rays (R,3) from eye, scene metres, meet a texel with content of any layer, exactly there.

    pages  (1024,1024,4) u1 of each page
    """
    met = np.zeros(len(ray), bool)
    aim = ray / np.linalg.norm(ray, axis=1)[:, None]
    for i in impostors:
        layers = placement.impostors[int(i)].layers
        if layers:  # a cone around them, for speed
            point = np.concatenate([layer.corners for layer in layers]) - eye
            point /= np.linalg.norm(point, axis=1)[:, None]
            axis = point.mean(0) / np.linalg.norm(point.mean(0))
            if (aim @ axis).max() < (point @ axis).min() - 0.01:
                continue
        for layer in layers:
            corner, uv = layer.corners, layer.uv.astype(float)
            sides = np.stack([corner[1] - corner[0], corner[2] - corner[0]], 1)
            normal = np.cross(sides[:, 0], sides[:, 1])
            with np.errstate(divide="ignore", invalid="ignore"):
                t = ((corner[0] - eye) @ normal) / (ray @ normal)
            at = np.flatnonzero(~met & (t > 0) & np.isfinite(t))
            inside = eye + t[at, None] * ray[at] - corner[0]
            texel = uv[0] + (inside @ np.linalg.pinv(sides).T) @ np.stack([uv[1] - uv[0], uv[2] - uv[0]])
            x, y, w, h = layer.rect
            within = (texel >= [x, y]).all(1) & (texel < [x + w, y + h]).all(1)
            column, row = np.floor(texel[within]).astype(int).T
            met[at[within]] |= pages[layer.page][row, column, 3] > 0
    return met


def meets_boxes(boxes: np.ndarray, eye: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """Return (R,) bool: which rays meet any of the boxes (K,2,3)."""
    met = np.zeros(len(ray), bool)
    for box in boxes:
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (box[:, None] - eye) / ray
        met |= t.max(0).min(-1) >= np.maximum(t.min(0).max(-1), 0)
    return met
