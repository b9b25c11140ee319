"""Memory over budget: each point is a set that holds its budget; bytes and views over fall; separate runs are near."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from benchmarks.inputs import town_level
from farfield.placement import curve
from farfield.placement.antichain import subtree_end
from farfield.placement.prospects import find_prospects
from farfield.placement.tighten import tighten
from farfield.settings import Settings
from naive import greedy as naive

from .instances import halving_refit, random_instance


@pytest.mark.parametrize("seed", range(30))
def test_every_point_holds_its_budget_and_nothing_rises(seed):
    x = random_instance(seed, n_objects=6, n_candidates=11)
    x = replace(x, model=replace(x.model, budget=x.model.budget + 7, per_frame=7))
    end = subtree_end(x.hierarchy.start, x.hierarchy.stop)
    target = find_prospects(x.hierarchy, x.model, x.views, x.candidates, end=end).target
    every = np.arange(len(x.candidates.cluster), dtype=np.int32)
    impostors, offers = curve.gather(x.candidates, every, len(target))

    def fit(impostors, offers, needed):
        return tighten(
            impostors, offers, needed=needed, view_cell=x.views.cell, hierarchy=x.hierarchy, cells=x.cells,
            refit=halving_refit,
        )  # fmt: skip

    points = list(
        curve.trace(
            impostors, offers, x.candidates, model=x.model, cost=x.views.cost, target=target, end=end, fit=fit
        )
    )  # fmt: skip
    assert [p.budget for p in points] == sorted({p.budget for p in points}) and points[0].budget == x.model.budget
    for before, after in pairwise(points):
        assert after.bytes <= before.bytes and after.over <= before.over
    for p in points:
        held = 0
        for v in range(len(target)):
            at = slice(p.offers.row[v], p.offers.row[v + 1])
            saved = naive.best_saving(x.hierarchy, p.impostors.cluster[p.offers.id[at]], p.offers.saved[at])
            held += x.views.cost[v] - saved <= p.budget - 7
        assert len(target) - held == p.over and p.bytes == p.impostors.bytes.sum()
    if x.views.cost.max() + 7 > x.model.budget:
        assert points[-1].bytes == points[-1].over == 0


def test_jobs_at_the_other_budgets_need_about_as_much():
    level = town_level(300, budget="75 calls", view_m=32.0)
    p = level.placement
    assert p.curve_bytes[0] == p.bytes.sum() and p.curve_budget[0] == 75
    ratio = []
    for budget, size in zip(p.curve_budget[1:-1], p.curve_bytes[1:-1]):
        if budget in (79, 90, 98, 105):
            alone = town_level(300, budget=f"{budget} calls", view_m=32.0).placement
            ratio.append(size / alone.bytes.sum())
    print("curve over separate runs:", dict(zip(p.curve_budget.tolist(), p.curve_bytes.tolist())), np.round(ratio, 3))
    assert len(ratio) == 4
    assert min(ratio) > 0.8
    assert max(ratio) < 1.3


def test_a_scene_within_its_budget_has_a_curve_of_one_point_without_bytes():
    level = town_level(60, budget="1000 calls", view_m=32.0)
    p = level.placement
    assert (p.curve_budget.tolist(), p.curve_bytes.tolist(), p.curve_over.tolist()) == ([1000], [0], [0])
    assert Settings().placement.time_limit_s is None and not p.stopped
