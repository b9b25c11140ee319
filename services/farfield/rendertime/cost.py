"""Build the cost model, and bound what objects and impostors cost from anywhere in a view cell.

Problem  A problem view is a cell and an interval, not a camera: what an object costs there must hold for every camera
         position in the cell and every direction, and must not depend on summation order.
Method   cost = fixed part + ceil(per_pixel * bound on covered pixels). Everything an object shows of itself lies no
         nearer than its box's distance d from the cell; with the box's diagonal D, two points of it are seen under at
         most phi = 2 atan(D / 2d), because the box lies behind a plane at d. On a screen with half tangents t_x, t_y
         and f pixels to the unit tangent, moving by phi moves a pixel by at most
             x: f phi sqrt((1 + t_x^2) (1 + t_x^2 + t_y^2))        y: the same with t_y first
         (the gradient of X/Z over the unit sphere, largest in the screen's corner: the stretch of wide angles).
         Costs are integers, each rounded up: sums are exact in any order.
Errs     upwards only. An object that touches the cell covers the screen.
After    Wimmer and Wonka. Rendering Time Estimation for Real-Time Rendering. EGSR 2003.
"""

import math

import numpy as np

from farfield.detail.distances import stretch
from farfield.detail.model import Levels
from farfield.errors import SettingsInvalid
from farfield.rendertime import kernels
from farfield.rendertime.model import CostModel
from farfield.rendertime.profiles import find_profile
from farfield.scene.model import Scene
from farfield.settings import Settings, parse_budget

MARGIN = 1 + 1e-9  # float64 error of bound and of any exact measure it is compared with, relative to the bound


def prices(settings: Settings) -> tuple[float, float]:
    """Return what a draw call and a triangle cost in the budget's unit. Raises SettingsInvalid for an unknown device."""
    unit, profile = parse_budget(settings.budget).unit, find_profile(settings)
    if unit == "ns":
        return profile.per_call_ns, profile.per_triangle_ns
    return (1.0, 0.0) if unit == "calls" else (0.0, 1.0)


def build_cost_model(scene: Scene, levels: Levels | None = None, *, settings: Settings) -> CostModel:
    """Return what drawing the scene's objects costs, in the budget's unit.

    In "ns" the coefficients are the device profile's; in "calls" an object costs its calls and an impostor 1; in
    "triangles" an object costs its triangles and an impostor those of its layers; everything else is 0 there.
    With `levels` an object costs, from where they are within the pixel error, what its level costs.
    Raises SettingsInvalid for an unknown device, and for a time budget that is below what an empty frame costs.
    """
    budget = parse_budget(settings.budget)
    profile = find_profile(settings)
    per_frame = 0
    call, triangle = prices(settings)
    pixel = impostor = impostor_triangle = impostor_pixel = 0.0
    if budget.unit == "ns":
        per_frame, pixel = profile.per_frame_ns, profile.per_pixel_ns
        impostor, impostor_triangle = profile.per_impostor_ns, profile.per_impostor_triangle_ns
        impostor_pixel = profile.per_impostor_pixel_ns
    elif budget.unit == "calls":
        impostor = 1.0
    else:
        impostor_triangle = 1.0
    if budget.amount < per_frame:
        raise SettingsInvalid("budget", f"an empty frame already costs {per_frame} ns on device {settings.device!r}")
    fixed = np.ceil(scene.object_calls * call + scene.object_triangles * triangle).astype(np.int64)
    return CostModel(
        unit=budget.unit, budget=budget.amount, per_frame=per_frame, per_call=call, per_triangle=triangle,
        per_pixel=pixel, per_impostor=impostor, per_impostor_triangle=impostor_triangle,
        per_impostor_pixel=impostor_pixel, object_fixed=fixed, fov_deg=settings.camera.fov_deg,
        width=settings.camera.width, height=settings.camera.height,
        **_level_columns(scene, levels, call=call, triangle=triangle),
    )  # fmt: skip


def _level_columns(scene: Scene, levels: Levels | None, *, call: float, triangle: float) -> dict[str, np.ndarray]:
    """Return CostModel's columns of levels, an entry for each level of each object's mesh."""
    if levels is None or not levels.n_levels:
        return {}
    first, count = levels.row[scene.object_mesh], np.diff(levels.row)[scene.object_mesh]
    row = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    of = np.repeat(np.arange(scene.n_objects), count)
    level = first[of] + np.arange(row[-1]) - row[of]
    triangles = levels.triangles[level]
    return {
        "level_row": row, "level_from": levels.error_m[level] * (stretch(scene.object_matrix) * levels.sight)[of],
        "level_fixed": np.ceil(scene.object_calls[of] * call + triangles * triangle).astype(np.int64),
        "level_triangles": triangles,
    }  # fmt: skip


