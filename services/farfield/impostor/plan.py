"""Plan the layers of an impostor: the one function that bounds candidates and that the bake follows.

Problem  A cluster's box and a view cell. Give the reference viewpoint, the texel grid and the layers such that from
         every viewpoint of the view cell no point of the cluster, shown on its layer's plane, is off by more than the
         pixel error, no crack wider than a texel opens between layers, and no texel is magnified beyond a pixel.
Method   `frames.lay_out` in a few frames that face the cluster; the lightest wins, ties to the first.
Errs     Towards more layers and texels.
After    Jeschke and Wimmer 2002 and error-metric.md sections 2 to 8, general form for any convex view cell.
"""

import math
from dataclasses import dataclass

import numpy as np

from farfield.errors import ObjectTouchesViewCell, OutOfDomain
from farfield.impostor import frames
from farfield.impostor.weight import MAX_LAYER_TRIANGLES, MAX_LAYERS, MAX_SIDE, impostor_bytes
from farfield.settings import Settings

__all__ = ["MAX_LAYER_TRIANGLES", "LayerPlan", "Precision", "plan_layers", "precision"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Precision:
    """What the camera and the quality settings ask for: tangents at the cell's nearest plane."""

    delta: float  # slope of the largest texel
    dl: float  # 2 tan(alpha / 2), alpha the admissible parallax


def precision(settings: Settings) -> Precision:
    """Return the texel slope and parallax of the settings: one output pixel, and pixel_error of them (section 1)."""
    camera = settings.camera
    half_y = math.tan(math.radians(camera.fov_deg) / 2)
    half_x = half_y * camera.width / camera.height
    k = 1 + half_x * half_x + half_y * half_y if settings.quality.pixels_at == "anywhere" else 1.0
    delta = 2 * half_y / camera.height / k
    return Precision(delta=delta, dl=settings.quality.pixel_error * delta)


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerPlan:
    """The frame and layers of an impostor, as in `farfield.bake.model.BakedLayers`; distances from the eye.

    A point at distance z in front of the eye is eye + z (a right + b up - back), (a, b) its slopes. Texel (i, j) covers
    slopes slope0 + [i, i + 1) x [j, j + 1) texel. Slabs adjoin, near to far, and cover the cluster's box.
    """

    eye: np.ndarray  # (3,) f64  reference viewpoint
    right: np.ndarray  # (3,) f64  unit
    up: np.ndarray  # (3,) f64  unit
    back: np.ndarray  # (3,) f64  unit, from the object to the viewer: right x up
    slope0: np.ndarray  # (2,) f64
    texel: np.ndarray  # (2,) f64
    resolution: np.ndarray  # (2,) i32  texels that may hold content, >= 4
    plane: np.ndarray  # (K,) f64  near < plane < far, or equal where the cluster is flat
    near: np.ndarray  # (K,) f64
    far: np.ndarray  # (K,) f64  finite
    crop: np.ndarray  # (K,2) i32  upper bound of the columns and rows with content
    depth: float  # from the eye to the view cell's nearest plane (s)

    @property
    def bytes(self) -> int:
        """Upper bound of what the baked impostor weighs."""
        return impostor_bytes(int((self.crop[:, 0].astype(np.int64) * self.crop[:, 1]).sum()), len(self.plane))


def plan_layers(kind: int, view_cell: np.ndarray, cluster_box: np.ndarray, *, settings: Settings) -> LayerPlan:
    """Return the layers of an impostor of a cluster, valid from everywhere in its view cell.

    kind         SHAFT or BOX
    view_cell    (9,) f64, as in `Candidates.view_cell`
    cluster_box  (2,3) f64, finite; both in the same frame and unit

    Raises ObjectTouchesViewCell if no plane across the frame separates the two, OutOfDomain if that takes more than
    MAX_LAYERS layers or MAX_SIDE texels, or if something is not a number.
    """
    cell = np.ascontiguousarray(view_cell, dtype=np.float64).reshape(9)
    box = np.ascontiguousarray(cluster_box, dtype=np.float64).reshape(2, 3)
    if not (np.isfinite(box).all() and (box[0] <= box[1]).all()):
        raise OutOfDomain("the cluster's box must be finite, the lower corner first")
    _check_cell(kind, cell)
    p = precision(settings)
    axes, frame = np.empty((3, 3)), np.empty(10)
    plane, near, far = np.empty(MAX_LAYERS), np.empty(MAX_LAYERS), np.empty(MAX_LAYERS)
    crop = np.empty((MAX_LAYERS, 2))
    is_shaft = kind == frames.SHAFT
    count = frames.lay_out_best(is_shaft, box, cell, p.delta, p.dl, axes, plane, near, far, crop, frame)
    if count == frames.TOO_NEAR:
        raise ObjectTouchesViewCell("the cluster's box touches the view cell")
    if count < 0:
        limit = f"{MAX_LAYERS} layers" if count == frames.TOO_MANY else f"{MAX_SIDE} texels along a side"
        raise OutOfDomain(f"an impostor from there needs more than {limit}")
    s = frame[frames.S]
    middle = (box[0] + box[1]) / 2
    x, y, z = frame[frames.EYE_X], frame[frames.EYE_Y], frame[frames.PLANE_Z] - s
    res = np.array([frame[frames.RES_X], frame[frames.RES_Y]], dtype=np.int32)
    return LayerPlan(
        eye=middle + x * axes[0] + y * axes[1] + z * axes[2], right=axes[0].copy(), up=axes[1].copy(), back=-axes[2],
        slope0=np.array([frame[frames.LOW_X], frame[frames.LOW_Y]]), texel=np.full(2, frame[frames.TEXEL]),
        resolution=res, plane=plane[:count] + s, near=near[:count] + s, far=far[:count] + s,
        crop=crop[:count].astype(np.int32), depth=float(s),
    )  # fmt: skip


def _check_cell(kind: int, cell: np.ndarray) -> None:
    """Raises OutOfDomain."""
    if kind == frames.BOX:
        if not (np.isfinite(cell[:6]).all() and (cell[:3] <= cell[3:6]).all()):
            raise OutOfDomain("a box view cell needs two finite corners, the lower one first")
    elif kind == frames.SHAFT:
        unit = abs(float(cell[3] ** 2 + cell[4] ** 2 + cell[5] ** 2) - 1) < 1e-9
        if not (np.isfinite(cell[:8]).all() and unit and cell[6] >= 0 and 0 <= cell[7] <= cell[8]):
            raise OutOfDomain("a shaft needs a finite apex, a unit axis, a tangent >= 0 and 0 <= near <= far")
    else:
        raise OutOfDomain(f"{kind} is not a kind of view cell")
