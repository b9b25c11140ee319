"""Pictures drawn by OpenGL are an independent truth: with a cell's set alone hardly a pixel shows something farther."""

import numpy as np
import pytest
from farfield.geometry.camera import camera_frame
from farfield.geometry.cells import build_cells, find_cell
from farfield.settings import Settings, VisibilitySettings
from farfield.visibility.free import is_free
from farfield.visibility.merge import merge
from farfield.visibility.rays import Rays
from farfield.visibility.sample import plan_shards, see
from naive.visibility import object_triangles
from towns import town

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
    scene = town(225, seed=5, view_m=96.0)
    cells, rays = build_cells(scene.view_boxes, scene.cell_m), Rays(scene)
    settings = Settings(visibility=VisibilitySettings(mode="sampled", missed_ppm=missed_ppm, rays=100_000))
    parts = [see(scene, cells, n, settings=settings, mode="sampled", seen_share=None) for n in plan_shards(cells)]
    visible = merge(scene, cells, parts)
    assert visible.missed_ppm_upper < 2 * missed_ppm
    triangles, objects, _ = object_triangles(scene)
    camera, rng = Camera(gl), np.random.default_rng(7)
    low, high = scene.view_boxes[0]
    missed = pixels = lost = 0
    while pixels < 60 * PX * PX:
        eye, heading = rng.uniform(low, high), rng.uniform(0, 2 * np.pi)
        # A camera nearer to a wall than the near plane would look through it.
        gap = np.maximum(np.maximum(scene.object_box[:, 0] - eye, eye - scene.object_box[:, 1]), 0)
        if not is_free(rays, eye[None], visible.rule)[0] or np.sqrt((gap**2).sum(1)).min() < 4 * NEAR:
            continue
        cell = find_cell(cells, scene.view_boxes, eye)
        seen = set(visible.object[visible.row[cell] : visible.row[cell + 1]].tolist())
        direction = np.array([np.cos(heading), rng.uniform(-0.5, 0.5), np.sin(heading)])
        missed += missed_pixels(camera, triangles, objects, seen, eye, direction)
        nearest = int(np.argmin(((scene.object_box.mean(1) - (eye + 15 * direction)) ** 2).sum(1)))
        lost += missed_pixels(camera, triangles, objects, seen - {nearest}, eye, direction) > 100
        pixels += PX * PX
    assert missed / pixels * 1e6 < 3 * visible.missed_ppm_upper, f"{missed} of {pixels}"
    assert lost > 20, "the test would not notice an object that is left out"