def screen(model: CostModel) -> np.ndarray:
    """Return (6,) f64: width, height (pixels); most pixels a radian moves x, y; screen area and stretch of areas.

    The last two are f^2 (1 + t_x^2 + t_y^2)^(3/2), the most pixels a steradian covers, and width * height.
    """
    half_y = math.tan(math.radians(model.fov_deg) / 2)
    half_x = half_y * model.width / model.height
    f = model.height / (2 * half_y)
    corner = 1 + half_x * half_x + half_y * half_y
    return np.array([
        model.width, model.height,
        f * math.sqrt((1 + half_x * half_x) * corner) * MARGIN, f * math.sqrt((1 + half_y * half_y) * corner) * MARGIN,
        f * f * corner * math.sqrt(corner) * MARGIN, model.width * model.height,
    ], dtype=np.float64)  # fmt: skip


def object_cost(
    model: CostModel, boxes: np.ndarray, cell_box: np.ndarray, *, objects: np.ndarray | None = None
) -> np.ndarray:
    """Return (K,) i64, in `model.unit`: the most that each object costs in any view from the cell, at its level there.

    boxes     (N,2,3) f64, the model's objects, same frame and unit of length as cell_box
    cell_box  (2,3) f64
    objects   (K,) i32 which of them; all if left out

    Covered pixels of one concrete view are: the part of the box inside the view pyramid (apex at the eye, no near or
    far plane), projected to the screen, and of that the area of the bounding rectangle along the screen's axes, in
    pixels: 0 outside the pyramid, at most width * height. The bound dominates it for every eye in the cell, every
    direction and every roll, and so also every smaller measure (area of the projected box, of the object itself).
    """
    boxes = np.ascontiguousarray(boxes, dtype=np.float64).reshape(-1, 2, 3)
    cell_box = np.ascontiguousarray(cell_box, dtype=np.float64).reshape(2, 3)
    assert len(boxes) == len(model.object_fixed)
    if objects is None:
        objects = np.arange(len(boxes), dtype=np.int32)
    out = np.empty(len(objects), dtype=np.int64)
    kernels.object_costs(
        objects, model.object_fixed, model.level_row, model.level_from, model.level_fixed, boxes, cell_box, model.per_pixel,
        screen(model), out,
    )  # fmt: skip
    return out


def object_level(model: CostModel, boxes: np.ndarray, cell_box: np.ndarray) -> np.ndarray:
    """Return (N,) i64: the level at which each object is drawn from anywhere in the cell, 0 the object itself."""
    boxes = np.ascontiguousarray(boxes, dtype=np.float64).reshape(-1, 2, 3)
    cell_box = np.ascontiguousarray(cell_box, dtype=np.float64).reshape(2, 3)
    assert len(boxes) == len(model.object_fixed)
    out = np.empty(len(boxes), dtype=np.int64)
    kernels.object_levels(boxes, cell_box, model.level_row, model.level_from, out)
    return out


def least_cost(model: CostModel) -> np.ndarray:
    """Return (N,) i64: what each object costs at its coarsest, pixels left out."""
    out = model.object_fixed.copy()
    if len(model.level_row):
        some = np.flatnonzero(np.diff(model.level_row))
        out[some] = np.minimum(out[some], model.level_fixed[model.level_row[some + 1] - 1])
    return out


def covered_pixels_bound(model: CostModel, boxes: np.ndarray, cell_box: np.ndarray) -> np.ndarray:
    """Return (N,) f64: the pixels of `object_cost`, for any (N,2,3) boxes."""
    boxes = np.ascontiguousarray(boxes, dtype=np.float64).reshape(-1, 2, 3)
    cell_box = np.ascontiguousarray(cell_box, dtype=np.float64).reshape(2, 3)
    out = np.empty(len(boxes), dtype=np.float64)
    kernels.covered_pixels(boxes, cell_box, screen(model), out)
    return out


def pixels_bound_rect(model: CostModel, *, width: float, height: float, distance: float) -> float:
    """Return the most pixels that a flat rectangle covers on the screen, seen from no nearer than `distance`.

    width, height, distance  >= 0, one unit of length; the rectangle may be turned any way. At most the screen's area.
    For several layers add the bounds up. (`kernels.rect_pixels` is the same for kernels, with `screen(model)`.)
    """
    return float(kernels.rect_pixels(float(width), float(height), float(distance), screen(model)))


def impostor_cost(model: CostModel, *, triangles: int, pixels: float) -> int:
    """Return the cost of an impostor with that many layer triangles in all, and that many pixels in all its layers."""
    return int(
        kernels.impostor_cost(
            float(triangles), float(pixels), model.per_impostor, model.per_impostor_triangle, model.per_impostor_pixel
        )
    )
