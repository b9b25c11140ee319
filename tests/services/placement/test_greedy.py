"""The lazy greedy chooses what the naive one does; what `place` returns keeps its promises."""

from dataclasses import replace

import numpy as np
import pytest
from farfield.placement.antichain import subtree_end
from farfield.placement.choose import choose
from farfield.placement.greedy import place
from farfield.placement.kernels import compare_ratios
from farfield.placement.prospects import find_prospects
from farfield.placement.repair import verdict
from farfield.settings import PlacementSettings, Settings
from farfield.stability import naive as rescored
from naive import greedy as naive

from .instances import flat_model, halving_refit, make_candidates, make_views, random_instance, random_tree, same_refit

SEEDS = range(100)


def placed(x, *, refit=None, assignment="fastest"):
    settings = Settings(placement=PlacementSettings(assignment=assignment))
    return place(
        None, x.hierarchy, x.model, x.cells, x.views, x.candidates, settings=settings, refit=refit or same_refit(x)
    )


def prospects(x):
    end = subtree_end(x.hierarchy.start, x.hierarchy.stop)
    return find_prospects(x.hierarchy, x.model, x.views, x.candidates, end=end), end


@pytest.mark.parametrize("seed", range(20))
def test_the_greedy_of_the_stability_report_chooses_the_naive_sequence(seed):
    x = random_instance(seed, n_objects=3 + seed % 9, n_candidates=4 + seed % 25)
    found, end = prospects(x)
    order, _ = naive.place(x.hierarchy, x.views, x.candidates, found.target)
    excess = np.maximum(x.views.cost - found.target, 0)
    assert rescored.greedy(x.candidates, excess=excess, end=end) == order


@pytest.mark.parametrize("seed", SEEDS)
def test_lazy_greedy_chooses_the_naive_sequence(seed):
    x = random_instance(seed, n_objects=3 + seed % 9, n_candidates=4 + seed % 25)
    found, end = prospects(x)
    order, shown = naive.place(x.hierarchy, x.views, x.candidates, found.target)
    choice = choose(x.candidates, excess=np.maximum(x.views.cost - found.target, 0), end=end)
    assert choice.step.tolist() == order
    assert choice.chosen.tolist() == sorted(set().union(*shown.values()))
    assert (np.diff(choice.step_over) < 0).all()
    if len(order):
        assert choice.step_bytes[-1] == x.candidates.bytes[choice.chosen].sum()


def test_ratios_compare_exactly_where_floats_tie():
    rng = np.random.default_rng(0)
    numbers = [0, 1, 2, 3, 2**31, 2**53, 2**53 + 1, 2**62, *map(int, rng.integers(1, 2**62, 40))]
    for a in numbers:
        for b, c, d in rng.choice(numbers[1:], (60, 3)):
            b, c, d = int(b), int(c), int(d)
            assert compare_ratios(a, b, c, d) == (a * d > c * b) - (a * d < c * b), f"{a=} {b=} {c=} {d=}"
    assert compare_ratios(2**53, 2**53 - 1, 2**53 + 1, 2**53) == 1


