"""The slow, obvious camera: rays through a raster of the screen against boxes and polygons."""

import numpy as np


def rays(direction: np.ndarray, fov_deg: float, width: int, height: int, n: int) -> np.ndarray:
    """Return (n, n, 3) directions of unit depth through the middles of n x n parts of the screen."""
    forward = direction / np.linalg.norm(direction)
    right = np.cross(forward, [0, 1, 0])
    right = right / np.linalg.norm(right)
    up = np.cross(right, forward)
    tan_y = np.tan(np.radians(fov_deg) / 2)
    at = (np.arange(n) + 0.5) / n * 2 - 1
    x, y = np.meshgrid(at * tan_y * width / height, at * tan_y)
    return forward + x[..., None] * right + y[..., None] * up


def box_mask(box: np.ndarray, eye: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """Return which rays from the eye meet the box (slabs)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (box[:, None, None] - eye) / ray
    enter, leave = np.nanmax(t.min(0), axis=-1), np.nanmin(t.max(0), axis=-1)
    return (leave >= np.maximum(enter, 0)).astype(bool)


def box_share(
    box: np.ndarray, eye: np.ndarray, direction: np.ndarray, fov_deg: float, width: int, height: int, n: int = 4000
) -> float:
    """Return the share of the screen of the bounding rectangle of what is seen of a box: 0 if nothing is.

    Its extremes are points of the box's edges, sampled here, or screen corners whose ray meets the box.
    """
    corner = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    pairs = [(a, b) for a in range(8) for b in range(a) if (a ^ b) in (1, 2, 4)]
    t = np.linspace(0, 1, n)[:, None]
    points = np.concatenate([corner[a] * (1 - t) + corner[b] * t for a, b in pairs]) - eye
    forward = direction / np.linalg.norm(direction)
    right = np.cross(forward, [0, 1, 0])
    right = right / np.linalg.norm(right)
    up = np.cross(right, forward)
    tan_y = np.tan(np.radians(fov_deg) / 2)
    tan = np.array([tan_y * width / height, tan_y])
    ahead = points[points @ forward > 0]
    on = np.stack([ahead @ right, ahead @ up], axis=-1) / (ahead @ forward)[:, None] / tan
    screen = np.array([[-1.0, -1], [1, -1], [-1, 1], [1, 1]])
    ray = forward + screen[:, :1] * tan[0] * right + screen[:, 1:] * tan[1] * up
    found = np.concatenate([on[(np.abs(on) <= 1).all(1)], screen[box_mask(box, eye, ray[None])[0]]])
    return float(np.ptp(found, axis=0).prod() / 4) if len(found) else 0.0


def polygon_mask(corners: np.ndarray, eye: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """Return which rays from the eye meet a convex planar polygon."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    t = ((corners[0] - eye) @ normal) / (ray @ normal)
    point = eye + t[..., None] * ray
    side = [np.cross(b - a, point - a) @ normal for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return (t > 0) & (np.all(np.array(side) >= 0, axis=0) | np.all(np.array(side) <= 0, axis=0))
