"""Where on a triangle a texel looks, and what the triangle's texture shows there.

Problem  A texel may be recorded although its centre is off the triangle, and a triangle may be seen edge-on or have no
         area at all. Its colour, alpha and depth must still be those of a point of the triangle next to the texel.
Method   The point of the snapped triangle closest to the texel's centre (in the image), as weights of the corners:
         inside from the edge functions, outside along the nearest edge. Never an extrapolation. Weights divided by z
         and normalised are those of the surface (perspective). The point does not depend on the slab.
         Textures: trilinear from the level whose texels are as large as the footprint in the longer direction, as a GPU
         without anisotropic filtering does; the footprint is never taken for larger than the triangle. A sampler that
         magnifies or minifies by the nearest texel does so here.
"""

import math
from typing import Any

import numpy as np
from numba import njit

CLAMP, MIRROR = 33071, 33648  # glTF wrap modes; any other is taken as repeat


@njit(cache=True)
def image_weights(q: Any, cx: float, cy: float, out: Any) -> None:
    """Fill out (3,) f64 with the image weights of the point of triangle q closest to (cx, cy), 1/256 texels."""
    inside, twice = True, 0.0
    for e in range(3):
        f = (e + 1) % 3
        dx, dy = float(q[2 * f] - q[2 * e]), float(q[2 * f + 1] - q[2 * e + 1])
        height = dx * (cy - q[2 * e + 1]) - dy * (cx - q[2 * e])
        inside = inside and height >= 0
        twice += height
        out[(e + 2) % 3] = height
    if inside and twice > 0:
        for c in range(3):
            out[c] /= twice
        return
    nearest = math.inf
    for e in range(3):
        f = (e + 1) % 3
        ex, ey = float(q[2 * f] - q[2 * e]), float(q[2 * f + 1] - q[2 * e + 1])
        px, py = cx - q[2 * e], cy - q[2 * e + 1]
        squared = ex * ex + ey * ey
        t = min(max((px * ex + py * ey) / squared, 0.0), 1.0) if squared > 0 else 0.0
        rx, ry = px - t * ex, py - t * ey
        if rx * rx + ry * ry < nearest:
            nearest = rx * rx + ry * ry
            out[e], out[f], out[(e + 2) % 3] = 1 - t, t, 0.0


@njit(cache=True)
def surface_weights(inverse: Any, image: Any, out: Any) -> float:
    """Fill out (3,) with the weights on the surface of the point with these weights in the image; return its 1 / z."""
    for c in range(3):
        out[c] = image[c] * inverse[c]
    total = out[0] + out[1] + out[2]
    for c in range(3):
        out[c] /= total
    return total


@njit(cache=True)
def footprint(q: Any, inverse: Any, one_over_z: float, uv: Any, u: float, v: float, width: int, height: int) -> float:
    """Return how many texels of the texture's finest level one texel of the impostor spans at (u, v)."""
    reach = 0.0
    for c in range(3):
        d = (c + 1) % 3
        reach = max(reach, math.hypot((uv[c, 0] - uv[d, 0]) * width, (uv[c, 1] - uv[d, 1]) * height))
    twice = float(q[2] - q[0]) * float(q[5] - q[1]) - float(q[4] - q[0]) * float(q[3] - q[1])
    if twice <= 0:
        return reach
    widest = 0.0
    for axis in range(2):
        nu, nv, n = 0.0, 0.0, 0.0
        for e in range(3):
            f, opposite = (e + 1) % 3, (e + 2) % 3
            step = float(q[2 * f] - q[2 * e]) if axis == 1 else -float(q[2 * f + 1] - q[2 * e + 1])
            w = 256 * step / twice * inverse[opposite]
            nu, nv, n = nu + w * uv[opposite, 0], nv + w * uv[opposite, 1], n + w
        du, dv = (nu - u * n) / one_over_z, (nv - v * n) / one_over_z
        widest = max(widest, math.hypot(du * width, dv * height))
    return min(widest, reach)


@njit(cache=True)
def _wrap(i: int, n: int, mode: int) -> int:
    if mode == CLAMP:
        return min(max(i, 0), n - 1)
    if mode == MIRROR:
        i %= 2 * n
        return i if i < n else 2 * n - 1 - i
    return i % n


