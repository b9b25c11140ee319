"""The one lighting model of farfield: impostors are baked with it, the viewer draws geometry with it.

    base   = material base colour * vertex colour * texture                      linear RGB
    light  = ground + (sky - ground) (n.y + 1) / 2 + sun max(0, n . sun_direction)
    colour = encode_srgb(clamp(base * light + emissive * its texture))           nothing depends on the view

light is 1 for an unlit material.

n is the interpolated vertex normal in the world, normalised; on the back of a double-sided material it is turned round.
`LIGHTING` goes into the manifest. A wall in the sun gets about 0.9, one in the shade 0.4, a roof 1.05: walls of one
house differ, and little clips.
"""

import math
from typing import Any

import numpy as np
from numba import njit

from farfield.bake.sample import color_at, image_weights, surface_weights, textured

# Linear RGB; the direction points to the sun, y up.
LIGHTING: dict[str, tuple[float, float, float]] = {
    "sun_direction": (0.48, 0.64, 0.6),
    "sun": (0.74, 0.70, 0.62),
    "sky": (0.50, 0.56, 0.66),
    "ground": (0.24, 0.22, 0.20),
}

_BYTE = np.arange(256) / 255
DECODE = np.where(_BYTE <= 0.04045, _BYTE / 12.92, ((_BYTE + 0.055) / 1.055) ** 2.4)  # sRGB byte -> linear
_HALF = (np.arange(255) + 0.5) / 255
ENCODE = np.where(_HALF <= 0.04045, _HALF / 12.92, ((_HALF + 0.055) / 1.055) ** 2.4)  # thresholds between bytes
DEPTH_STEPS = 62  # of a slab, in alpha: with four shares of coverage 252 values and 0
LIGHTS = np.array([LIGHTING[k] for k in ("sun_direction", "sun", "sky", "ground")])


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """Return the sRGB bytes (u1) nearest to linear values, clamped to [0, 1]."""
    return np.searchsorted(ENCODE, linear, side="right").astype(np.uint8)


def light(normal: np.ndarray) -> np.ndarray:
    """Return the light (...,3) that falls on unit normals (...,3): the formula above, for readers and tests."""
    sun_direction, sun, sky, ground = LIGHTS
    sunny = np.maximum((normal * sun_direction).sum(-1, keepdims=True), 0.0)
    return ground + (sky - ground) * ((normal[..., 1:2] + 1) / 2) + sun * sunny


@njit(cache=True)
def encode(thresholds: Any, value: float) -> int:
    """As `encode_srgb`, for one value: a guess from the square root, then steps (twice as fast as a search)."""
    byte = int(min(math.sqrt(max(value, 0.0)) * 255, 255.0))
    while byte < 255 and value >= thresholds[byte]:
        byte += 1
    while byte > 0 and value < thresholds[byte - 1]:
        byte -= 1
    return byte


@njit(cache=True)
def shade_at(
    sources: Any, surface: Any, s: int, cx: float, cy: float, detail: float, out: Any, uv: Any, shown: Any, color: Any
) -> None:
    """Fill color (3,) f64 with what shows of triangle s at (cx, cy), 1/256 texels: linear, within [0, 1].

    detail, out, uv, shown as in `color_at`. Outside the triangle it is the point of it closest to (cx, cy).
    """
    one_over_z = color_at(sources, surface, s, cx, cy, detail, out, uv, shown)
    m, lights = sources.material[s], surface.lights
    glow = surface.emissive_texture[m]
    if glow >= 0:
        textured(sources, surface, surface.emissive_uv, glow, s, out[7:10], one_over_z, detail, uv, shown)
    else:
        shown[:] = 1.0
    if surface.unlit[m]:
        for c in range(3):
            color[c] = min(max(out[c] + surface.emissive[m, c] * shown[c], 0.0), 1.0)
        return
    w0, w1, w2 = out[7], out[8], out[9]
    v0, v1, v2 = sources.vertex[s, 0], sources.vertex[s, 1], sources.vertex[s, 2]
    turn = surface.turn[sources.object[s]]
    x = w0 * surface.normal[v0, 0] + w1 * surface.normal[v1, 0] + w2 * surface.normal[v2, 0]
    y = w0 * surface.normal[v0, 1] + w1 * surface.normal[v1, 1] + w2 * surface.normal[v2, 1]
    z = w0 * surface.normal[v0, 2] + w1 * surface.normal[v1, 2] + w2 * surface.normal[v2, 2]
    nx = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z
    ny = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z
    nz = turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if length > 0:
        length = -length if sources.away[s] and surface.double_sided[m] else length
        nx, ny, nz = nx / length, ny / length, nz / length
    sunny = max(nx * lights[0, 0] + ny * lights[0, 1] + nz * lights[0, 2], 0.0)
    for c in range(3):
        falls = lights[3, c] + (lights[2, c] - lights[3, c]) * ((ny + 1) / 2) + lights[1, c] * sunny
        color[c] = min(max(out[c] * falls + surface.emissive[m, c] * shown[c], 0.0), 1.0)


@njit(cache=True)
def depth_code(sources: Any, s: int, cx: float, cy: float, near: float, far: float, out: Any) -> int:
    """Return 1 + the depth, 0 to DEPTH_STEPS from far to near, of the point of triangle s next to (cx, cy).

    Rounded to the nearest step: the error is at most half a step either way, and the two slabs of a border agree on it.
    """
    image_weights(sources.snapped[s], cx, cy, out[4:7])
    one_over_z = surface_weights(sources.inverse[s], out[4:7], out[7:10])
    u = (one_over_z - far) / (near - far) if near > far else 1.0
    return int(1 + math.floor(DEPTH_STEPS * min(max(u, 0.0), 1.0) + 0.5))
