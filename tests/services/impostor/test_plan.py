"""The plan of an impostor's layers against rays: nothing is off by more than alpha, no crack opens beyond a texel."""

import math

import numpy as np
import pytest
from farfield.errors import ObjectTouchesViewCell, OutOfDomain
from farfield.impostor.cells import BOX, SHAFT, contains, fit_box, fit_shaft
from farfield.impostor.metric import Setup, place_layers
from farfield.impostor.plan import LayerPlan, plan_layers, precision
from farfield.impostor.weight import LAYER_BYTES, impostor_bytes
from farfield.settings import CameraSettings, QualitySettings, Settings

COARSE = Settings(camera=CameraSettings(width=320, height=180))  # few, wide layers: one plan has all kinds of ranges


def some_setup(rng: np.random.Generator) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Return (kind, view cell, cluster box, served boxes): off-centre, above, below, narrow, wide, near, far."""
    size = 10 ** rng.uniform(-1, 2, 3)
    box = np.array([-size / 2, size / 2]) + rng.uniform(-1000, 1000, 3)
    away = rng.normal(size=3)
    away /= np.linalg.norm(away)
    cells = []
    for _ in range(rng.integers(1, 4)):
        side = 10 ** rng.uniform(-1, 1.3, 3)
        at = box.mean(0) + away * 10 ** rng.uniform(0.3, 3) * size.max() + rng.normal(size=3) * side
        cells.append([at, at + side])
    served = np.array(cells)
    kind = int(rng.integers(2))
    cell = fit_shaft(box.mean(0), served) if kind == SHAFT else fit_box(served)
    if cell is None:
        return some_setup(rng)
    if kind == SHAFT and rng.random() < 0.2:
        cell[8] = np.inf
    if kind == SHAFT and rng.random() < 0.2:
        cell[6] = math.tan(math.radians(10 ** rng.uniform(-2, 1)))
    return kind, cell, box, served


def plans(seed: int, n: int, settings: Settings = COARSE) -> list[tuple[int, np.ndarray, np.ndarray, LayerPlan]]:
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < n:
        kind, cell, box, _ = some_setup(rng)
        try:
            found.append((kind, cell, box, plan_layers(kind, cell, box, settings=settings)))
        except (ObjectTouchesViewCell, OutOfDomain):
            continue
    return found


def viewpoints(kind: int, cell: np.ndarray, rng: np.random.Generator, n: int = 400) -> np.ndarray:
    """Return points in and on the view cell: corners and edges first, then random ones."""
    if kind == BOX:
        low, high = cell[:3], cell[3:6]
        corners = np.array([[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]]
                            for i in (0, 1) for j in (0, 1) for k in (0, 1)])  # fmt: skip
        return np.concatenate([corners, low + rng.uniform(0, 1, (n, 3)) * (high - low)])
    apex, axis, tangent, near, far = cell[:3], cell[3:6], cell[6], cell[7], min(cell[8], 1e4 * cell[7])
    across = np.cross(axis, np.eye(3)[np.argmin(abs(axis))])
    across /= np.linalg.norm(across)
    other = np.cross(axis, across)
    phi = rng.uniform(0, 2 * np.pi, n)
    along = np.where(
        rng.random(n) < 0.4, near, np.where(rng.random(n) < 0.4, far, near * (far / near) ** rng.random(n))
    )
    r = along * tangent * np.where(rng.random(n) < 0.7, 1, rng.random(n))
    return apex + along[:, None] * axis + r[:, None] * (np.cos(phi)[:, None] * across + np.sin(phi)[:, None] * other)


def slopes_of(plan: LayerPlan, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p = points - plan.eye
    z = -(p @ plan.back)
    return np.stack([p @ plan.right / z, p @ plan.up / z], -1), z


def worst_angle(kind: int, cell: np.ndarray, box: np.ndarray, plan: LayerPlan, rng: np.random.Generator) -> float:
    """Return the largest angle between where points of the box are and where their layers show them, from the cell."""
    points = box[0] + rng.uniform(0, 1, (150, 3)).round(rng.integers(0, 2)) * (box[1] - box[0])
    # points at the ends of the slabs are the worst: move some of them there along their ray from the eye
    slope, z = slopes_of(plan, points)
    slack = 1e-14 * (1 + abs(points).max())  # of the coordinates here
    assert (z >= plan.near[0] - slack).all()
    assert (z <= plan.far[-1] + slack).all()
    ends = np.concatenate([plan.near, plan.far, z])
    z = np.clip(rng.choice(ends, len(z)), z.min(), z.max())
    layer = np.minimum(np.searchsorted(plan.far, z), len(plan.plane) - 1)
    # on a border either neighbour may show it
    layer = np.where((z == plan.far[layer]) & (rng.random(len(z)) < 0.5),
                     np.minimum(layer + 1, len(plan.plane) - 1), layer)  # fmt: skip
    direction = slope[:, :1] * plan.right + slope[:, 1:] * plan.up - plan.back
    true = plan.eye + z[:, None] * direction
    shown = plan.eye + plan.plane[layer][:, None] * direction
    views = viewpoints(kind, cell, rng, 200)
    a, b = true[None] - views[:, None], shown[None] - views[:, None]
    angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))
    return float(angle.max())


def test_parallax_stays_below_alpha_everywhere_in_the_view_cell():
    worst = 0.0
    strict = QualitySettings(pixel_error=0.3)
    loose = QualitySettings(pixel_error=4, pixels_at="anywhere")
    for settings in (
        COARSE,
        Settings(camera=COARSE.camera, quality=strict),
        Settings(camera=COARSE.camera, quality=loose),
    ):
        alpha = 2 * math.atan(precision(settings).dl / 2)
        rng = np.random.default_rng(1)
        for kind, cell, box, plan in plans(1, 100, settings):
            angle = worst_angle(kind, cell, box, plan, rng)
            assert angle <= alpha * (1 + 1e-7) + 1e-9, (kind, cell, box, angle / alpha)
            worst = max(worst, angle / alpha)
    assert worst > 0.9  # the bound is not idle


def worst_gap(kind: int, cell: np.ndarray, plan: LayerPlan, rng: np.random.Generator) -> float:
    """Return by how many texels of the layer behind an edge of a layer moves against it, at most, seen from the cell."""
    views = viewpoints(kind, cell, rng)
    top = plan.depth  # depth of the viewpoint in the cell is measured from its nearest plane
    p = views - plan.eye
    x, d = np.stack([p @ plan.right, p @ plan.up], -1), p @ plan.back + top
    assert d.min() >= -1e-9 * (1 + abs(views).max())
    worst = 0.0
    for axis in range(2):
        edges = plan.slope0[axis] + plan.texel[axis] * np.arange(plan.resolution[axis] + 1)
        for k in range(len(plan.plane) - 1):
            # where a viewer sees edges of layer k on the plane of layer k + 1, in texels there
            t, c = plan.plane[k] - top, plan.plane[k + 1] - plan.plane[k]
            moved = c * (edges[None] * (top - d[:, None]) - x[:, axis, None])
            moved /= (t + d[:, None]) * plan.texel[axis] * (t + top + c)
            # the two outermost edges of the texture have nothing beside them that they could uncover
            worst = max(worst, float(abs(moved[:, 1:-1]).max()))
    return worst


def test_no_crack_opens_by_more_than_a_texel():
    rng = np.random.default_rng(2)
    gaps = []
    for kind, cell, box, plan in plans(2, 300):
        gaps.append(worst_gap(kind, cell, plan, rng))
        assert gaps[-1] <= 1 + 1e-9, (kind, cell, box)
    assert max(gaps) > 0.9


def degenerate(rng: np.random.Generator) -> tuple[int, np.ndarray, np.ndarray]:
    """Return (kind, view cell, cluster box): cells that are points, lines and planes, shafts without width or depth, flat
    and tiny objects, next to the cell or far away, near the origin or 10,000 km from it."""
    at = rng.uniform(-1, 1, 3) * rng.choice([0.0, 100.0, 1e7])
    size = 10 ** rng.uniform(-2, 2, 3) * rng.choice([1.0, 1.0, 0.0], 3)
    box = at + np.array([-size / 2, size / 2])
    reach = max(float(size.max()), 0.01)
    away = rng.normal(size=3)
    away /= np.linalg.norm(away)
    distance = reach * 10 ** rng.uniform(0.01, 3)
    if rng.integers(2):
        side = distance * 10 ** rng.uniform(-2, 0, 3) * rng.choice([1.0, 0.0], 3)
        middle = box.mean(0) + away * (distance + np.linalg.norm(side) / 2)
        return BOX, np.concatenate([middle - side / 2, middle + side / 2, np.zeros(3)]), box
    near = distance
    far = float(rng.choice([near, near * (1 + 1e-12), near * 3, np.inf]))
    tangent = float(rng.choice([0.0, 1e-9, 0.1, 1.0]))
    return SHAFT, np.array([*box.mean(0), *away, tangent, near, far]), box


def test_degenerate_cells_and_objects_hold_to_both_bounds():
    rng = np.random.default_rng(9)
    alpha = 2 * math.atan(precision(COARSE).dl / 2)
    tried = layered = 0
    while tried < 150:
        kind, cell, box = degenerate(rng)
        try:
            plan = plan_layers(kind, cell, box, settings=COARSE)
        except (ObjectTouchesViewCell, OutOfDomain):
            continue
        tried, layered = tried + 1, layered + (len(plan.plane) > 1)
        rounding = 1e-15 * abs(cell[:6]).max() / (plan.plane[0] - plan.depth)  # of the rays here, not of the plan
        assert worst_angle(kind, cell, box, plan, rng) <= alpha * (1 + 1e-7) + 1e-9 + 8 * rounding, (kind, cell, box)
        assert worst_gap(kind, cell, plan, rng) <= 1 + 1e-9 + 8 * rounding / plan.texel[0], (kind, cell, box)
    assert layered > 12


def test_texels_are_never_magnified_beyond_an_output_pixel():
    delta = precision(COARSE).delta
    rng = np.random.default_rng(3)
    for kind, cell, _, plan in plans(3, 200):
        d = (viewpoints(kind, cell, rng) - plan.eye) @ plan.back
        distance = plan.plane[:, None] + d  # of each layer from each viewpoint, along the normal
        assert (plan.texel[0] * plan.plane[:, None] / distance <= delta * (1 + 1e-9)).all()


def test_slabs_adjoin_and_the_grid_covers_the_cluster():
    for _, _, box, plan in plans(4, 300):
        corners = np.array([[box[i][0], box[j][1], box[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        slope, z = slopes_of(plan, corners)
        assert plan.near[0] <= z.min()
        assert plan.far[-1] >= z.max()
        np.testing.assert_array_equal(plan.near[1:], plan.far[:-1])
        assert (plan.near <= plan.plane).all()
        assert (plan.plane <= plan.far).all()
        assert (plan.resolution >= 4).all()
        texel = (slope - plan.slope0) / plan.texel
        assert texel.min() >= -1e-6
        assert (texel <= plan.resolution + 1e-6).all()
        frame = np.stack([plan.right, plan.up, plan.back])
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-14)
        np.testing.assert_allclose(np.cross(plan.right, plan.up), plan.back, atol=1e-14)


def test_crops_hold_what_lies_in_the_slab():
    rng = np.random.default_rng(5)
    for _, _, box, plan in plans(5, 200):
        points = box[0] + rng.uniform(0, 1, (5000, 3)) * (box[1] - box[0])
        slope, z = slopes_of(plan, points)
        texel = np.floor((slope - plan.slope0) / plan.texel)
        for k in range(len(plan.plane)):
            inside = (z >= plan.near[k]) & (z <= plan.far[k])
            if inside.any():
                span = texel[inside].max(0) - texel[inside].min(0) + 1
                assert (span <= plan.crop[k]).all()
        assert (plan.crop <= plan.resolution).all()
        assert plan.bytes <= impostor_bytes(int(plan.resolution.prod()) * len(plan.plane), len(plan.plane))
        assert plan.bytes > LAYER_BYTES * len(plan.plane)


def test_scaling_by_a_power_of_two_scales_the_plan():
    for kind, cell, box, plan in plans(6, 100):
        scaled = cell.copy()
        length = [0, 1, 2, 7, 8] if kind == SHAFT else list(range(6))
        scaled[length] *= 8
        other = plan_layers(kind, scaled, box * 8, settings=COARSE)
        np.testing.assert_allclose(other.plane, plan.plane * 8, rtol=1e-12)
        np.testing.assert_array_equal(other.resolution, plan.resolution)


def test_touching_and_senseless_input_is_refused():
    box = np.array([[0.0, 0, 0], [10, 10, 10]])
    touching = fit_box(np.array([[[10.0, 0, 0], [12, 2, 2]]]))
    with pytest.raises(ObjectTouchesViewCell):
        plan_layers(BOX, touching, box, settings=COARSE)
    shaft = np.array([5.0, 5, 5, 1, 0, 0, 0.5, 5, 9])
    with pytest.raises(ObjectTouchesViewCell):
        plan_layers(SHAFT, shaft, box, settings=COARSE)
    with pytest.raises(OutOfDomain):
        plan_layers(BOX, fit_box(np.array([[[10.01, -500, -500], [900, 500, 500]]])), box, settings=COARSE)
    for bad in (np.nan, np.inf):
        with pytest.raises(OutOfDomain):
            plan_layers(SHAFT, shaft, np.array([[0.0, 0, 0], [bad, 1, 1]]), settings=COARSE)
        cell = touching.copy()
        cell[0] = -bad
        with pytest.raises(OutOfDomain):
            plan_layers(BOX, cell, box, settings=COARSE)
    with pytest.raises(OutOfDomain):
        plan_layers(SHAFT, np.array([5.0, 5, 5, 1, 1, 0, 0.5, 50, 90]), box, settings=COARSE)
    with pytest.raises(OutOfDomain):
        plan_layers(7, shaft, box, settings=COARSE)


def test_shrinking_the_served_set_shrinks_the_fit():
    rng = np.random.default_rng(7)
    for _ in range(300):
        low = rng.uniform(50, 400, (8, 3))
        cells = np.stack([low, low + rng.uniform(0, 30, (8, 3))], 1)
        apex = rng.uniform(-10, 10, 3)
        few = cells[rng.permutation(8)[: rng.integers(1, 8)]]
        a, b = fit_shaft(apex, few), fit_shaft(apex, cells)
        assert a is not None
        assert b is not None
        assert a[6] <= b[6] * (1 + 1e-7)
        for kind, cell in ((SHAFT, b), (BOX, fit_box(cells))):
            assert contains(kind, cell, cells).all()
        # the smallest cone: no axis nearby holds the corners in a smaller one
        corners = cells[:, :, None].repeat(8, 2)
        corners = np.array([[c[i][0], c[j][1], c[k][2]] for c in cells for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        p = corners - apex
        for _ in range(20):
            axis = b[3:6] + rng.normal(size=3) * 10 ** rng.uniform(-5, -1)
            axis /= np.linalg.norm(axis)
            along = p @ axis
            tangent = np.linalg.norm(np.cross(p, axis), axis=1) / along
            assert (along <= 0).any() or tangent.max() >= b[6] * (1 - 1e-6)


def test_centred_cells_need_about_the_layers_of_the_centred_formulas():
    rng = np.random.default_rng(8)
    delta, compared = precision(COARSE).delta, []
    for _ in range(200):
        half, depth = 10 ** rng.uniform(0, 1.7), 10 ** rng.uniform(0, 2)
        n, m, t0 = 10 ** rng.uniform(0, 1.5), 10 ** rng.uniform(0, 1.5), 10 ** rng.uniform(1, 2.5)
        box = np.array([[t0, -half, -half], [t0 + depth, half, half]])
        cell = np.array([-m, -n / 2, -n / 2, 0, n / 2, n / 2, 0, 0, 0])
        try:
            plan = plan_layers(BOX, cell, box, settings=COARSE)
        except OutOfDomain:
            continue
        res = float(plan.resolution[0])
        width = res * plan.texel[0] * (t0 + plan.depth)
        setup = Setup(is_box=True, t0=t0, t_far=t0 + depth, w=(width, width), res=(res, res), n=(n, n), m=m,
                      alpha_rad=2 * math.atan(delta / 2))  # fmt: skip
        compared.append((len(plan.plane), len(place_layers(setup, s=plan.depth).t)))
    found, centred = np.array(compared).T
    assert len(found) > 100
    assert (abs(found - centred) <= 1 + 0.1 * centred).all()
