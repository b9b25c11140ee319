"""Bake to evaluation: texels, files, and questions to them."""

import numpy as np
import pytest
from benchmarks.inputs import OFF, Level
from benchmarks.measure import best_seconds, twin_seconds
from farfield.bake.bake import _surface, find_recorder
from farfield.bake.clip import bound, cut, gather
from farfield.bake.sheets import lay_out
from farfield.bake.textures import decode
from farfield.evaluation import kernels
from farfield.evaluation.verify import Eye, draw_views, verify
from farfield.impostor.plan import plan_layers
from farfield.placementdb.layout import LEVELS
from farfield.placementdb.pages import page_image
from farfield.placementdb.read import Placement
from naive import coverage as naive_coverage
from naive import evaluation as naive_evaluation
from naive import placementdb as naive_placementdb
from placements import texels

IMPOSTORS = 20  # of the bake at full resolution


@pytest.fixture(scope="module")
def folder(coarse_cutout, tmp_path_factory):
    return coarse_cutout.save(tmp_path_factory.mktemp("placement"))


@pytest.mark.parametrize("renderer", ["numba", "egl"])
def test_bake(renderer, cutout, coarse_cutout, request, report):
    if renderer == "egl":
        request.getfixturevalue("gl")
    times_naive, naive_input = coverage_ratio(renderer, coarse_cutout)
    span = (0, min(IMPOSTORS, len(cutout.placement.cluster)))
    baked = cutout.run_bake(renderer, span)
    seconds = best_seconds(lambda: cutout.run_bake(renderer, span))
    report(
        stage=f"bake {renderer}", work="record, shade and crop layers", input=f"{cutout.name}, {span[1]} impostors",
        seconds=seconds, rate=baked.tile_data.size / 4 / seconds, unit="texels/s", times_naive=times_naive,
        naive_input=naive_input, least_bytes=baked.tile_data.nbytes,
    )  # fmt: skip


def coverage_ratio(renderer: str, level: Level) -> tuple[float, str]:
    """Return the naive twin's time over the renderer's for the texels that one impostor's pieces touch, and on what."""
    scene, p = level.scene, level.placement
    i = int(np.argsort(p.bytes, kind="stable")[len(p.bytes) // 4])
    cluster, kind, cell = int(p.cluster[i]), int(p.kind[i]), p.view_cell[i]
    objects = int(level.hierarchy.start[cluster]), int(level.hierarchy.stop[cluster])
    plan = plan_layers(kind, cell, level.hierarchy.box[cluster], settings=level.settings)
    sources = gather(scene, objects, plan, kind=kind, view_cell=cell)
    pieces = cut(sources, plan)
    slabs = bound(pieces, plan)
    surface = _surface(scene, objects, decode(scene, np.zeros(0, np.int32)))
    record, _ = find_recorder(renderer)
    sheets = lay_out(slabs)
    ours = best_seconds(lambda: [record(sources, pieces, slabs, surface, *sheet) for sheet in sheets])
    width, height = (int(n) for n in plan.resolution)
    twin = twin_seconds(lambda: [naive_coverage.texels(t, width, height) for t in pieces.snapped.tolist()])
    return twin / ours, f"coverage of {len(pieces.snapped)} pieces, {width}x{height} texels"


def test_placementdb(coarse_cutout, report):
    block = texels(256, 192, 1)
    ours = best_seconds(lambda: page_image([(0, 0, block)]))
    twin = twin_seconds(lambda: [naive_placementdb.coarser(block, k) for k in range(len(LEVELS))])
    seconds = best_seconds(coarse_cutout.run_placementdb)
    size = sum(map(len, coarse_cutout.files.values()))
    n = coarse_cutout.baked.tile_data.size / 4
    report(
        stage="placementdb", work="cut, pack, encode, write",
        input=f"{coarse_cutout.name}, {len(coarse_cutout.placement.cluster)} impostors, {size / 1e6:.1f} MB",
        seconds=seconds, rate=n / seconds, unit="texels/s", times_naive=twin / ours,
        naive_input="a page of one 256x192 block", least_bytes=size + int(4 * n),
    )  # fmt: skip


def test_lookup(coarse_cutout, folder, report):
    placement, level = Placement.open(folder), coarse_cutout
    asked = list(draw_views(placement, 500, 0))
    made = {
        "scene": level.scene, "cells": level.cells, "views": level.views, "placement": level.repaired,
        "hierarchy": level.hierarchy, "visible": OFF, "model": level.model,
    }  # fmt: skip
    few = asked[:10]
    ours = best_seconds(lambda: [placement.lookup(*q) for q in few])
    twin = twin_seconds(lambda: [naive_placementdb.lookup(made, *q) for q in few])
    seconds = best_seconds(lambda: [placement.lookup(*q) for q in asked])
    report(
        stage="placementdb", work="look up what to draw", input=f"{level.name}, {len(asked)} views", seconds=seconds,
        rate=len(asked) / seconds, unit="lookups/s", times_naive=twin / ours, naive_input=f"{len(few)} lookups",
        least_bytes=sum(8 * len(placement.lookup(*q).objects) for q in asked),
    )  # fmt: skip


def test_evaluation(coarse_cutout, folder, report):
    placement, boxes = Placement.open(folder), coarse_cutout.scene.object_box[:50]
    eye = Eye(placement)
    at, direction = next(iter(draw_views(placement, 1, 0)))
    local, out = at - placement.origin_m, np.empty(len(boxes))
    frame, ids = eye.frame(direction), np.arange(len(boxes))
    ours = best_seconds(lambda: kernels.boxes_share(boxes, ids, local, frame, out))
    camera = coarse_cutout.settings.camera
    screen = camera.fov_deg, camera.width, camera.height
    twin = twin_seconds(lambda: [naive_evaluation.box_share(b, local, direction, *screen) for b in boxes])
    n = 500
    seconds = best_seconds(lambda: verify(folder, views=n))
    report(
        stage="evaluation", work="verify from the files", input=f"{coarse_cutout.name}, {n} views", seconds=seconds,
        rate=n / seconds, unit="views/s", times_naive=twin / ours, naive_input="share of the screen of 50 boxes, one view",
        least_bytes=n * coarse_cutout.scene.object_box.nbytes,
    )  # fmt: skip
