"""Enclosing frusta: no view is missed, few are named too many."""

import numpy as np
import pytest
from farfield.geometry import kernels
from farfield.geometry.camera import Camera, camera_frame, corner_rays
from farfield.geometry.frusta import (
    boxes_in_frustum,
    enclosing_frusta,
    enclosing_frustum,
    view_frustum_normals,
)
from farfield.geometry.intervals import direction_at, find_interval, interval_bounds, split_id
from naive import frusta as naive

CAMERAS = [
    Camera(fov_deg=45.0, width=720, height=720),
    Camera(fov_deg=45.0, width=1280, height=720),
    Camera(fov_deg=2.0, width=640, height=640),
    Camera(fov_deg=100.0, width=1280, height=720),
    Camera(fov_deg=40.0, width=400, height=1600),
]
UP = np.array([0.0, 1.0, 0.0])


def intervals_to_try(n):
    """(face, i, j): two of a side face, all around the pole of +y, one at the pole of -y, two more of +y."""
    h = n // 2
    return [
        (0, 0, 0),
        (5, n - 1, h),
        (2, h, h),
        (2, h - 1, h),
        (2, h, h - 1),
        (3, h - 1, h - 1),
        (2, 0, 0),
        (2, h, n - 1),
    ]


def directions_in(rng, interval, n, count):
    """Random directions of an interval, its edges and corners among them (and the exact pole, if it is there)."""
    face, i, j = interval
    (u0, u1), (v0, v1) = interval_bounds(face, i, j, n)
    s = rng.random((count, 2))
    edge = rng.random((count, 2)) < 0.3
    s[edge] = np.round(s[edge])
    return [direction_at(face, u0 + (u1 - u0) * a, v0 + (v1 - v0) * b) for a, b in s]


def frustum_of(interval, n, camera):
    return enclosing_frustum(*interval, n, fov_deg=camera.fov_deg, width=camera.width, height=camera.height)


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("n", [2, 8, 16])
def test_the_rays_of_all_views_stay_in_the_padded_cone(camera, n):
    rng = np.random.default_rng(n)
    for interval in intervals_to_try(n):
        normals, pad = frustum_of(interval, n, camera)
        assert 0 < pad <= 0.0002
        np.testing.assert_allclose((normals**2).sum(1), 1, atol=1e-14)
        if not len(normals):
            continue
        rays = np.concatenate([corner_rays(d, camera) for d in directions_in(rng, interval, n, 150)])
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        worst = float((rays @ normals.T).min())
        assert worst >= -pad, f"{interval=} {worst=} {pad=}"


def random_boxes(rng, count, reach):
    """Boxes around the origin at many distances and sizes, some flat, some sticks, some a point."""
    middle = rng.normal(size=(count, 3))
    middle *= (10.0 ** rng.uniform(-1, np.log10(reach), count) / np.linalg.norm(middle, axis=1))[:, None]
    half = 10.0 ** rng.uniform(-2, 1.3, (count, 3)) * (rng.random((count, 3)) < 0.8)
    return np.stack([middle - half, middle + half], 1)


@pytest.mark.parametrize("camera", CAMERAS)
def test_one_view_sees_what_clipping_says(camera):
    rng = np.random.default_rng(1)
    for k in range(25):
        direction = rng.normal(size=3) if k else UP
        normals = view_frustum_normals(direction, camera)
        boxes = random_boxes(rng, 30, 100)
        eye = rng.normal(size=3)
        ours = boxes_in_frustum(normals, 0.0, boxes, np.stack([eye, eye]))
        theirs = [naive.sees(box, eye, direction, camera) for box in boxes]
        np.testing.assert_array_equal(ours, theirs, err_msg=f"{direction=} {eye=}")


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("n", [2, 8])
def test_nothing_that_a_view_sees_is_rejected(camera, n):
    rng = np.random.default_rng(7)
    for interval in intervals_to_try(n):
        normals, pad = frustum_of(interval, n, camera)
        cell = np.sort(rng.uniform(-1, 1, (2, 3)), axis=0) * 10.0 ** rng.uniform(-1, 1.2)
        cell[1] = np.where(rng.random(3) < 0.3, cell[0], cell[1])
        boxes = random_boxes(rng, 300, 1000)
        accepted = boxes_in_frustum(normals, pad, boxes, cell)
        seen = np.zeros(len(boxes), dtype=bool)
        for direction in directions_in(rng, interval, n, 40):
            corner = rng.random(3) < 0.5
            eye = np.where(corner, cell[rng.integers(0, 2, 3), range(3)], rng.uniform(cell[0], cell[1]))
            seen |= boxes_in_frustum(view_frustum_normals(direction, camera), 0.0, boxes, np.stack([eye, eye]))
        assert not (seen & ~accepted).any(), f"{interval=} {boxes[seen & ~accepted]=} {cell=}"
        touching = (boxes[:, 0] <= cell[1]).all(1) & (boxes[:, 1] >= cell[0]).all(1)
        assert accepted[touching].all()


