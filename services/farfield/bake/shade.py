"""The one lighting model of farfield: impostors are baked with it, the viewer draws geometry with it.

    base   = material base colour * vertex colour * texture                      linear RGB
    light  = ground + (sky - ground) (n.y + 1) / 2 + sun max(0, n . sun_direction)
    colour = encode_srgb(clamp(base * light + emissive))                         nothing depends on the view

n is the interpolated vertex normal in the world, normalised; on the back of a double-sided material it is turned round.
`LIGHTING` goes into the manifest. A wall in the sun gets about 0.9, one in the shade 0.4, a roof 1.05: walls of one
house differ, and little clips.
"""

import math
from typing import Any

import numpy as np
from numba import njit

from farfield.bake.records import Pieces, Slabs, Sources, Surface
from farfield.bake.sample import color_at, image_weights, surface_weights, tint

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
def _encode(thresholds: Any, value: float) -> int:
    """As `encode_srgb`, for one value: a guess from the square root, then steps (twice as fast as a search)."""
    byte = int(min(math.sqrt(max(value, 0.0)) * 255, 255.0))
    while byte < 255 and value >= thresholds[byte]:
        byte += 1
    while byte > 0 and value < thresholds[byte - 1]:
        byte -= 1
    return byte


@njit(cache=True)
def _shade(sources: Any, pieces: Any, slabs: Any, surface: Any, first_layer: int, last_layer: int, sheet: Any,
           rgba: Any) -> None:  # fmt: skip
    out, uv, shown, sums = np.empty(10), np.empty((3, 2)), np.empty(4), np.empty(3)
    n, local = np.empty(3), np.empty(3)
    lights = surface.lights
    # Columns by name: handing whole tuples of arrays to a function costs more than its work (390 -> 100 ns a texel).
    snapped, inverse, vertex, material, away = (
        sources.snapped, sources.inverse, sources.vertex, sources.material, sources.away,
    )  # fmt: skip
    owner, source, texture, tints, base_color = (
        sources.object, pieces.source, surface.texture, surface.color, surface.base_color,
    )  # fmt: skip
    normal, turns, emissive, double_sided, encode = (
        surface.normal, surface.turn, surface.emissive, surface.double_sided, surface.encode,
    )  # fmt: skip
    for k in range(first_layer, last_layer):
        near, far = slabs.inverse_near[k], slabs.inverse_far[k]
        for y in range(slabs.at[k, 1], slabs.at[k, 1] + slabs.size[k, 1]):
            for x in range(slabs.at[k, 0], slabs.at[k, 0] + slabs.size[k, 0]):
                if sheet[y, x] == 0:
                    continue
                s = source[sheet[y, x] - 1]
                cx = 256.0 * (x - slabs.at[k, 0] + slabs.low[k, 0]) + 128
                cy = 256.0 * (y - slabs.at[k, 1] + slabs.low[k, 1]) + 128
                m = material[s]
                image_weights(snapped[s], cx, cy, out[4:7])
                one_over_z = surface_weights(inverse[s], out[4:7], out[7:10])
                w0, w1, w2 = out[7], out[8], out[9]
                if texture[m] >= 0:
                    sums[:] = 0.0
                    for sub in range(4):  # 2 x 2 samples of half a texel each
                        sx, sy = cx + (128 * (sub % 2) - 64), cy + (128 * (sub // 2) - 64)
                        color_at(sources, surface, s, sx, sy, 0.5, out, uv, shown)
                        for c in range(3):
                            sums[c] += out[c] / 4
                else:
                    tint(tints, base_color, vertex[s], out[7:10], m, sums)
                v0, v1, v2 = vertex[s, 0], vertex[s, 1], vertex[s, 2]
                for c in range(3):
                    local[c] = w0 * normal[v0, c] + w1 * normal[v1, c] + w2 * normal[v2, c]
                turn = turns[owner[s]]
                for c in range(3):
                    n[c] = turn[c, 0] * local[0] + turn[c, 1] * local[1] + turn[c, 2] * local[2]
                length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
                if length > 0:
                    length = -length if away[s] and double_sided[m] else length
                    n[0], n[1], n[2] = n[0] / length, n[1] / length, n[2] / length
                sunny = max(n[0] * lights[0, 0] + n[1] * lights[0, 1] + n[2] * lights[0, 2], 0.0)
                for c in range(3):
                    falls = lights[3, c] + (lights[2, c] - lights[3, c]) * ((n[1] + 1) / 2) + lights[1, c] * sunny
                    value = sums[c] * falls + emissive[m, c]
                    rgba[y, x, c] = _encode(encode, value)
                u = (one_over_z - far) / (near - far) if near > far else 1.0
                rgba[y, x, 3] = 1 + math.floor(254 * min(max(u, 0.0), 1.0) + 0.5)


def shade(sources: Sources, pieces: Pieces, slabs: Slabs, surface: Surface, layers: tuple[int, int],
          sheet: np.ndarray) -> np.ndarray:  # fmt: skip
    """Return (height, width, 4) u1: colour and depth of what `sheet` records for layers [a, b); 0 where empty.

    Depth is rounded to the nearest of its 255 steps: the error is at most half a step either way, and the two slabs of
    a border agree on it (255 of the far one and 1 of the near one mean the same distance).
    """
    rgba = np.zeros((*sheet.shape, 4), np.uint8)
    _shade(sources, pieces, slabs, surface, *layers, sheet, rgba)
    return rgba
