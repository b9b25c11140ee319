"""What a scene did not need: each stage is skipped by a scene without need of it, and the report says so."""

import importlib
import json
from types import SimpleNamespace

import numpy as np
import pytest
from farfield.bake.gl.context import NoContext
from farfield.candidates.model import BOX
from farfield.columns import dataclass_parts
from farfield.evaluation.left_out import left_out
from farfield.evaluation.report import _single_layer
from farfield.hierarchy.build import build_hierarchy
from farfield.rendertime.cost import build_cost_model
from farfield.scene.model import Scene
from farfield.settings import from_mapping
from farfield.stages import Stage
from farfield.steps import impostors, level
from farfield.steps.model import Inputs
from panels import Panel, box_cell, chosen, panel_scene
from towns import town

bake = importlib.import_module("farfield.bake.bake")


def stage(name, *, skipped=None, shards=1, reused=0, seconds=1.0):
    return {"name": name, "skipped": skipped, "shards": shards, "reused": reused, "seconds": seconds}


FULL = {
    "problem_views": 10, "impostors": 4, "candidates": 20_000, "cells": 100, "textures": 3, "single_layer_impostors": 0,
    "software": {"renderer": "NVIDIA H100"}, "settings": {"proof": {"pairs": 200}},
    "stages": [stage(str(s)) for s in Stage],
}  # fmt: skip


def rows(**more):
    stages = [stage(**s) if isinstance(s, dict) else s for s in more.pop("stages", FULL["stages"])]
    return {row["need"]: row for row in left_out({**FULL, "stages": stages, **more})}


def inputs(settings, models):
    artifacts = {s: b"".join(bytes(p) for p in dataclass_parts(model)) for s, model in models.items()}
    return Inputs(settings, artifacts, dict.fromkeys(models, "0" * 64))


def test_a_scene_that_needs_everything_leaves_nothing_out():
    assert rows() == {}


def test_within_the_budget_everywhere():
    """No problem view: candidates are skipped, and with them what is built of them."""
    no_views, some = (SimpleNamespace(cell=np.zeros(n, np.int32)) for n in (0, 2))
    why = level.no_problem(SimpleNamespace(get=lambda stage: no_views))
    assert why is not None
    assert level.no_problem(SimpleNamespace(get=lambda stage: some)) is None
    empty = SimpleNamespace(cluster=np.zeros(0, np.int32))
    assert impostors.nothing_chosen(SimpleNamespace(get=lambda stage: empty))
    gone = [stage(name, skipped=why, shards=0) for name in ("candidates", "bake", "bound", "proof")]
    (row,) = rows(problem_views=0, impostors=0, stages=gone).values()
    assert (row["need"], row["stages"], row["seconds"]) == ("impostors", ["candidates", "bake", "bound", "proof"], None)


def test_no_occlusion():
    """Houses on a wide raster are all seen from everywhere: `auto` skips, and `off` does; a wall before them asks for it."""
    open_town = town(16, block_m=60.0, view_m=32.0)
    why = level.visibility_skip(inputs(from_mapping({}), {Stage.SCENE: open_town}))
    assert why is not None
    assert "does not pay" in why
    off = from_mapping({"visibility": {"mode": "off"}})
    assert "off" in (level.visibility_skip(inputs(off, {Stage.SCENE: open_town})) or "")
    on = from_mapping({"visibility": {"mode": "sampled"}})
    assert level.visibility_skip(inputs(on, {Stage.SCENE: open_town})) is None
    row = rows(stages=[stage("visibility", skipped=why, shards=0)])["occlusion"]
    assert row["stages"] == ["visibility"]
    assert row["seconds"] == [3.0, 26.0]
    assert "100 cells at 0.03 to 0.26 s" in row["basis"]


def test_no_levels_of_detail():
    calls = inputs(from_mapping({"budget": "20 calls"}), {Stage.SCENE: town(4)})
    why = level.detail_skip(calls)
    assert why is not None
    row = rows(stages=[stage("detail", skipped=why, shards=0)])["levels of detail"]
    assert (row["seconds"], row["basis"]) == (None, "not measured")


def test_no_textures(monkeypatch):
    """A level without textures decodes none."""
    monkeypatch.setattr("farfield.bake.textures._image", lambda scene, x: pytest.fail("a texture was decoded"))
    scene = panel_scene([Panel(low=(-2, 0, -40), u=(4, 0, 0), v=(0, 4, 0))])
    assert len(baked(scene).tile_size)
    assert len(scene.texture_byte) - 1 == 0
    assert list(rows(textures=0)) == ["textures"]


def baked(scene: Scene, renderer="numba"):
    settings = from_mapping({"camera": {"width": 320, "height": 180}})
    return bake.bake_batch(
        scene, build_hierarchy(scene), build_cost_model(scene, settings=settings),
        chosen([0], BOX, box_cell((-2, 1, -2), (2, 3, 2))), settings=settings, impostors=(0, 1), renderer=renderer,
    )  # fmt: skip


def test_impostors_of_one_layer():
    flat = panel_scene([Panel(low=(-2, 0, -40), u=(4, 0, 0), v=(0, 4, 0))])
    deep = panel_scene([Panel(low=(-2, 0, -40), u=(4, 0, 0), v=(0, 1, -30))])
    assert (_single_layer(baked(flat)), _single_layer(baked(deep))) == (1, 0)
    assert len(np.unique(baked(deep).plane)) > 1
    row = rows(single_layer_impostors=3)["more than one layer"]
    assert "3 of 4 impostors" in row["why"]


def test_unchanged_input():
    """Shards that an earlier job had done: some, at the rate of the others; all, without a figure."""
    found = rows(stages=[stage("bake", shards=10, reused=8, seconds=4.0), stage("scene", shards=1, reused=1)])
    assert found["bake anew"]["seconds"] == [16.0, 16.0]
    assert found["bake anew"]["stages"] == []
    assert (found["scene anew"]["seconds"], found["scene anew"]["stages"]) == (None, ["scene"])


def test_no_gpu(monkeypatch):
    """Where no OpenGL is, the twin in numba records, and says so."""

    def none(process):
        raise NoContext("no EGL")

    monkeypatch.setattr(bake, "_gl_recorder", none)
    found = baked(panel_scene([Panel(low=(-2, 0, -40), u=(4, 0, 0), v=(0, 4, 0))]), "auto")
    assert found.renderer == "numba"
    for renderer, left in ((found.renderer, True), ("Mesa/X.org, llvmpipe (LLVM 15)", True), ("NVIDIA H100", False)):
        assert ("a GPU" in rows(software={"renderer": renderer})) == left


def test_what_was_asked_to_be_left_out_has_the_rate_of_other_scenes():
    found = rows(stages=[stage("bound", skipped="placement.bound is off"), stage("proof", skipped="proof.mode is off")])
    assert found["a lower bound"]["seconds"] == [8.0, 8.0]
    assert found["pictures of impostors"]["seconds"] == [3.0, 28.0]
    json.dumps(found, allow_nan=False)
