"""Judge an impostor in one view: cracks, displacement, difference of the pictures. Numbers in, numbers out; no OpenGL.

Crack         A pixel that the impostor leaves open although it and all pixels within `reach` of it show its geometry;
              `reach` is the pixel error where a pixel is smallest, in the screen's corner: what stays inside a surface
              however its points move by that much must be covered.
Displacement  For each texel of the impostor in the picture: the angle, seen from the viewpoint, between where its centre
              is drawn and the surface that the reference viewpoint sees through it, which a ray tracer finds on the level's
              own triangles in the layer's slab: that at the depth which the texel states, within a step, else the
              nearest; at 16 points of the texel where none lies behind its centre; by the stated depth where only a
              corner of a surface touches it (`open`). In pixels of the screen's centre.
Depth         A texel is `wrong` if its centre sees surfaces, but none at the stated depth, and none (edge-on, say) lies within
              a texel and a step of depth of the point that it states.
Difference    FLIP between the two pictures, antialiased, over the pixels that show the impostor or its geometry.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import minimum_filter

from farfield.evaluation import kernels
from farfield.placementdb.read import Impostor, Layer

SLACK = 1e-3  # of a texel, of the slab: what float32 loses between eye, corner and ray
POINTS = [((i + 0.5) / 4, (j + 0.5) / 4) for j in range(4) for i in range(4)]
SURFACES, STEPS = 8, 1.0  # one behind the other that are asked for; steps of depth that a texel may be off


def inside(solid: np.ndarray, reach: int) -> np.ndarray:
    """Return (h,w) b1: pixels whose neighbours up to `reach` off are all set; none next to the window's border."""
    return np.asarray(minimum_filter(solid.astype(np.uint8), size=2 * reach + 1, mode="constant", cval=0) > 0)


@dataclass(frozen=True, slots=True)
class Moved:
    """Displacement of the texels in one picture, pixels."""

    texels: int
    open: int  # of them: no ray meets a surface; measured by the depth that the texel states
    wrong: int  # of them: no surface lies within a texel and a step of depth of the point that the texel states
    largest: float
    total: float


class Tracer:
    """The triangles of a cluster as the impostor's eye sees them."""

    def __init__(self, corner: np.ndarray) -> None:
        """corner (T,3,3) f32 relative to the eye."""
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._corner = np.ascontiguousarray(corner, np.float64)
        self._scene: Any = EmbreeScene() if len(corner) else None
        if len(corner):
            index = np.arange(3 * len(corner), dtype=np.int32).reshape(-1, 3)
            self._mesh = TriangleMesh(self._scene, np.ascontiguousarray(corner.reshape(-1, 3)), index)

    def hits(self, along: np.ndarray, near: np.ndarray, far: np.ndarray) -> np.ndarray:
        """Return (R,) f64: in multiples of `along` (R,3), the nearest surface within [near, far], NaN if none."""
        out = np.full(len(along), np.nan)
        if self._scene is None or not len(along):
            return out
        start = near * (1 - SLACK * np.minimum(1, (far - near) / near))
        length = np.sqrt((along**2).sum(1))
        found = self._scene.run(
            (along * start[:, None]).astype(np.float32), (along / length[:, None]).astype(np.float32), output=True
        )
        at = start + found["tfar"].astype(np.float64) / length
        hit = (found["primID"] >= 0) & (at <= far + SLACK * (far - near) + 1e-6 * far)
        return np.where(hit, at, out)

    def near(self, point: np.ndarray, limit: np.ndarray) -> np.ndarray:
        """Return (N,) b1: whether a surface lies within limit (N,) of the point (N,3)."""
        found = np.zeros(len(point), bool)
        kernels.surface_within(point, limit, self._corner, found)
        return found


def texel_basis(layer: Layer) -> np.ndarray:
    """Return (3,3) f64: a point of the layer's plane, relative to the eye, is [1, u, v] times this."""
    uv = np.concatenate([np.ones((len(layer.uv), 1)), layer.uv.astype(np.float64)], 1)
    solved = np.linalg.lstsq(uv, layer.position.astype(np.float64), rcond=None)[0]
    return np.asarray(solved)


