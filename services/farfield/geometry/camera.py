"""The camera: vertical field of view, screen size, no roll.

right = normalise(direction x (0, 1, 0)), up = right x direction. Straight up and straight down leave that undefined:
right = (1, 0, 0) there, the limit of a camera that faces -z and pitches (the default camera of OpenGL and three.js).
The test is exact (x and z both zero), so that all readers decide alike; a direction merely near the pole has a heading.
"""

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    fov_deg: float  # vertical, (0, 180)
    width: int  # pixels
    height: int  # pixels

    @property
    def half_tan(self) -> tuple[float, float]:
        """Tangents of half the horizontal and vertical field of view."""
        half_y = math.tan(math.radians(self.fov_deg) / 2)
        return half_y * self.width / self.height, half_y


def camera_frame(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return right, up, forward (3,) f64, orthonormal, for a direction (3,) of any length but 0."""
    x, y, z = (float(c) for c in direction)
    length = math.hypot(x, y, z)
    if not 0 < length < math.inf:
        raise ValueError("a view direction needs a positive, finite length")
    forward = np.array([x / length, y / length, z / length])
    if x == 0 and z == 0:
        right = np.array([1.0, 0.0, 0.0])
    else:
        level = math.hypot(x, z)
        right = np.array([-z / level, 0.0, x / level])
    up = np.array([
        right[1] * forward[2] - right[2] * forward[1],
        right[2] * forward[0] - right[0] * forward[2],
        right[0] * forward[1] - right[1] * forward[0],
    ])  # fmt: skip
    return right, up, forward


def corner_rays(direction: np.ndarray, camera: Camera) -> np.ndarray:
    """Return (4,3) f64: rays through the screen's corners, in order around it, at unit depth (not unit length)."""
    right, up, forward = camera_frame(direction)
    half_x, half_y = camera.half_tan
    return np.array(
        [forward + sx * half_x * right + sy * half_y * up for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    )
