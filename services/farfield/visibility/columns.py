"""Opaque columns: over which squares of the ground plane, and between which heights, nobody can look through.

Problem  From the solids of a scene make a raster, so that every point over a square, strictly between its heights, is
         inside or on a solid or under the ground. Two walls 0.01 mm apart must leave their squares open, two houses
         that share a wall must not.
Method   Over a padded square only vertical triangles may enter the prism between two heights. Their supporting lines
         cut the square into convex faces; on a face nothing changes, so one point of each decides by counting the
         sloped triangles above it (below it, when the missing cap is above). A column is opaque when each face is
         inside some solid: party walls so do not open it, and a gap is a face that is inside none.
         Where the bottom of a column is under the ground, everything below its top is opaque, for cameras above ground.
Bounds   u = 2**-53, s = side of a square, a power of two times the cell: centres of squares are exact.
         - Lines: two walls make one line iff exactly collinear. Distances of a face's corners from a line round by less
           than 2**-49 of the wall's distance and length (R); within 2**-44 R a corner counts as on the line. Then
           nothing is decided by rounding: on it are a corner where this line meets the corner's two exactly, or one at
           the pad; anything else, and anything nearer than 2**-22 s, leaves the square open. So a gap is closed only if
           it is none.
         - Faces: the point that decides is clear of each line by 2**-43 of all coordinates, else the square is open.
         - Inside: exact signs (`solid_kernels.orient2d`), ties as if the point were moved by (e**2, e).
         - Heights: the plane of a triangle at the square's corners, with the bound of its rounding computed beside it
           (`heights`), no further out than its vertices.
         - Which squares a triangle touches: the pad, 2**-10 s, is larger than any rounding while coordinates stay
           below 2**30 s.
         - Columns are stored in float32, tops rounded down, bottoms up.
Ground   Counts where it is a height field (`solids.py`) and is what people call so: nine of ten objects stand over it
         and reach above it, and no cell lies wholly below it. Points of a cell below it are no camera points; that is
         reported.
"""

from dataclasses import dataclass

import numpy as np

from farfield.geometry.cells import CellTree
from farfield.scene.model import Scene
from farfield.visibility import column_kernels, raster_kernels
from farfield.visibility.solids import Solids

SQUARES_A_CELL = 32
MOST_SQUARES = 1 << 22
LEVELS = 5  # windows of 1 to 16 squares: any rectangle up to 32 squares wide is the union of few of them
_MOST_OUTSIDE = 0.1  # share of objects that do not stand on the ground
_PAD = 2.0**-10


@dataclass(frozen=True, slots=True, kw_only=True)
class Columns:
    """A raster of nx by nz squares from (x0, z0); relative to scene.origin_m.

    Each table holds, for level l, the least value over 2**l by 2**l squares: `raster_kernels.minimum_windows`.
    """

    x0: float
    z0: float
    size: float  # metres
    top: np.ndarray  # (L,nx,nz) f32  top of the opaque column; -inf: none
    bottom: np.ndarray  # (L,nx,nz) f32  minus the bottom of the solid in it
    bottom_on_ground: np.ndarray  # (L,nx,nz) f32  minus the bottom where the ground counts as well: inf if under it
    under: np.ndarray  # (L,nx,nz) f32  height below which ground and solids hide everything, for cameras above ground
    ground: np.ndarray  # (nx,nz) f32  lower bound of the ground; -inf where it is not known
    domain: np.ndarray  # (nx,nz) b1  the ground is a height field over this square
    buried: np.ndarray  # (S,) b1  solids whose cap lies under the ground
    ground_reason: str  # what is taken for the ground, or why nothing is


