"""The lower bound is never above the lightest set found by trying all, whatever its prices, and not far below it."""

import numpy as np
import pytest
from farfield.candidates.model import Candidates
from farfield.placement import bound
from farfield.placement.antichain import Offers, offers_of
from farfield.placement.bound import lower_bound_bytes
from farfield.placement.bound_lp import dual_prices
from farfield.placement.rescue import rescue
from farfield.placement.tighten import Impostors
from naive import greedy as naive

from .instances import random_instance
from .test_greedy import placed, prospects

SEEDS = range(50)


def chosen_and_offers(x, chosen):
    c = x.candidates
    row, id, saved = offers_of(chosen, c.row, c.view, c.saved, np.ones(len(x.views.cell), bool))
    columns = {name: getattr(c, name)[chosen] for name in ("cluster", "kind", "view_cell", "bytes", "layers", "cost")}
    return Impostors(**columns), Offers(row=row, id=id, saved=saved)


@pytest.fixture(scope="module")
def problems():
    """(instance, chosen impostors and offers, need, end, bytes of the lightest set, bytes placed) of many seeds."""
    made = []
    for seed in SEEDS:
        x = random_instance(seed, n_objects=6, n_candidates=9)
        found, end = prospects(x)
        need = x.views.cost - found.target
        chosen = chosen_and_offers(x, rescue(x.candidates, np.zeros(0, np.int32), need=need, end=end))
        lightest = naive.lightest_bytes(x.hierarchy, x.views, x.candidates, found.target)
        made.append((x, chosen, need, end, lightest, placed(x).bytes.sum()))
    return made


@pytest.mark.parametrize(
    ("method", "many", "share"), [("lagrangian", 0, 0.83), ("lp", 10**9, 0.9), ("lagrangian", 10**9, 0.87)]
)
def test_no_set_of_candidates_weighs_less_than_the_bound_nor_much_more(problems, method, many, share, monkeypatch):
    monkeypatch.setattr(bound, "MANY_ENTRIES", many)  # 0: as for a whole city
    total_bound, total_lightest = 0, 0
    for seed, (x, chosen, need, end, lightest, bytes) in zip(SEEDS, problems, strict=True):
        low = lower_bound_bytes(x.candidates, *chosen, need=need, end=end, method=method)
        assert low <= lightest <= bytes, f"{seed=}"
        assert (low == 0) == (lightest == 0), f"{seed=}"
        total_bound, total_lightest = total_bound + low, total_lightest + lightest
    assert total_bound >= share * total_lightest, f"{total_bound=} {total_lightest=}"


def test_no_prices_make_the_bound_wrong(problems, monkeypatch):
    """A solver that lies about its duals weakens the bound, and never lifts it above the lightest set."""
    rng = np.random.default_rng(5)
    for seed, (x, chosen, need, end, lightest, _) in zip(SEEDS, problems, strict=True):

        def lie(row, view, saved, *, need, **given):
            magnitude = 10.0 ** rng.uniform(-3, 3)
            return rng.random(len(need)) * magnitude, rng.random(len(view)).astype(np.float32) * rng.integers(0, 2)

        monkeypatch.setattr(bound, "dual_prices", lie)
        for _ in range(8):
            assert lower_bound_bytes(x.candidates, *chosen, need=need, end=end, method="lp") <= lightest, f"{seed=}"


def test_what_is_proven_from_the_linear_programme_is_its_optimum_rounded_up():
    """One view, clusters A and B below C; it needs 6. A and B: 3 and 5 bytes save 4 each; C: 9 bytes save 7."""
    row, view, saved = np.arange(4), np.zeros(3, np.int32), np.array([7, 4, 4])
    cluster, size, end = np.array([0, 1, 2], np.int32), np.array([9, 3, 5]), np.array([3, 2, 3], np.int32)
    price, part = dual_prices(row, view, saved, cluster=cluster, bytes=size, need=np.array([6]), end=end)
    # Best fractions: A whole, half of B: 3 + 2.5. A unit of need costs 5 / 4, so A earns 5 and pays all its bytes.
    np.testing.assert_allclose(price, [5 / 4])
    np.testing.assert_allclose(part[1:], 1)
    given = {"kind": np.zeros(3, np.uint8), "view_cell": np.zeros((3, 9)), "layers": np.ones(3, np.int32)}
    impostors = Impostors(cluster=cluster, bytes=size, cost=np.zeros(3, np.int64), **given)
    columns = {name: getattr(impostors, name) for name in Impostors.__slots__}
    candidates = Candidates(**columns, row=row, view=view, saved=saved)
    offers = Offers(row=np.array([0, 3]), id=np.arange(3, dtype=np.int32), saved=saved)
    low = lower_bound_bytes(
        candidates, impostors, offers, need=np.array([6]), end=end, method="lp"
    )  # fmt: skip
    assert low == 6


def test_the_linear_programme_is_for_small_problems_only():
    assert [bound.uses_lp("auto", n) for n in (0, 20_000, 20_001)] == [True, True, False]
    assert [bound.uses_lp("lp", n) for n in (20_001, 200_000, 200_001)] == [True, True, False]
    assert not bound.uses_lp("lagrangian", 1)