def displacement(impostor: Impostor, tracer: Tracer, what: np.ndarray, texel: np.ndarray, page: Any,
                 from_eye: np.ndarray, pixel: float) -> Moved:  # fmt: skip
    """Return how far off the texels are that a picture shows.

    what, texel  (h,w) i32 as `Drawn`; page  function from page id to its image; from_eye (3,) f64 viewpoint - eye;
    pixel  tangent of a pixel in the screen's centre
    """
    seen = what < 0
    code = np.unique(np.stack([-1 - what[seen], texel[seen]], 1), axis=0)
    if not len(code):
        return Moved(0, 0, 0, 0.0, 0.0)
    x, y = (code[:, 1] & 0xFFFF).astype(np.float64), (code[:, 1] >> 16).astype(np.float64)
    basis = np.array([texel_basis(layer) for layer in impostor.layers])[code[:, 0]]
    ranges = np.array([(layer.plane, layer.near, layer.far) for layer in impostor.layers])[code[:, 0]]
    plane, near, far = ranges.T
    far = np.where(np.isinf(far), 1e6 * near, far)
    alpha = np.empty(len(code))
    pages = np.array([layer.page for layer in impostor.layers])[code[:, 0]]
    for p in np.unique(pages):
        alpha[pages == p] = page(int(p))[y[pages == p].astype(int), x[pages == p].astype(int), 3]
    step = np.maximum((1 / near - 1 / far) / 62, 1e-9 / near)
    claimed = 1 / far + ((alpha - 1) // 4) * (1 / near - 1 / far) / 62
    angle, found = np.full(len(code), -1.0), np.zeros(len(code), bool)
    wrong = np.zeros(len(code), bool)

    def points(ids: np.ndarray, dx: float, dy: float) -> np.ndarray:
        one = np.stack([np.ones(len(ids)), x[ids] + dx, y[ids] + dy], 1)
        return np.asarray((one[:, :, None] * basis[ids]).sum(1))

    def measure(ids: np.ndarray, drawn: np.ndarray, z: np.ndarray) -> None:
        a, b = drawn - from_eye, drawn * (z / plane[ids])[:, None] - from_eye
        cross = np.cross(a, b)
        apart = np.arctan2(np.sqrt((cross**2).sum(1)), (a * b).sum(1))
        angle[ids] = np.maximum(angle[ids], apart)

    # behind the centre: of several surfaces the one that the texel claims, else the first
    todo, start = np.arange(len(code)), near.copy()
    for _ in range(SURFACES):
        drawn = points(todo, 0.5, 0.5)
        z = tracer.hits(drawn / plane[todo, None], start[todo], far[todo])
        todo, drawn, z = todo[hit := np.isfinite(z)], drawn[hit], z[hit]
        fits = np.abs(1 / z - claimed[todo]) <= STEPS * step[todo]
        use = fits | ~found[todo]
        angle[todo[use]] = -1.0
        measure(todo[use], drawn[use], z[use])
        found[todo], wrong[todo], start[todo] = True, ~fits, z * (1 + 1e-6)
        todo = todo[~fits]
        if not len(todo):
            break
    for dx, dy in POINTS:
        todo = np.flatnonzero(~found)
        drawn = points(todo, dx, dy)
        z = tracer.hits(drawn / plane[todo, None], near[todo], far[todo])
        hit = np.isfinite(z)
        measure(todo[hit], drawn[hit], z[hit])
    still = np.flatnonzero(angle < 0)
    measure(still, points(still, 0.5, 0.5), 1 / claimed[still])
    ids = np.flatnonzero(wrong)  # unless the surface is seen edge-on, or ends within rounding of the centre
    z = 1 / claimed[ids]
    width = np.sqrt((basis[ids, 1:] ** 2).sum((1, 2))) / plane[ids] * z
    wrong[ids] = ~tracer.near(points(ids, 0.5, 0.5) * (z / plane[ids])[:, None], width / 2 + STEPS * z * z * step[ids])
    moved = 2 * np.tan(angle / 2) / pixel
    return Moved(len(code), len(still), int(wrong.sum()), float(moved.max()), float(math.fsum(moved)))


def encoded(linear: np.ndarray) -> np.ndarray:
    """Return sRGB values in [0, 1] (f32) of linear light."""
    c = np.clip(linear, 0, 1)
    return np.where(c <= 0.0031308, 12.92 * c, 1.055 * np.maximum(c, 1e-9) ** (1 / 2.4) - 0.055).astype(np.float32)


def shrunk(color: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Return (h,w,3) f32 sRGB: pixels from 2 x 2 samples (2h,2w,4), background where alpha is 0."""
    full = np.where(color[..., 3:] > 0, color[..., :3].astype(np.float32), background.astype(np.float32))
    return encoded((full[0::2, 0::2] + full[1::2, 0::2] + full[0::2, 1::2] + full[1::2, 1::2]) / 4)


def difference(truth: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Return (h,w) f32: FLIP of two sRGB pictures."""
    import flip_evaluator

    found = flip_evaluator.evaluate(truth, shown, "LDR", applyMagma=False)[0]
    return np.asarray(found, np.float32).reshape(truth.shape[:2])
