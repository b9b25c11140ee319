"""Pictures drawn by OpenGL are an independent truth: with a cell's set alone hardly a pixel shows something farther."""

import numpy as np
import pytest
from farfield.geometry.camera import camera_frame
from farfield.geometry.cells import build_cells, find_cell
from farfield.settings import Settings, VisibilitySettings
from farfield.visibility.free import choose_rule, is_free, whole
from farfield.visibility.merge import merge
from farfield.visibility.rays import Rays
from farfield.visibility.sample import plan_shards, see
from farfield.visibility.solids import place_triangles
from naive.conservative import is_free as naive_is_free
from naive.visibility import object_triangles
from towns import town

from .test_conservative import GROUND, kept, scene, town_blocks

PX, NEAR, FAR = 256, 0.05, 400.0
VERTEX = """#version 330
in vec3 at; uniform mat4 view; void main() { gl_Position = view * vec4(at, 1.0); }"""
FRAGMENT = """#version 330
out float depth; void main() { depth = 1.0 / gl_FragCoord.w; }"""


class Camera:
    """Draws the distance along the view direction to the nearest of some triangles; FAR where there is none."""

    def __init__(self, gl):
        self.gl, self.program = gl, gl.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)
        self.picture = gl.texture((PX, PX), 1, dtype="f4")
        self.frame = gl.framebuffer([self.picture], gl.depth_renderbuffer((PX, PX)))

    def depths(self, triangles, eye, direction):
        right, up, forward = camera_frame(direction)
        f, ratio = 1 / np.tan(np.radians(22.5)), (FAR + NEAR) / (NEAR - FAR)
        turn = np.eye(4)
        turn[:3, :3] = [right, up, -forward]
        lens = np.array([[f, 0, 0, 0], [0, f, 0, 0], [0, 0, ratio, 2 * FAR * NEAR / (NEAR - FAR)], [0, 0, -1, 0]])
        self.program["view"].write(np.ascontiguousarray((lens @ turn).T.astype("f4")))
        corners = np.ascontiguousarray((triangles.reshape(-1, 3) - eye).astype("f4"))
        buffer = self.gl.buffer(corners)
        array = self.gl.vertex_array(self.program, [(buffer, "3f", "at")])
        self.frame.use()
        self.gl.enable_only(self.gl.DEPTH_TEST)
        self.frame.clear(FAR, 0, 0, 0, depth=1.0)
        array.render()
        out = np.frombuffer(self.picture.read(), "f4").reshape(PX, PX).copy()
        array.release()
        buffer.release()
        return out


def missed_pixels(camera, triangles, objects, seen, eye, direction):
    """Return how many pixels show something farther when only the triangles of the objects in `seen` are drawn."""
    whole = camera.depths(triangles, eye, direction)
    alone = camera.depths(triangles[np.isin(objects, list(seen))], eye, direction)
    return int((alone > whole * 1.001 + 0.01).sum())


@pytest.mark.parametrize("missed_ppm", [300.0])
def test_pictures_of_the_sets_alone_show_what_pictures_of_everything_show(gl, missed_ppm):
    level = town(225, seed=5, view_m=96.0)
    cells, rays = build_cells(level.view_boxes, level.cell_m), Rays(level)
    settings = Settings(visibility=VisibilitySettings(mode="sampled", missed_ppm=missed_ppm, rays=100_000))
    parts = [see(level, cells, n, settings=settings, mode="sampled", seen_share=None) for n in plan_shards(cells)]
    visible = merge(level, cells, parts)
    assert visible.missed_ppm_upper < 2 * missed_ppm
    triangles, objects, _ = object_triangles(level)
    camera, rng = Camera(gl), np.random.default_rng(7)
    low, high = level.view_boxes[0]
    missed = pixels = lost = 0
    while pixels < 60 * PX * PX:
        eye, heading = rng.uniform(low, high), rng.uniform(0, 2 * np.pi)
        # A camera nearer to a wall than the near plane would look through it.
        gap = np.maximum(np.maximum(level.object_box[:, 0] - eye, eye - level.object_box[:, 1]), 0)
        if not is_free(rays, eye[None], visible.rule)[0] or np.sqrt((gap**2).sum(1)).min() < 4 * NEAR:
            continue
        cell = find_cell(cells, level.view_boxes, eye)
        seen = set(visible.object[visible.row[cell] : visible.row[cell + 1]].tolist())
        direction = np.array([np.cos(heading), rng.uniform(-0.5, 0.5), np.sin(heading)])
        missed += missed_pixels(camera, triangles, objects, seen, eye, direction)
        nearest = int(np.argmin(((level.object_box.mean(1) - (eye + 15 * direction)) ** 2).sum(1)))
        lost += missed_pixels(camera, triangles, objects, seen - {nearest}, eye, direction) > 100
        pixels += PX * PX
    assert missed / pixels * 1e6 < 3 * visible.missed_ppm_upper, f"{missed} of {pixels}"
    assert lost > 20, "the test would not notice an object that is left out"


@pytest.mark.parametrize("seed", range(3))
def test_no_picture_shows_an_object_that_conservative_sets_drop(gl, seed):
    """Walls shared and slit, turned, open and floating houses: what the whole picture shows, the kept alone show, too.

    OpenGL rounds corners to single precision, which opens cracks: a pixel counts if the sight is free in float64.
    """
    rng = np.random.default_rng(seed)
    view = np.array([[[-24.0, 0.5, -24.0], [24.0, 3.0, 24.0]]])
    level = scene([*town_blocks(rng, 60), GROUND], view=view, cell_m=8.0)
    cells, keep = build_cells(level.view_boxes, level.cell_m), kept(level)
    placed, camera = place_triangles(level), Camera(gl)
    ground = Rays(level)
    rule = choose_rule(ground, whole(level.view_boxes, cell_m=level.cell_m))
    pictures = wrong = before = noticed = 0
    while pictures < 25:
        cell = int(rng.integers(cells.n_cells))
        eye = rng.uniform(*cells.cell_box[cell])
        if not is_free(ground, eye[None], rule)[0]:
            continue
        heading = rng.uniform(0, 2 * np.pi)
        direction = np.array([np.cos(heading), rng.uniform(-0.3, 0.3), np.sin(heading)])
        all_of_it = camera.depths(placed.corner, eye, direction)
        alone = camera.depths(placed.corner[keep[cell][placed.object]], eye, direction)
        pictures += 1
        dropped_only = camera.depths(placed.corner[~keep[cell][placed.object]], eye, direction)
        before += int((dropped_only < FAR).sum())
        near = int(np.argmin(((level.object_box[:-1].mean(1) - (eye + 15 * direction)) ** 2).sum(1)))
        lacking = camera.depths(
            placed.corner[(keep[cell] & (np.arange(level.n_objects) != near))[placed.object]], eye, direction
        )
        noticed += int((lacking > all_of_it * 1.001 + 0.01).sum() > 100)
        for j, i in np.argwhere((alone > all_of_it * 1.001 + 0.01) & (all_of_it < FAR)):
            right, up, forward = camera_frame(direction)
            half = np.tan(np.radians(22.5))
            a, b = ((2 * (k + 0.5) / PX - 1) * half for k in (i, j))
            point = eye + all_of_it[j, i] * (forward + a * right + b * up)
            wrong += naive_is_free(eye, eye + (point - eye) * 0.999, placed.corner, placed.two_sided)
    assert before > 1000, "nothing that is dropped stands before any camera: the test tests nothing"
    assert noticed > 5, "the test would not notice an object that is left out"
    assert not wrong