def build_columns(scene: Scene, cells: CellTree, solids: Solids) -> Columns | None:
    """Return the columns of a scene, or None where no square is opaque."""
    members = np.flatnonzero(solids.solid >= 0).astype(np.int32)
    members = members[np.argsort(solids.solid[members], kind="stable")]  # a square's triangles stand solid by solid
    low, high = solids.vertex[:, [0, 2]].min(0, initial=0.0), solids.vertex[:, [0, 2]].max(0, initial=0.0)
    size = scene.cell_m / SQUARES_A_CELL
    while np.prod(np.floor(high / size) - np.floor(low / size) + 1) > MOST_SQUARES:
        size *= 2
    first = np.floor(low / size)
    nx, nz = (np.floor(high / size) - first + 1).astype(np.int64).tolist()
    x0, z0 = (first * size).tolist()
    pad = size * _PAD
    raster = (x0, z0, size, pad, nx, nz)
    ground_low, ground_high, domain = np.full(nx * nz, np.inf), np.full(nx * nz, -np.inf), np.zeros(nx * nz, np.bool_)
    raster_kernels.ground_heights(solids.vertex, solids.triangle, solids.ground, *raster, ground_low, ground_high)
    raster_kernels.in_domain(solids.domain, x0, z0, size, nx, nz, domain)
    domain &= ground_low < np.inf
    reason = _refuse_ground(scene, cells, solids, raster, ground_low, ground_high, domain)
    if reason is None:
        names = sorted({scene.object_name[o] for o in np.unique(solids.object[solids.ground])[:1]})
        reason = f"ground: {len(solids.ground)} triangles ({names[0]!r:.60} and what continues it)"
    else:
        domain[:] = False
    ground_low[~domain] = -np.inf
    row = np.zeros(nx * nz + 1, dtype=np.int64)
    raster_kernels.touched(solids.vertex, solids.triangle, members, *raster, row, np.zeros(0, np.int32), False)
    row = np.cumsum(row)
    entry = np.empty(int(row[-1]), dtype=np.int32)
    raster_kernels.touched(solids.vertex, solids.triangle, members, *raster, row[:-1].copy(), entry, True)
    bottom, top = np.empty(nx * nz), np.empty(nx * nz)
    column_kernels.opaque_squares(
        solids.vertex, solids.triangle, solids.up, solids.solid, solids.cap_y, solids.culled, row, entry, ground_low,
        *raster, bottom, top,
    )  # fmt: skip
    if not (np.isfinite(top).any() or domain.any()):
        return None
    buried = ~np.isnan(solids.cap_y)
    raster_kernels.bury(row, entry, solids.solid, solids.cap_y, ground_low, buried)
    grounded = bottom <= ground_low

    def table(values: np.ndarray) -> np.ndarray:
        out = np.empty((LEVELS, nx, nz), dtype=np.float32)
        cast = values.astype(np.float32)
        cast = np.where(cast > values, np.nextafter(cast, np.float32(-np.inf)), cast)
        out[0] = cast.reshape(nx, nz)
        raster_kernels.minimum_windows(out)
        return out

    return Columns(
        x0=x0, z0=z0, size=size, top=table(top), bottom=table(-bottom),
        bottom_on_ground=table(np.where(grounded, np.inf, -bottom)),
        under=table(np.where(grounded, np.maximum(top, ground_low), ground_low)),
        ground=ground_low.astype(np.float32).reshape(nx, nz), domain=domain.reshape(nx, nz), buried=buried,
        ground_reason=reason,
    )  # fmt: skip


def _refuse_ground(
    scene: Scene, cells: CellTree, solids: Solids, raster: tuple, low: np.ndarray, high: np.ndarray, domain: np.ndarray
) -> str | None:
    """Return why the candidate is not what cameras stand on, or None."""
    if not len(solids.ground):
        return "no ground: no group of triangles is a closed height field"
    x0, z0, size, _, nx, nz = raster
    middle = (scene.object_box[:, 0] + scene.object_box[:, 1]) / 2
    i = np.floor((middle[:, 0] - x0) / size).astype(np.int64).clip(0, nx - 1)
    k = np.floor((middle[:, 2] - z0) / size).astype(np.int64).clip(0, nz - 1)
    stands = domain[i * nz + k] & (scene.object_box[:, 1, 1] >= low[i * nz + k])
    if (~stands).mean() > _MOST_OUTSIDE:
        return f"no ground: {(~stands).mean():.0%} of the objects do not stand on the only closed height field"
    lows, domains = low.reshape(nx, nz), domain.reshape(nx, nz)
    for cell, box in enumerate(cells.cell_box):
        a = np.floor((box[:, [0, 2]] - (x0, z0)) / size).astype(np.int64)
        part = np.s_[max(a[0, 0], 0) : max(a[1, 0] + 1, 0), max(a[0, 1], 0) : max(a[1, 1] + 1, 0)]
        over = lows[part][domains[part]]
        if len(over) and box[1, 1] <= over.min():
            return f"no ground: cell {cell} lies below the only closed height field"
    return None