@njit(cache=True)
def _level(surface: Any, x: int, level: int, u: float, v: float, share: float, mixed: bool, out: Any) -> None:
    w, h = surface.level_size[level, 0], surface.level_size[level, 1]
    start = surface.level_byte[level]
    wrap_s, wrap_t = surface.wrap[x, 0], surface.wrap[x, 1]
    if mixed:
        fx, fy = u * w - 0.5, v * h - 0.5
        ix, iy = math.floor(fx), math.floor(fy)
        fx, fy = fx - ix, fy - iy
        corners = 2
    else:
        ix, iy, fx, fy, corners = math.floor(u * w), math.floor(v * h), 0.0, 0.0, 1
    for b in range(corners):
        for a in range(corners):
            part = share * (fx if a else 1 - fx) * (fy if b else 1 - fy)
            at = start + 4 * (_wrap(int(iy) + b, h, wrap_t) * w + _wrap(int(ix) + a, w, wrap_s))
            for c in range(3):
                out[c] += part * surface.decode[surface.texel[at + c]]
            out[3] += part * (surface.texel[at + 3] / 255.0)


@njit(cache=True)
def texture_at(surface: Any, x: int, u: float, v: float, spans: float, out: Any) -> None:
    """Fill out (4,) with texture x at (u, v), linear RGBA, filtered over `spans` texels of its finest level."""
    out[:] = 0.0
    last = surface.level_row[x + 1] - 1
    level = surface.level_row[x]
    mixed = surface.smooth[x] if spans > 1 else surface.linear[x]
    if not mixed:
        spans *= math.sqrt(2.0)  # the level whose texels are nearest in size, not the finer one
    while spans >= 2 and level < last:
        spans, level = spans / 2, level + 1
    share = math.log2(spans) if mixed and spans > 1 and level < last else 0.0
    _level(surface, x, level, u, v, 1 - share, mixed, out)
    if share > 0:
        _level(surface, x, level + 1, u, v, share, mixed, out)


@njit(cache=True)
def tint(colors: Any, base_color: Any, vertices: Any, weight: Any, material: int, out: Any) -> None:
    """Fill out (up to 4,) with vertex colour times material colour."""
    for c in range(len(out)):
        mixed = 0.0
        for e in range(3):
            mixed += weight[e] * colors[vertices[e], c]
        out[c] = mixed * base_color[material, c]


@njit(cache=True)
def textured(
    sources: Any, surface: Any, coordinates: Any, x: int, s: int, weight: Any, one_over_z: float, detail: float,
    uv: Any, shown: Any,
) -> None:  # fmt: skip
    """Fill shown (4,) with texture x, laid on by `coordinates` (Y,2), at the point of triangle s with these weights."""
    u, v = 0.0, 0.0
    for c in range(3):
        for a in range(2):
            uv[c, a] = coordinates[sources.vertex[s, c], a]
        u, v = u + weight[c] * uv[c, 0], v + weight[c] * uv[c, 1]
    first = surface.level_row[x]
    w, h = surface.level_size[first, 0], surface.level_size[first, 1]
    spans = detail * footprint(sources.snapped[s], sources.inverse[s], one_over_z, uv, u, v, w, h)
    texture_at(surface, x, u, v, spans, shown)


@njit(cache=True)
def color_at(
    sources: Any, surface: Any, s: int, cx: float, cy: float, detail: float, out: Any, uv: Any, shown: Any
) -> float:
    """Fill out (10,): linear RGBA, weights in the image (3), on the surface (3); return 1 / z.

    cx, cy  1/256 texels; detail  size of the sample, in texels of the impostor; uv, shown  (3,2), (4,) scratch
    """
    image, weight = out[4:7], out[7:10]
    image_weights(sources.snapped[s], cx, cy, image)
    one_over_z = surface_weights(sources.inverse[s], image, weight)
    k = sources.material[s]
    x = surface.texture[k]
    tint(surface.color, surface.base_color, sources.vertex[s], weight, k, out[0:4])
    if x >= 0:
        textured(sources, surface, surface.uv, x, s, weight, one_over_z, detail, uv, shown)
        for c in range(4):
            out[c] *= shown[c]
    return one_over_z


@njit(cache=True)
def alpha_at(sources: Any, surface: Any, s: int, i: int, j: int) -> bool:
    """Return whether triangle s, of a masked material, shows at texel (i, j): its alpha reaches the cutoff there.

    Where alpha varies within the texel this may leave out a texel of which a part is opaque, as a GPU does.
    """
    out = np.empty(10)
    color_at(sources, surface, s, 256.0 * i + 128, 256.0 * j + 128, 1.0, out, np.empty((3, 2)), np.empty(4))
    return out[3] >= surface.cutoff[sources.material[s]]
