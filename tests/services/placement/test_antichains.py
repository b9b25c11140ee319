"""Best, least and lightest antichains against all antichains; reverse delete; repair after the bake."""

import numpy as np
import pytest
from farfield.placement.antichain import Offers, best_in_views, cheapest_offers, offers_of, subtree_end
from farfield.placement.assign import least_antichain
from farfield.placement.prune import keep
from farfield.placement.repair import repair, verdict
from farfield.placement.rescue import lightest_antichain, rescue
from naive import greedy as naive

from .instances import random_instance, random_tree
from .test_greedy import placed, prospects

SEEDS = range(120)


def offers(seed, most=9):
    rng = np.random.default_rng(seed)
    hierarchy = random_tree(rng, int(rng.integers(1, 9)))
    n = int(rng.integers(0, most))
    cluster = np.sort(rng.integers(0, len(hierarchy.start), n)).astype(np.int32)
    return hierarchy, cluster, rng.integers(1, 7, n), rng, subtree_end(hierarchy.start, hierarchy.stop)


def antichain(hierarchy, cluster):
    return not any(
        naive.inside(hierarchy, a, b) or naive.inside(hierarchy, b, a)
        for k, a in enumerate(cluster)
        for b in cluster[k + 1 :]
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_best_antichain_saves_as_much_as_any(seed):
    hierarchy, cluster, saved, _, end = offers(seed)
    take = np.empty(len(cluster), bool)
    row, id = np.array([0, len(cluster)]), np.arange(len(cluster), dtype=np.int32)
    best = best_in_views(row, id, saved, cluster, end, take)[0]
    assert best == naive.best_saving(hierarchy, cluster, saved) == saved[take].sum()
    assert antichain(hierarchy, cluster[take])


@pytest.mark.parametrize("seed", SEEDS)
def test_least_antichain_is_smallest_and_of_those_saves_most(seed):
    hierarchy, cluster, saved, rng, end = offers(seed)
    for need in {0, int(rng.integers(0, saved.sum() + 2)), int(rng.integers(0, saved.sum() + 2)), 1}:
        take = np.empty(len(cluster), bool)
        met = least_antichain(cluster, saved, need, end, take)
        expected = naive.least(hierarchy, cluster, saved, need) if need > 0 else (0, 0)
        assert met == (expected is not None), f"{seed=} {need=}"
        if met:
            assert (take.sum(), saved[take].sum()) == expected, f"{seed=} {need=}"
            assert antichain(hierarchy, cluster[take])


@pytest.mark.parametrize("seed", SEEDS)
def test_lightest_antichain_meets_the_need_and_nothing_that_saves_as_much_is_lighter(seed):
    hierarchy, cluster, saved, rng, end = offers(seed)
    price = rng.integers(0, 2000, len(cluster))
    need = int(rng.integers(1, saved.sum() + 2)) if len(saved) else 1
    take = np.empty(len(cluster), bool)
    met = lightest_antichain(cluster, saved, price, need, end, take)
    least = naive.lightest(hierarchy, cluster, saved, price, need)
    assert met == (least is not None)
    if met:
        assert saved[take].sum() >= need and antichain(hierarchy, cluster[take])
        assert price[take].sum() == naive.lightest(hierarchy, cluster, saved, price, saved[take].sum()) >= least


def test_lightest_antichain_takes_what_is_free():
    hierarchy = random_tree(np.random.default_rng(0), 4)
    leaves = np.flatnonzero(hierarchy.stop - hierarchy.start == 1).astype(np.int32)
    end, take = subtree_end(hierarchy.start, hierarchy.stop), np.empty(4, bool)
    assert lightest_antichain(leaves, np.array([5, 5, 5, 5]), np.array([10**9, 0, 10**9, 0]), 10, end, take)
    assert take.tolist() == [False, True, False, True]


@pytest.mark.parametrize("seed", range(60))
def test_rescue_reaches_every_target_from_nothing_and_keeps_what_was_chosen(seed):
    x = random_instance(seed)
    found, end = prospects(x)
    some = np.flatnonzero(np.random.default_rng(seed).random(len(x.candidates.cluster)) < 0.2).astype(np.int32)
    chosen = rescue(x.candidates, some, need=x.views.cost - found.target, end=end)
    assert set(some) <= set(chosen) and (np.diff(chosen) > 0).all()
    assert naive.reaches(x.hierarchy, x.views, x.candidates, chosen, found.target)


def test_cheapest_offers_hold_each_clusters_largest_saving():
    for seed in range(30):
        c = random_instance(seed).candidates
        row, id, saved = cheapest_offers(c.cluster, c.row, c.view, c.saved, 6)
        expected = {}
        for i in range(len(c.cluster)):
            for e in range(c.row[i], c.row[i + 1]):
                key = (int(c.view[e]), int(c.cluster[i]))
                if c.saved[e] > expected.get(key, (0, 0))[0]:
                    expected[key] = (int(c.saved[e]), i)
        got = {
            (v, int(c.cluster[id[e]])): (int(saved[e]), int(id[e])) for v in range(6) for e in range(row[v], row[v + 1])
        }
        assert got == expected
        assert all((np.diff(c.cluster[id[row[v] : row[v + 1]]]) > 0).all() for v in range(6))


def test_keep_numbers_the_offers_that_stay_anew():
    all = Offers(row=np.array([0, 2, 2, 5]), id=np.array([0, 2, 0, 1, 2], np.int32), saved=np.arange(5))
    some = keep(all, np.array([False, True, True]))
    assert some.row.tolist() == [0, 1, 1, 3] and some.id.tolist() == [1, 0, 1] and some.saved.tolist() == [1, 3, 4]


def test_offers_of_a_choice_are_its_entries_by_view():
    c = random_instance(2).candidates
    chosen = np.array([0, 2, 5], np.int32)
    row, id, saved = offers_of(chosen, c.row, c.view, c.saved, np.array([1, 0, 1, 1, 1, 1], bool))
    got = [(v, int(chosen[id[e]]), int(saved[e])) for v in range(6) for e in range(row[v], row[v + 1])]
    entries = [(int(i), e) for i in chosen for e in range(c.row[i], c.row[i + 1])]
    expected = [(int(c.view[e]), i, int(c.saved[e])) for i, e in entries if c.view[e] != 1]
    assert got == sorted(expected)


def repaired(x, p, *, cost):
    return repair(
        p, x.hierarchy, x.model, x.cells, x.views, x.candidates, measured_bytes=p.bytes - 1, measured_cost=cost,
        layers=p.layers,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(40))
def test_repair_with_cheaper_measurements_keeps_the_assignment_and_the_verdict(seed):
    x = random_instance(seed)
    p = placed(x)
    q = repaired(x, p, cost=p.cost // 2)
    np.testing.assert_array_equal(q.serve, p.serve)
    np.testing.assert_array_equal(q.bytes, p.bytes - 1)
    assert (q.view_cost <= p.view_cost).all() and not (q.view_cost > q.view_target).any()
    np.testing.assert_array_equal(
        q.view_cost, naive.view_costs(x.hierarchy, x.views, q.cluster, q.cost, q.serve_row, q.serve)
    )


@pytest.mark.parametrize("seed", range(60))
def test_repair_shows_an_impostor_that_failed_nowhere_new_and_says_what_still_fails(seed):
    x = random_instance(seed, n_candidates=20)
    p = placed(x)
    if not len(p.cluster):
        return
    cost = p.cost.copy()
    cost[0] = 2**40
    q = repaired(x, p, cost=cost)
    assert 0 not in q.serve
    np.testing.assert_array_equal(
        q.view_cost, naive.view_costs(x.hierarchy, x.views, q.cluster, q.cost, q.serve_row, q.serve)
    )
    failing = q.view_cost > q.view_target
    if (~q.hopeless[failing]).any():
        assert verdict(q, x.model) == "unproven"
    for v in range(len(x.views.cell)):
        shown = q.serve[q.serve_row[v] : q.serve_row[v + 1]]
        assert antichain(x.hierarchy, q.cluster[shown]) and (np.diff(shown) > 0).all()


def test_a_view_that_the_built_impostors_bring_to_the_budget_is_not_hopeless():
    despaired = 0
    for seed in range(40):
        x = random_instance(seed)
        p = placed(x)
        q = repaired(x, p, cost=np.zeros_like(p.cost))
        np.testing.assert_array_equal(q.hopeless, p.hopeless & (q.view_cost > x.model.target))
        assert len(q.culprit_row) == q.hopeless.sum() + 1 and q.culprit_row[-1] == len(q.culprit)
        assert (q.view_best <= q.view_cost).all() and (q.view_cost <= q.view_target).all()
        if p.hopeless.any() and not q.hopeless.any():
            despaired += 1
            assert verdict(q, x.model) == "valid" and q.smallest_budget <= x.model.budget
    assert despaired
