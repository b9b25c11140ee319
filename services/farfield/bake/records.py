"""The arrays that the steps of a bake hand to each other, as named tuples that numba takes as they are.

Units: frame coordinates are metres from the eye (x right, y up, z away from it, z > 0); snapped coordinates are whole
1/256 texels of the impostor's grid, from its low corner.
"""

from typing import NamedTuple

import numpy as np

SNAP = 256  # steps a texel: geometry is rounded once, to these; everything after that is exact on the integers
MAX_SIDE = 8192  # texels of a grid along x or y: products of coordinates of one 256-texel block stay below 2**31


class Sources(NamedTuple):
    """S triangles of the cluster, as the eye sees them; corners run counter-clockwise in snapped coordinates."""

    corner: np.ndarray  # (S,3,3) f64  frame coordinates
    snapped: np.ndarray  # (S,6)  i32  x0 y0 x1 y1 x2 y2
    inverse: np.ndarray  # (S,3)  f64  1 / z
    reciprocal: np.ndarray  # (S,3) f32  1 / squared snapped length of the edge from each corner; 0 for a point
    vertex: np.ndarray  # (S,3)  i32  into the scene's vertex arrays
    material: np.ndarray  # (S,)   i32
    object: np.ndarray  # (S,)   i32  from the cluster's first object
    away: np.ndarray  # (S,)   b1   the eye sees its back, and so does all of the view cell


class Pieces(NamedTuple):
    """F parts of source triangles inside one slab each: triangles, some of them segments or points, near slab first."""

    row: np.ndarray  # (K+1,) i64  pieces of layer k are [row[k], row[k+1])
    snapped: np.ndarray  # (F,6)  i32
    source: np.ndarray  # (F,)   i32


class Slabs(NamedTuple):
    """K slabs; where each layer's texels lie in the sheet that is recorded."""

    inverse_near: np.ndarray  # (K,) f64  1 / near
    inverse_far: np.ndarray  # (K,) f64  1 / far, 0 for infinity
    low: np.ndarray  # (K,2) i32  first texel that holds anything
    size: np.ndarray  # (K,2) i32  texels that may hold anything, 0 for an empty layer
    at: np.ndarray  # (K,2) i32  where `low` lies in the sheet


class Surface(NamedTuple):
    """What colours are made from: columns of the scene, decoded textures, the lighting."""

    uv: np.ndarray  # (Y,2) f32
    emissive_uv: np.ndarray  # (Y,2) f32
    color: np.ndarray  # (Y,4) f32  linear
    normal: np.ndarray  # (Y,3) f32
    turn: np.ndarray  # (n,3,3) f64  normals of each object of the cluster to the world
    base_color: np.ndarray  # (K,4) f32
    emissive: np.ndarray  # (K,3) f32
    unlit: np.ndarray  # (K,) b1
    masked: np.ndarray  # (K,) b1
    double_sided: np.ndarray  # (K,) b1
    cutoff: np.ndarray  # (K,) f32
    texture: np.ndarray  # (K,) i32  -1 none
    emissive_texture: np.ndarray  # (K,) i32  -1 none
    level_row: np.ndarray  # (X+1,) i64  mip levels of texture x are [level_row[x], level_row[x+1]), none if not decoded
    level_size: np.ndarray  # (M,2) i32  width, height
    level_byte: np.ndarray  # (M,) i64  start in `texel`
    texel: np.ndarray  # (D,) u1  RGBA, sRGB colours, rows from v = 0 down
    wrap: np.ndarray  # (X,2) i32  glTF wrap modes
    linear: np.ndarray  # (X,) b1  magnified linearly
    smooth: np.ndarray  # (X,) b1  minified linearly, between levels too
    decode: np.ndarray  # (256,) f64  sRGB byte -> linear
    encode: np.ndarray  # (255,) f64  linear thresholds between sRGB bytes
    lights: np.ndarray  # (4,3) f64  sun direction, sun, sky, ground
