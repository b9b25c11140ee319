"""The cost model: units, and bounds that no concrete view exceeds."""

import dataclasses
import math

import numpy as np
import pytest
from farfield.errors import SettingsInvalid
from farfield.geometry.camera import Camera, camera_frame
from farfield.rendertime.cost import (
    build_cost_model,
    covered_pixels_bound,
    impostor_cost,
    object_cost,
    pixels_bound_rect,
)
from farfield.settings import CameraSettings, Settings
from naive import rendertime as naive
from towns import town

CAMERAS = [(45.0, 1280, 720), (1.0, 640, 640), (120.0, 1280, 720), (90.0, 400, 1600), (150.0, 512, 512)]


def model_for(budget="16 ms", camera=CAMERAS[0], scene=None):
    fov_deg, width, height = camera
    settings = Settings(budget=budget, camera=CameraSettings(fov_deg=fov_deg, width=width, height=height))
    return build_cost_model(scene or town(9), settings=settings)


def turned(rng):
    """A random camera frame, rolled too."""
    right, up, forward = camera_frame(rng.normal(size=3))
    roll = rng.uniform(0, 2 * np.pi) if rng.random() < 0.5 else 0.0
    return np.array([np.cos(roll) * right + np.sin(roll) * up, np.cos(roll) * up - np.sin(roll) * right, forward])


def test_a_time_budget_takes_the_reference_profile():
    scene = town(9, triangles=24)
    model = model_for("16 ms", scene=scene)
    assert (model.unit, model.budget, model.per_frame, model.target) == ("ns", 16_000_000, 1_000_000, 15_000_000)
    assert model.object_fixed.dtype == np.int64
    np.testing.assert_array_equal(model.object_fixed, 10_000 + 5 * 24)
    assert impostor_cost(model, triangles=6, pixels=1000.5) == math.ceil(1000 + 30 + 50.025)


@pytest.mark.parametrize(("budget", "objects", "impostor"), [("7 calls", 1, 1), ("500 triangles", 24, 6)])
def test_count_budgets_count_only_that(budget, objects, impostor):
    model = model_for(budget, scene=town(9, triangles=24))
    boxes = np.broadcast_to(np.array([[0.0, 0, 0], [1, 1, 1]]), (9, 2, 3))
    assert model.per_frame == 0
    np.testing.assert_array_equal(object_cost(model, boxes, boxes[0]), objects)
    assert impostor_cost(model, triangles=6, pixels=1e6) == impostor


def test_unknown_devices_and_impossible_budgets_are_refused():
    with pytest.raises(SettingsInvalid, match="reference"):
        build_cost_model(town(4), settings=dataclasses.replace(Settings(), device="toaster"))
    with pytest.raises(SettingsInvalid, match="empty frame"):
        build_cost_model(town(4), settings=dataclasses.replace(Settings(), budget="0.5 ms"))


@pytest.mark.parametrize("camera", CAMERAS)
def test_no_view_covers_more_pixels_than_the_bound(camera):
    rng = np.random.default_rng(3)
    model, cam = model_for(camera=camera), Camera(fov_deg=camera[0], width=camera[1], height=camera[2])
    tightest = 0.0
    for _ in range(400):
        cell = np.sort(rng.uniform(-1, 1, (2, 3)) * 10.0 ** rng.uniform(-2, 0.5), axis=0)
        size = rng.uniform(0, 1, 3) * 10.0 ** rng.uniform(-2, 1.5) * (rng.random(3) < 0.8)
        low = rng.normal(size=3)
        low *= 10.0 ** rng.uniform(-0.5, 1.5) / np.linalg.norm(low)
        box = np.array([low, low + size])
        bound = covered_pixels_bound(model, box[None], cell)[0]
        middle = box.mean(0)
        for _ in range(4):
            eye = np.where(rng.random(3) < 0.5, cell[rng.integers(0, 2, 3), range(3)], rng.uniform(cell[0], cell[1]))
            frame = turned(rng)
            if rng.random() < 0.8:  # aim so that the box is somewhere on the screen, its corner included
                slopes = rng.uniform(-1, 1, 2) * cam.half_tan
                goal = middle - eye
                forward = goal / np.linalg.norm(goal) - slopes[0] * frame[0] * 0.5 - slopes[1] * frame[1] * 0.5
                frame = np.array(camera_frame(forward))
            exact = naive.box_pixels(box, eye, frame, cam)
            assert exact <= bound * (1 + 1e-9), f"{exact=} {bound=} {box=} {cell=} {eye=} {frame=}"
            tightest = max(tightest, exact / max(bound, 1e-300))
    assert tightest > 0.5, "the test never came near the bound"


def test_bound_agrees_with_its_formula_and_scales_exactly():
    rng = np.random.default_rng(5)
    for camera in CAMERAS:
        model, cam = model_for(camera=camera), Camera(fov_deg=camera[0], width=camera[1], height=camera[2])
        boxes = np.sort(rng.normal(scale=8, size=(50, 2, 3)), axis=1)
        cell = np.array([[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]])
        ours = covered_pixels_bound(model, boxes, cell)
        formula = np.array([naive.pixels_bound(b, cell, cam) for b in boxes])
        assert (ours >= formula).all()
        assert (ours <= formula * 1.13).all()
        np.testing.assert_array_equal(ours, covered_pixels_bound(model, boxes * 2.0**-7, cell * 2.0**-7))


def test_an_object_that_touches_the_cell_covers_the_screen():
    model = model_for()
    box = np.array([[1.0, 0, 0], [2, 1, 1]])
    assert covered_pixels_bound(model, box[None], np.array([[0.0, 0, 0], [1, 1, 1]]))[0] == 1280 * 720


@pytest.mark.parametrize("camera", CAMERAS)
def test_no_view_of_a_rectangle_covers_more_than_its_bound(camera):
    rng = np.random.default_rng(11)
    model, cam = model_for(camera=camera), Camera(fov_deg=camera[0], width=camera[1], height=camera[2])
    for _ in range(500):
        a, b, middle = turned(rng)
        width, height = 10.0 ** rng.uniform(-2, 1, 2)
        if rng.random() < 0.7:  # facing the viewer, elsewhere on the screen
            middle = middle + a * rng.uniform(-1, 1) + b * rng.uniform(-1, 1)
        else:
            middle = rng.normal(size=3) * 2
        quad = np.array(
            [middle + s * a * width / 2 + t * b * height / 2 for s, t in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
        )
        foot = np.array([np.clip(-middle @ a, -width / 2, width / 2), np.clip(-middle @ b, -height / 2, height / 2)])
        distance = np.linalg.norm(middle + foot[0] * a + foot[1] * b)
        bound = pixels_bound_rect(model, width=width, height=height, distance=distance)
        exact = naive.polygon_pixels(quad, np.zeros(3), turned(rng), cam)
        assert exact <= bound * (1 + 1e-9), f"{exact=} {bound=} {quad=}"
        assert bound <= camera[1] * camera[2]
