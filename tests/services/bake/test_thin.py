"""A cluster of more triangles than are taken at once bakes to the same bytes, in bounded memory."""

import dataclasses
import gc
import mmap
import tracemalloc

import farfield.bake.beside
import farfield.bake.textures
import farfield.bake.thin
import numpy as np
import pytest
from farfield.bake.bake import bake_batch
from farfield.candidates.model import BOX
from farfield.columns import pack_dataclass
from farfield.hierarchy.build import build_hierarchy
from farfield.rendertime.cost import build_cost_model
from farfield.scene.model import MASK, OPAQUE
from farfield.settings import from_mapping
from panels import Panel, box_cell, chosen, field, panel_scene
from towns import town

SETTINGS = from_mapping({"camera": {"width": 320, "height": 180}})
CELL = box_cell((-2, 1, -2), (2, 3, 2))


def bake(scene, clusters, renderer="numba"):
    hierarchy, model = build_hierarchy(scene), build_cost_model(scene, settings=SETTINGS)
    placement = chosen(clusters, BOX, CELL)
    span = (0, len(clusters))
    return bake_batch(scene, hierarchy, model, placement, settings=SETTINGS, impostors=span, renderer=renderer)


def distant(scene, least_m=20.0, most=3):
    """Return the largest clusters that are far enough from the view cell."""
    hierarchy = build_hierarchy(scene)
    gap = np.maximum(np.maximum(hierarchy.box[:, 0] - CELL[3:6], CELL[:3] - hierarchy.box[:, 1]), 0)
    far = np.flatnonzero(np.sqrt((gap**2).sum(1)) > least_m)
    return far[np.argsort(hierarchy.start[far] - hierarchy.stop[far], kind="stable")][:most].tolist()


def fence():
    """One object of panels behind each other, one in three with holes, one in three textured; some share a plane."""
    rng = np.random.default_rng(5)
    image = rng.integers(0, 256, (16, 16, 4), np.uint8)
    image[..., 3] = np.where(rng.random((16, 16)) < 0.5, 255, 0)
    panels = [
        Panel(low=(float(x), float(y), -30.0 - 0.5 * (i // 2)), u=(4.0, 0.5 * (i % 3), 0.0), v=(0.0, 3.0, 0.4 * (i % 2)),
              material=i % 3)
        for i, (x, y) in enumerate(rng.uniform((-8, 0), (4, 3), (60, 2)))
    ]  # fmt: skip
    scene = panel_scene(
        panels, base_color=[(0.8, 0.2, 0.2, 1.0), (1.0, 1.0, 1.0, 1.0), (0.3, 0.3, 0.9, 1.0)],
        alpha_mode=[OPAQUE, MASK, OPAQUE], double_sided=[True, True, True], texture=[-1, 0, 0], images=[image],
    )  # fmt: skip
    box = scene.object_box
    return dataclasses.replace(
        scene, mesh_primitive=np.array([0, len(panels)]), object_mesh=scene.object_mesh[:1],
        object_matrix=scene.object_matrix[:1], object_box=np.array([[box[:, 0].min(0), box[:, 1].max(0)]]),
        object_triangles=np.array([2 * len(panels)]), object_calls=np.array([len(panels)]),
        object_bytes=scene.object_bytes[:1], object_replaceable=np.ones(1, bool), object_name=("fence",),
        object_look=scene.object_look[:1],
    )  # fmt: skip


@pytest.mark.parametrize("renderer", ["numba", "egl"])
def test_a_large_cluster_bakes_to_the_same_bytes_however_it_is_cut(renderer, request, monkeypatch):
    if renderer == "egl":
        request.getfixturevalue("gl")
    for scene in (town(100, triangles=60), fence()):
        clusters = distant(scene)
        assert len(clusters)
        whole = pack_dataclass(bake(scene, clusters, renderer))
        for most in (7, 64) if renderer == "numba" else (40,):
            monkeypatch.setattr(farfield.bake.thin, "MOST", most)
            monkeypatch.setattr(farfield.bake.beside, "BATCH", most)
            assert pack_dataclass(bake(scene, clusters, renderer)) == whole
        monkeypatch.undo()


def test_what_does_not_show_is_dropped_as_it_comes(monkeypatch):
    """Of a field whose triangles are many a texel and hide each other, few show at one of its points."""
    kept = []
    visible = farfield.bake.thin._visible

    def count(sources, **more):
        found = visible(sources, **more)
        kept.append((len(sources.vertex), len(found.vertex)))
        return found

    monkeypatch.setattr(farfield.bake.thin, "MOST", 5_000)
    monkeypatch.setattr(farfield.bake.thin, "_visible", count)
    bake(field(400), [0])
    assert max(given for given, _ in kept) < 50_000  # of 320,000
    assert all(left < 0.8 * given for given, left in kept)


def test_memory_does_not_grow_with_the_triangles(monkeypatch):
    scene = field(400)
    peaks = []
    for most in (10**9, 1 << 13):
        monkeypatch.setattr(farfield.bake.thin, "MOST", most)
        gc.collect()
        tracemalloc.start()
        try:
            bake(scene, [0])
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert peaks[0] > 150 * 2 * 400**2
    assert peaks[1] < peaks[0] / 3, peaks


def test_textures_beyond_what_is_held_are_the_same_in_a_file(monkeypatch):
    rng = np.random.default_rng(3)
    images = [rng.integers(0, 256, (h, w, 4), np.uint8) for h, w in ((300, 7), (1, 9), (33, 64), (517, 2))]
    scene = panel_scene(
        [Panel(low=(0, 0, 0), u=(1, 0, 0), v=(0, 1, 0), material=k) for k in range(4)], base_color=[(1, 1, 1, 1)] * 4,
        alpha_mode=[OPAQUE] * 4, double_sided=[True] * 4, texture=[0, 1, 2, 3], images=images,
    )  # fmt: skip
    held = farfield.bake.textures.decode(scene, np.arange(4))
    monkeypatch.setattr(farfield.bake.textures, "HELD", 5000)
    monkeypatch.setattr(farfield.bake.textures, "STRIP", 32)
    filed = farfield.bake.textures.decode(scene, np.arange(4))
    assert isinstance(filed.texel.base.obj, mmap.mmap)
    assert held.texel.base is None
    for a, b in zip(held, filed, strict=True):
        np.testing.assert_array_equal(a, b)
        assert a.dtype == b.dtype
        assert b.flags.writeable


def test_a_sheet_of_many_draw_calls_is_that_of_one(gl, monkeypatch):
    """Drivers may read a buffer after they were told to draw from it: nothing is written to it before they have."""
    whole = pack_dataclass(dataclasses.replace(bake(field(100), [0]), renderer=""))
    monkeypatch.setattr("farfield.bake.gl.record.BLOCKS", 512)
    assert pack_dataclass(dataclasses.replace(bake(field(100), [0], "egl"), renderer="")) == whole
