"""The output of stage 9."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class BakedLayers:
    """I impostors in L pieces of layers, cropped to what they contain; equal tiles are stored once.

    Pieces of one layer stand together and have one `plane`; they may overlap by a texel, of equal content.

    Frame of an impostor: `eye` is its reference viewpoint; `right`, `up` (unit) span the layer planes; `back` = right x
    up points from the object to the viewer. A point at distance z in front of the eye is eye + z (a right + b up -
    back), (a, b) its slopes. Layer k lies at distance `plane` from the eye (t + s of error-metric.md), its slab is
    [near, far] from the eye. Texel (i, j) of the impostor's grid covers slopes slope0 + [i, i+1) x [j, j+1) * texel.
    A tile holds rows from j low to high (b upwards) of texels x0.. by y0..: RGBA8, straight alpha; RGB is sRGB;
    alpha is 0 where empty, else 4 step + quarters: step 0..62 is the depth from far to near, linear in 1 / distance,
    1 / distance = 1 / far + step / 62 * (1 / near - 1 / far), and quarters 1..4 the share of the texel that is drawn.
    """

    eye: np.ndarray  # (I,3) f64  relative to the scene's origin_m
    right: np.ndarray  # (I,3) f64
    up: np.ndarray  # (I,3) f64
    slope0: np.ndarray  # (I,2) f64  slopes at the low corner of the texel grid
    texel: np.ndarray  # (I,2) f64  slope of one texel (Delta)
    resolution: np.ndarray  # (I,2) i32  texels of the grid
    bytes: np.ndarray  # (I,) i64  measured, additive: 4 a cropped texel + overheads
    cost: np.ndarray  # (I,) i64  measured, from anywhere in its view cell
    layer_row: np.ndarray  # (I+1,) i64  layers of impostor i, near to far; empty ones are dropped
    plane: np.ndarray  # (L,) f64
    near: np.ndarray  # (L,) f64
    far: np.ndarray  # (L,) f64   may be inf
    corner_row: np.ndarray  # (L+1,) i64  3 to 8 corners each, convex, counter-clockwise in (a right, b up)
    corner: np.ndarray  # (Q,2) f64  texel-grid coordinates of the impostor
    tile: np.ndarray  # (L,) i32  texels of the layer
    tile_at: np.ndarray  # (L,2) i32  x0, y0 of the tile in the impostor's grid
    tile_size: np.ndarray  # (W,2) i32  width and height of each distinct tile
    tile_byte: np.ndarray  # (W+1,) i64
    tile_data: np.ndarray  # (D,) u1
    renderer: str  # what recorded it: GL vendor, renderer and version, or "numba"
    skipped: tuple[str, ...]  # what could not be baked, and why