@pytest.mark.parametrize(
    ("near", "far", "most", "most_pole"), [(10, 100, 1.015, 1.05), (20, 600, 1.03, 1.08), (100, 2000, 1.04, 1.14)]
)
def test_few_boxes_are_accepted_that_no_view_sees(near, far, most, most_pole):
    """Accepted / seen by dense sampling (cell 23 m, intervals 11.25 degrees, 45 degrees square)."""
    rng = np.random.default_rng(near)
    camera, n = CAMERAS[0], 8
    count = 2500
    middle = rng.normal(size=(count, 3)) * [1, 0.15, 1]
    middle *= (np.sqrt(rng.uniform(near**2, far**2, count)) / np.linalg.norm(middle, axis=1))[:, None]
    middle[::2] = rng.permuted(middle[::2], axis=1)  # every other one anywhere around, for the poles
    half = rng.uniform(2, 10, (count, 3))
    boxes = np.stack([middle - half, middle + half], 1)
    cell = np.array([[-11.5, -1.0, -11.5], [11.5, 1.0, 11.5]])
    difference = np.stack([boxes[:, 0] - cell[1], boxes[:, 1] - cell[0]], 1)
    origin = np.zeros((2, 3))
    for intervals, limit in (([(0, 3, 4), (4, 4, 1), (1, 5, 7)], most), ([(2, 4, 4)], most_pole)):
        accepted_all = seen_all = 0
        for interval in intervals:
            normals, pad = frustum_of(interval, n, camera)
            accepted = boxes_in_frustum(normals, pad, boxes, cell)
            kept = difference[accepted]
            seen = np.zeros(len(kept), dtype=bool)
            (u0, u1), (v0, v1) = interval_bounds(*interval, n)
            steps = np.linspace(0, 1, 17 if interval[0] != 2 else 33) ** (1 if interval[0] != 2 else 2)
            for u in u0 + (u1 - u0) * steps:
                for v in v0 + (v1 - v0) * steps:
                    view = view_frustum_normals(direction_at(interval[0], u, v), camera)
                    seen[~seen] = boxes_in_frustum(view, 0.0, kept[~seen], origin)
            accepted_all += accepted.sum()
            seen_all += seen.sum()
        assert seen_all > 20
        assert accepted_all / seen_all < limit, f"{intervals=} {accepted_all / seen_all=}"


def test_normals_agree_with_every_pair_of_rays():
    rng = np.random.default_rng(2)
    for _ in range(40):
        camera = Camera(fov_deg=float(rng.uniform(5, 140)), width=int(rng.integers(200, 900)), height=500)
        direction = rng.normal(size=3)
        ours, theirs = view_frustum_normals(direction, camera), naive.cone_normals(corner_rays(direction, camera))
        boxes = random_boxes(rng, 40, 50)
        eye = np.zeros((2, 3))
        np.testing.assert_array_equal(
            boxes_in_frustum(ours, 0.0, boxes, eye), [naive.accepts(theirs, 0.0, box, eye) for box in boxes]
        )


def test_the_kernel_decides_as_the_loops_do():
    rng = np.random.default_rng(4)
    camera, n = CAMERAS[1], 4
    frusta = enclosing_frusta(n, camera)
    cell = np.array([[0.0, 0, 0], [3, 2, 4]])
    boxes = random_boxes(rng, 60, 100)
    q, g = (boxes[:, 0] + boxes[:, 1] - cell.sum(0)) / 2, (boxes[:, 1] - boxes[:, 0] + cell[1] - cell[0]) / 2
    reach = np.sqrt((q * q).sum(1)) + np.sqrt((g * g).sum(1))
    for interval in rng.integers(0, 6 * n * n, 12):
        k = frusta.offset(n) + interval
        normals, pad = frustum_of(split_id(int(interval), n), n, camera)
        np.testing.assert_array_equal(frusta.normals[frusta.row[k] : frusta.row[k + 1], :3], normals)
        assert frusta.pad[k] == pad
        ours = [
            kernels.accepts(frusta.normals, frusta.row[k], frusta.row[k + 1], pad, *q[i], *g[i], reach[i]) < 0
            for i in range(len(boxes))
        ]
        assert ours == [naive.accepts(normals, pad, box, cell) for box in boxes]
        np.testing.assert_array_equal(ours, boxes_in_frustum(normals, pad, boxes, cell))


def test_whole_faces_of_a_wide_camera_accept_everything():
    normals, _ = frustum_of((0, 0, 0), 1, CAMERAS[3])
    assert len(normals) == 0
    assert boxes_in_frustum(normals, 0.0, np.array([[[-9.0, 0, 0], [-8, 1, 1]]]), np.zeros((2, 3))).all()


def test_camera_frames_are_level_and_defined_at_the_poles():
    for direction in (UP, -UP, [0, 0, -1], [1, 0, 0], [3e-200, 1e-200, -1e-200], [1e-12, -1, 1e-12]):
        right, up, forward = camera_frame(np.array(direction, dtype=float))
        frame = np.array([right, up, forward])
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-15)
        assert right[1] == 0
        assert up[1] >= 0
        np.testing.assert_allclose(np.cross(right, up), -forward, atol=1e-15)
    np.testing.assert_array_equal(camera_frame(UP)[0], [1, 0, 0])
    np.testing.assert_array_equal(camera_frame(UP)[1], [0, 0, 1])
    np.testing.assert_array_equal(camera_frame(-UP)[1], [0, 0, -1])
    with pytest.raises(ValueError, match="length"):
        camera_frame(np.zeros(3))


def test_hull_of_a_grid_is_its_four_corners():
    x, y = (c.ravel().astype(float) for c in np.meshgrid(np.arange(5), np.arange(4)))
    hull = kernels.convex_hull(x, y, np.lexsort((y, x)))
    assert [(x[i], y[i]) for i in hull] == [(0, 0), (4, 0), (4, 3), (0, 3)]


def test_intervals_to_try_hold_the_pole():
    assert split_id(find_interval(UP, 8), 8) == (2, 4, 4)
