"""Does the scene need levels of detail? Asked before any mesh is touched.

Problem  Levels cost time and bytes, and spare nothing but triangles. Leave them out where the budget does not spend
         itself on triangles, or where the triangles are in meshes that are too small to get simpler.
Method   "auto": not for a budget in calls. For one in milliseconds, the share of triangles in what the fullest views
         cost (calls and triangles; pixels would only lower it): enclosing frusta of the six faces at cells spread over
         the view space, the fullest tenth. For any, the share of triangles in meshes of at least FEWEST.
Errs     towards building levels: a view's share is a bound, and what does not get simpler is found out later
         (`build.merge` drops levels that spare less than SHARE of the triangles).
"""

from farfield.detail.build import FEWEST, SHARE, mesh_triangles
from farfield.detail.simplify import library
from farfield.errors import SettingsInvalid
from farfield.geometry.camera import Camera
from farfield.geometry.cells import build_cells
from farfield.geometry.frusta import boxes_in_frustum, enclosing_frusta
from farfield.scene.model import Scene
from farfield.settings import Settings, parse_budget

CELLS = 32  # of the view space, about, that are looked at


def reason_to_skip(scene: Scene, *, settings: Settings, per_call: float, per_triangle: float) -> str | None:
    """Return why the scene gets no levels, or None.

    per_call, per_triangle  what the budget's unit charges for them
    Raises SettingsInvalid for mode "on" where the simplifier does not run.
    """
    mode = settings.detail.mode
    if mode == "off":
        return "detail.mode is off: objects are drawn as they are"
    if library() is None:
        if mode == "on":
            raise SettingsInvalid("detail.mode", "needs the package almeshopt, which does not run here")
        return "the simplifier (almeshopt) does not run on this machine: objects are drawn as they are"
    if mode == "on":
        return None
    if parse_budget(settings.budget).unit == "calls":
        return "the budget counts draw calls: fewer triangles would not spare any"
    small = (mesh_triangles(scene) < FEWEST)[scene.object_mesh]
    held = int(scene.object_triangles[small].sum())
    if held > (1 - SHARE) * int(scene.object_triangles.sum()):
        return f"meshes of fewer than {FEWEST} triangles hold {_percent(held, scene.object_triangles.sum())} of the triangles"
    share = triangle_share(scene, settings, per_call=per_call, per_triangle=per_triangle)
    if share < SHARE:
        return f"triangles are {_percent(share, 1)} of what the fullest views cost"
    return None


def triangle_share(scene: Scene, settings: Settings, *, per_call: float, per_triangle: float) -> float:
    """Return the share of triangles in the cost of calls and triangles of the fullest views."""
    c = settings.camera
    frusta = enclosing_frusta(1, Camera(fov_deg=c.fov_deg, width=c.width, height=c.height))
    cells = build_cells(scene.view_boxes, scene.cell_m)
    triangles, calls = scene.object_triangles * per_triangle, scene.object_calls * per_call
    found = []
    for cell in range(0, cells.n_cells, max(1, cells.n_cells // CELLS)):
        for face in range(6):
            normals = frusta.normals[frusta.row[face] : frusta.row[face + 1], :3]
            seen = boxes_in_frustum(normals, float(frusta.pad[face]), scene.object_box, cells.cell_box[cell])
            found.append((float(triangles[seen].sum()), float(calls[seen].sum())))
    found.sort(key=lambda f: -f[0] - f[1])
    fullest = found[: max(1, len(found) // 10)]
    spent = sum(a + b for a, b in fullest)
    return sum(a for a, _ in fullest) / spent if spent > 0 else 0.0


def _percent(part: float, whole: float) -> str:
    return f"{100 * float(part) / float(whole):.0f} %"
