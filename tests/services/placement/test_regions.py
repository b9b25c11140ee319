"""Regions: cut without gaps, chosen apart, merged into a placement that holds what a single run holds."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.inputs import town_level
from farfield.columns import pack_dataclass, unpack_dataclass
from farfield.pipeline import STEPS
from farfield.placement.greedy import cells_alone, place
from farfield.placement.model import Placement
from farfield.placement.regions import choose_in_region, plan_regions, within
from farfield.settings import PlacementSettings, Settings
from farfield.stages import Stage
from farfield.steps.model import Inputs, shard_key
from naive import greedy as naive

from .instances import random_instance, same_refit


def place_in_regions(scene, hierarchy, model, cells, views, candidates, n, *, settings, refit=None):
    alone = cells_alone(hierarchy, model, cells, views, settings) if refit is None else None
    regions = [
        choose_in_region(hierarchy, model, views, candidates, settings=settings, region=region, alone=alone)
        for region in plan_regions(cells, views, n)
    ]
    return place(scene, hierarchy, model, cells, views, candidates, settings=settings, regions=regions, refit=refit)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 64])
def test_regions_hold_every_problem_view_once_and_are_subtrees(n):
    level = town_level(120, budget="30 calls", view_m=48.0)
    regions = plan_regions(level.cells, level.views, n)
    assert 1 <= len(regions) <= n and (len(regions) == n or n > level.cells.n_cells)
    held = np.concatenate([np.flatnonzero((a <= level.views.cell) & (level.views.cell < b)) for a, b in regions])
    assert sorted(held.tolist()) == list(range(len(level.views.cell)))
    subtrees = set(zip(level.cells.start.tolist(), level.cells.stop.tolist()))
    assert all(region in subtrees for region in regions)


@pytest.mark.parametrize("seed", range(20))
def test_within_keeps_the_entries_of_these_views_and_nothing_else(seed):
    x = random_instance(seed)
    c, (first, last) = x.candidates, sorted(np.random.default_rng(seed).integers(0, len(x.views.cell) + 1, 2).tolist())
    some, which = within(c, first, last)
    rows = [
        [(int(v) - first, int(s)) for v, s in zip(c.view[a:b], c.saved[a:b]) if first <= v < last]
        for a, b in zip(c.row, c.row[1:])
    ]
    assert which.tolist() == [i for i, row in enumerate(rows) if row]
    got = [list(zip(some.view[a:b].tolist(), some.saved[a:b].tolist())) for a, b in zip(some.row, some.row[1:])]
    assert got == [row for row in rows if row]
    np.testing.assert_array_equal(some.bytes, c.bytes[which])


@pytest.mark.parametrize("seed", range(30))
def test_merged_regions_meet_every_target_and_every_impostor_is_needed(seed):
    x = random_instance(seed, n_objects=6, n_cells=4, n_candidates=14)
    given = x.hierarchy, x.model, x.cells, x.views, x.candidates
    p = place_in_regions(None, *given, 3, settings=Settings(), refit=same_refit(x))
    alone = place(None, *given, settings=Settings(), refit=same_refit(x))
    np.testing.assert_array_equal(p.view_target, alone.view_target)
    np.testing.assert_array_equal(p.hopeless, alone.hopeless)
    assert (p.view_cost <= p.view_target).all()
    chosen = np.array([p.view_cell[s, 0] for s in range(len(p.cluster))], int)  # instances number candidates there
    for s in range(len(chosen)):
        assert not naive.reaches(x.hierarchy, x.views, x.candidates, np.delete(chosen, s), p.view_target)


@pytest.mark.parametrize("n", [2, 4])
def test_regions_of_a_town_cost_a_little_memory(n):
    level = town_level(300, budget="75 calls", view_m=64.0)
    given = level.scene, level.hierarchy, level.model, level.cells, level.views, level.candidates
    p = place_in_regions(*given, n, settings=level.settings)
    assert (p.view_cost <= p.view_target).all() and p.hopeless.sum() == level.placement.hopeless.sum()
    loss = p.bytes.sum() / level.placement.bytes.sum()
    print(f"{n} regions: {loss:.3f} of the single run's bytes")
    assert loss < 1.15


def test_regions_with_hopeless_views_agree_with_the_single_run_about_them():
    level = town_level(90, budget="40 calls", view_m=32.0, interval_deg=22.5)
    given = level.scene, level.hierarchy, level.model, level.cells, level.views, level.candidates
    p = place_in_regions(*given, 3, settings=level.settings)
    assert p.hopeless.any() and not p.hopeless.all()
    np.testing.assert_array_equal(p.view_best, level.placement.view_best)
    assert p.smallest_budget == level.placement.smallest_budget


def inputs_of(level, **policy):
    """What the placement step sees of a level."""
    artifacts = {
        Stage.SCENE: level.scene, Stage.HIERARCHY: level.hierarchy, Stage.RENDERTIME: level.model,
        Stage.VIEWSPACE: level.views, Stage.CANDIDATES: level.candidates,
    }  # fmt: skip
    settings = replace(level.settings, placement=PlacementSettings(**policy))
    return Inputs(settings, {k: pack_dataclass(v) for k, v in artifacts.items()}, dict.fromkeys(artifacts, "0" * 64))


def walked(inputs, shards):
    step = STEPS[Stage.PLACEMENT]
    return b"".join(step.merge(inputs, [b"".join(step.run(inputs, shard)) for shard in shards]))


def test_the_step_cuts_regions_only_where_it_is_told_to():
    level, step = town_level(120, budget="30 calls", view_m=48.0), STEPS[Stage.PLACEMENT]
    one, three = inputs_of(level), inputs_of(level, regions=3)
    assert step.plan(one) == ["all"] and len(step.plan(three)) == 3
    assert walked(one, step.plan(one)) == pack_dataclass(level.placement)
    merged = unpack_dataclass(Placement, walked(three, step.plan(three)))
    assert (merged.view_cost <= merged.view_target).all() and not merged.stopped
    assert walked(three, step.plan(three)) == pack_dataclass(merged)


def test_a_time_limit_is_in_no_key_but_marks_what_it_stopped():
    level, step = town_level(120, budget="30 calls", view_m=48.0), STEPS[Stage.PLACEMENT]
    free, short = inputs_of(level, regions=2), inputs_of(level, regions=2, time_limit_s=1e-6)
    assert not step.timed(free.settings) and step.timed(short.settings)
    assert shard_key(step, free, [0, 1]) == shard_key(step, short, [0, 1]) != shard_key(step, inputs_of(level), [0, 1])
    assert unpack_dataclass(Placement, walked(short, step.plan(short))).stopped


def test_choices_that_a_clock_stopped_leave_no_checkpoint_for_the_merge(tmp_path):
    level, step = town_level(120, budget="30 calls", view_m=48.0), STEPS[Stage.PLACEMENT]
    for limit, kept in ((1e-6, False), (1000.0, True)):
        inputs = replace(inputs_of(level, regions=2, time_limit_s=limit), checkpoint=tmp_path / "choices")
        pieces = [b"".join(step.run(replace(inputs, checkpoint=None), shard)) for shard in step.plan(inputs)]
        step.merge(inputs, pieces)
        assert inputs.checkpoint.exists() == kept