@pytest.mark.parametrize("seed", SEEDS)
def test_hopeless_views_are_those_that_no_antichain_of_all_candidates_helps(seed):
    x = random_instance(seed, n_objects=5, n_candidates=9)
    found, _ = prospects(x)
    c = x.candidates
    for v in range(len(x.views.cell)):
        at = [e for e in range(len(c.view)) if c.view[e] == v]
        owner = np.searchsorted(c.row, at, side="right") - 1
        best = int(x.views.cost[v]) - naive.best_saving(x.hierarchy, c.cluster[owner], c.saved[at])
        assert found.best[v] == best
        assert found.hopeless[v] == (best > x.model.target)
        near = min(int(x.views.cost[v]), -(-best * 105 // 100))
        assert found.target[v] == (near if best > x.model.target else x.model.target)
    assert found.smallest_budget == x.model.per_frame + max(0, *found.best)


@pytest.mark.parametrize("assignment", ["fastest", "least"])
@pytest.mark.parametrize("seed", SEEDS)
def test_every_view_meets_its_target_and_every_impostor_is_needed(seed, assignment):
    x = random_instance(seed, n_objects=6, n_candidates=12)
    p = placed(x, assignment=assignment)
    costs = naive.view_costs(x.hierarchy, x.views, p.cluster, p.cost, p.serve_row, p.serve)
    np.testing.assert_array_equal(p.view_cost, costs)
    assert (costs <= np.maximum(p.view_target, p.view_best)).all() and (costs >= p.view_best).all()
    assert set(p.serve.tolist()) == set(range(len(p.cluster)))
    keys = list(zip(p.cluster.tolist(), p.kind.tolist(), p.view_cell.tolist()))
    assert keys == sorted(keys)
    chosen = np.array([p.view_cell[s, 0] for s in range(len(p.cluster))], int)  # instances number candidates there
    assert naive.reaches(x.hierarchy, x.views, x.candidates, chosen, p.view_target)
    for s in range(len(chosen)):
        assert not naive.reaches(x.hierarchy, x.views, x.candidates, np.delete(chosen, s), p.view_target)


@pytest.mark.parametrize("seed", range(60))
def test_tightening_never_adds_bytes_nor_cost_and_serves_only_the_cells_it_was_fitted_to(seed):
    x = random_instance(seed, n_objects=7, n_candidates=14)
    before, after = placed(x), placed(x, refit=halving_refit)
    assert after.bytes.sum() <= before.bytes.sum()
    assert (after.view_cost <= after.view_target).all()
    for s in range(len(after.cluster)):
        views = np.flatnonzero([s in after.serve[a:b] for a, b in zip(after.serve_row, after.serve_row[1:])])
        low, high = after.view_cell[s, 0], after.view_cell[s, 3]
        if high < 1e6:
            assert ((low <= x.views.cell[views]) & (x.views.cell[views] + 1 <= high)).all()


def test_a_culprit_is_an_object_that_stays_geometry_and_the_most_expensive_comes_first():
    hierarchy = random_tree(np.random.default_rng(1), 20)
    costs = np.arange(1, 21)[None] * 10
    leaf = int(np.flatnonzero(hierarchy.stop - hierarchy.start == 1)[-1])
    c = make_candidates(hierarchy, costs, [leaf], [1], [5], [[0]])
    found = find_prospects(
        hierarchy, flat_model(100), make_views(20, costs, 1), c, end=subtree_end(hierarchy.start, hierarchy.stop)
    )
    replaced = int(hierarchy.start[leaf])
    assert found.culprit.tolist() == [o for o in range(19, -1, -1) if o != replaced][:16]
    assert found.culprit_row.tolist() == [0, 16]


def test_no_problem_views_give_an_empty_valid_placement():
    x = random_instance(0)
    views = make_views(8, np.zeros((0, 8), np.int64), 1)
    none = make_candidates(x.hierarchy, np.zeros((0, 8), np.int64), [], [], [], [])
    p = placed(replace(x, views=replace(views, worst_nonproblem=7), candidates=none))
    assert len(p.cluster) == 0 and p.serve_row.tolist() == [0] and p.smallest_budget == 7
    assert verdict(p, x.model) == "valid"


def test_budget_nought_is_infeasible_and_still_placed():
    x = random_instance(3, target=0)
    p = placed(replace(x, model=flat_model(-50, per_frame=50)))
    assert p.hopeless.any() and verdict(p, flat_model(-50, per_frame=50)) == "infeasible"
    assert p.smallest_budget == 50 + p.view_best.max()
    assert (p.view_cost <= p.view_target).all()


def test_one_near_object_alone_over_budget_is_hopeless_and_is_the_culprit():
    hierarchy = random_tree(np.random.default_rng(0), 1)
    costs = np.array([[500]])
    none = make_candidates(hierarchy, costs, [], [], [], [])
    x = replace(
        random_instance(0), hierarchy=hierarchy, views=make_views(1, costs, 1), candidates=none, model=flat_model(100)
    )
    p = placed(x)
    assert p.hopeless.tolist() == [True] and p.culprit.tolist() == [0] and p.view_cost.tolist() == [500]
    assert verdict(p, x.model) == "infeasible" and p.smallest_budget == 500


def test_identical_candidates_tie_by_id_and_one_view_takes_one():
    hierarchy = random_tree(np.random.default_rng(5), 4)
    costs = np.array([[10, 10, 10, 10]])
    c = make_candidates(hierarchy, costs, [0] * 6, [1] * 6, [9] * 6, [[0]] * 6)
    x = replace(
        random_instance(0), hierarchy=hierarchy, views=make_views(4, costs, 1), candidates=c, model=flat_model(5)
    )
    p = placed(x)
    assert len(p.cluster) == 1 and p.view_cell[0, 0] == 0 and p.view_cost.tolist() == [1]
    assert verdict(p, x.model) == "valid"


def test_read_only_inputs_give_the_same_placement():
    x = random_instance(11)

    def frozen(record):
        copies = {n: getattr(record, n).copy() for n in record.__slots__ if isinstance(getattr(record, n), np.ndarray)}
        for a in copies.values():
            a.flags.writeable = False
        return replace(record, **copies)

    y = replace(x, views=frozen(x.views), candidates=frozen(x.candidates), hierarchy=frozen(x.hierarchy))
    a, b = placed(x), placed(y)
    for name in a.__slots__:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_progress_rises_to_one():
    x = random_instance(4)
    shares = []
    place(
        None, x.hierarchy, x.model, x.cells, x.views, x.candidates, settings=Settings(), refit=same_refit(x),
        progress=lambda share, counters: shares.append(share),
    )  # fmt: skip
    assert shares == sorted(shares) and shares[-1] == 1.0
