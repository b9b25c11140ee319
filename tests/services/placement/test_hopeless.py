"""Hopeless views are beyond help whatever is built; the policy says what they get; nobody pays for them unasked."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from benchmarks.inputs import town_level
from farfield.candidates.generate import refit
from farfield.impostor.cells import contains
from farfield.placement.antichain import subtree_end
from farfield.placement.complete import complete
from farfield.placement.greedy import cells_alone, place
from farfield.placement.prospects import find_prospects
from farfield.settings import PlacementSettings, Settings
from naive import greedy as naive

from .instances import make_candidates, random_instance, same_refit

SEEDS = range(24)


def placed(x, **policy):
    settings = Settings(placement=PlacementSettings(**policy))
    return place(None, x.hierarchy, x.model, x.cells, x.views, x.candidates, settings=settings, refit=same_refit(x))


def least_cost(hierarchy, views, v, cheapest):
    """The least that view v can cost if cluster c can be drawn for cheapest[c]."""

    def least(c):
        cost = cheapest.get(c, float("inf"))
        if hierarchy.left[c] < 0:
            return min(cost, naive.geometry_cost(hierarchy, views, c, v))
        return min(cost, least(hierarchy.left[c]) + least(hierarchy.right[c]))

    return least(0)


@pytest.mark.parametrize("budget", ["36 calls", "20 calls", "1.9 ms", "400 triangles"])
def test_no_set_of_cells_makes_a_candidate_that_would_help_a_hopeless_view(budget):
    level = town_level(90, budget=budget, view_m=32.0, interval_deg=22.5)
    h, views, cells, p = level.hierarchy, level.views, level.cells, level.placement
    assert cells.n_cells == 4 and p.hopeless.any()
    cheapest = {cell: {} for cell in range(4)}
    for c in range(len(h.start)):
        for members in [m for k in range(1, 5) for m in combinations(range(4), k)]:  # more than raw view cells can hold
            kind, view_cell, _, _, cost = refit(
                h.box[c], cells.cell_box[list(members)], model=level.model, settings=level.settings
            )  # fmt: skip
            for cell in np.flatnonzero(contains(kind, view_cell, cells.cell_box)):
                cheapest[cell][c] = min(cheapest[cell].get(c, cost), cost)
    best = [least_cost(h, views, v, cheapest[int(views.cell[v])]) for v in np.flatnonzero(p.hopeless)]
    np.testing.assert_array_equal(p.view_best[p.hopeless], best)
    assert min(best) > level.model.target
    assert p.smallest_budget == max(best) + level.model.per_frame
    if level.model.unit == "calls":
        assert (p.view_best < views.cost)[p.hopeless].any(), "the test should not be about views without any candidate"


@pytest.mark.parametrize("seed", SEEDS)
def test_what_single_cells_lack_joins_and_makes_the_best_exact(seed):
    x = random_instance(seed, n_objects=5, n_candidates=5)
    rng = np.random.default_rng(seed)
    n = len(x.hierarchy.start)
    costs = np.array([[naive.geometry_cost(x.hierarchy, x.views, int(leaf), v) for leaf in leaves(x.hierarchy)]
                      for v in range(len(x.views.cell))])  # fmt: skip
    price = rng.integers(0, 6, (x.cells.n_cells, n))

    def alone(cell):
        in_cell = np.flatnonzero(x.views.cell == cell)
        return make_candidates(x.hierarchy, costs, np.arange(n), price[cell], np.full(n, 50), [in_cell] * n)

    end = subtree_end(x.hierarchy.start, x.hierarchy.stop)
    full = complete(x.candidates, x.views, target=x.model.target, end=end, alone=alone)
    assert (np.diff(full.cluster) >= 0).all() and full.row[-1] == len(full.view) == len(full.saved)
    found = find_prospects(x.hierarchy, x.model, x.views, full, end=end)
    before = find_prospects(x.hierarchy, x.model, x.views, x.candidates, end=end)
    assert not (found.hopeless & ~before.hopeless).any()
    for v in np.flatnonzero(before.hopeless):
        cheapest = {c: price[x.views.cell[v], c] for c in range(n)}
        for i in range(len(x.candidates.cluster)):
            if v in x.candidates.view[x.candidates.row[i] : x.candidates.row[i + 1]]:
                c = int(x.candidates.cluster[i])
                cheapest[c] = min(cheapest[c], x.candidates.cost[i])
        assert found.best[v] == least_cost(x.hierarchy, x.views, v, cheapest)
    if before.hopeless.any():  # the first cell is looked at whatever the limit is, and it is the worst
        few = complete(x.candidates, x.views, target=x.model.target, end=end, alone=alone, most_fitted=1)
        some = find_prospects(x.hierarchy, x.model, x.views, few, end=end)
        cell = x.views.cell[np.argmax(before.best)]
        np.testing.assert_array_equal(some.best[x.views.cell == cell], found.best[x.views.cell == cell])
        assert (some.best >= found.best).all() and (some.best <= before.best).all()


def leaves(hierarchy):
    """Nodes of single objects, by object."""
    single = np.flatnonzero(hierarchy.left < 0)
    return single[np.argsort(hierarchy.start[single])]


@pytest.mark.parametrize("seed", SEEDS)
def test_geometry_spends_nothing_on_hopeless_views(seed):
    x = random_instance(seed, n_objects=6, n_candidates=12)
    p = placed(x, hopeless="geometry")
    np.testing.assert_array_equal(p.view_target[p.hopeless], x.views.cost[p.hopeless])
    chosen = np.array([p.view_cell[s, 0] for s in range(len(p.cluster))], int)
    for s in range(len(chosen)):  # each impostor is needed by a view that is not hopeless
        target = np.where(p.hopeless, 2**40, p.view_target)
        assert not naive.reaches(x.hierarchy, x.views, x.candidates, np.delete(chosen, s), target)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("slack", [1.0, 1.05, 1.5, 10.0])
def test_near_best_keeps_hopeless_views_within_the_slack(seed, slack):
    x = random_instance(seed, n_objects=6, n_candidates=12)
    p = placed(x, hopeless_slack=slack)
    for v in np.flatnonzero(p.hopeless):
        assert p.view_cost[v] <= p.view_target[v] <= max(p.view_best[v], slack * p.view_best[v] + 1)
        assert p.view_target[v] >= p.view_best[v]
    assert (p.view_target[~p.hopeless] == x.model.target).all()


@pytest.mark.parametrize("seed", range(30))
def test_more_budget_never_makes_more_problem_views_nor_more_hopeless_ones(seed):
    x = random_instance(seed, n_objects=6, n_candidates=12)
    over, hopeless = [], []
    for target in range(0, int(x.views.cost.max()) + 2, 3):
        p = placed(replace(x, model=replace(x.model, budget=target)))
        over.append((x.views.cost > target).sum()), hopeless.append(p.hopeless.sum())
        assert p.hopeless.any() == (target < p.smallest_budget)
    assert over == sorted(over, reverse=True) and hopeless == sorted(hopeless, reverse=True)


def test_a_view_that_only_a_thinned_out_candidate_could_help_is_helped():
    level = town_level(90, budget="40 calls", view_m=32.0, interval_deg=22.5)
    columns = ("cluster", "kind", "view_cell", "bytes", "layers", "cost", "view", "saved")
    bare = replace(
        level.candidates, **{name: getattr(level.candidates, name)[:0] for name in columns}, row=np.zeros(1, np.int64)
    )
    given = level.hierarchy, level.model, level.cells, level.views
    end = subtree_end(level.hierarchy.start, level.hierarchy.stop)
    without = find_prospects(level.hierarchy, level.model, level.views, bare, end=end)
    p = place(level.scene, *given, bare, settings=level.settings)
    np.testing.assert_array_equal(p.view_best[p.hopeless], level.placement.view_best[p.hopeless])
    np.testing.assert_array_equal(p.hopeless, level.placement.hopeless)
    assert p.hopeless.sum() < without.hopeless.sum()
    assert (p.view_cost <= p.view_target).all() and len(p.cluster)
    assert cells_alone(*given, Settings(placement=PlacementSettings(view_cells="raw"))) is None
