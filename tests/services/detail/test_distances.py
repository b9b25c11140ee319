"""From which distance on: the stretch of a matrix and the sight of the settings, bounded from above."""

import math

import numpy as np
from farfield.detail.distances import sight, stretch
from farfield.impostor.plan import precision
from farfield.settings import CameraSettings, QualitySettings, Settings
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays


@settings(max_examples=300, deadline=None)
@given(arrays(np.float64, (1, 3, 3), elements=st.floats(-1e3, 1e3)))
def test_stretch_is_hardly_more_than_the_largest_singular_value(matrix):
    sigma = np.linalg.svd(matrix[0], compute_uv=False)[0]
    bound = stretch(matrix)[0]
    assert bound >= sigma * (1 - 1e-12)
    assert bound <= 1.004 * sigma + 1e-300


def test_stretch_of_mirrored_stretched_and_huge_matrices():
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    scales = np.array([[1, 1, 1], [-1, 1, 1], [1.5, 0.5, 3], [1e-6, 1e-6, 1e-6], [1e6, 1, 1], [0, 0, 0]])
    found = stretch(turn * scales[:, None, :])
    largest = np.abs(scales).max(1)
    assert (found >= largest * (1 - 1e-12)).all() and (found <= 1.004 * largest).all()
    np.testing.assert_array_equal(stretch(turn[None] * 2.0**-40), stretch(turn[None]) * 2.0**-40)
    np.testing.assert_array_equal(found, [stretch(r[None] * 1.0)[0] for r in turn * scales[:, None, :]])


def test_two_points_no_nearer_than_the_sight_are_seen_within_the_pixel_error():
    rng = np.random.default_rng(3)
    for pixels_at in ("centre", "anywhere"):
        for pixel_error in (0.25, 1.0, 8.0, 64.0):
            quality = QualitySettings(pixel_error=pixel_error, pixels_at=pixels_at)
            s = Settings(camera=CameraSettings(fov_deg=60.0, width=64, height=64), quality=quality)
            alpha, d = 2 * math.atan(precision(s).dl / 2), sight(s)
            u = rng.normal(size=(2000, 3))
            u *= (d * np.maximum(1, rng.normal(1, 0.5, (2000, 1)))) / np.linalg.norm(u, axis=1, keepdims=True)
            step = rng.normal(size=u.shape)
            v = u + step / np.linalg.norm(step, axis=1, keepdims=True)
            both = np.minimum(np.linalg.norm(u, axis=1), np.linalg.norm(v, axis=1)) >= d
            angle = np.arctan2(np.linalg.norm(np.cross(u, v), axis=1), (u * v).sum(1))[both]
            assert angle.max() <= alpha
            side = np.array([0.5, math.sqrt(d * d - 0.25)])  # the worst: both at that distance, a unit apart
            assert math.isclose(2 * math.atan2(*side), alpha, rel_tol=1e-9)
