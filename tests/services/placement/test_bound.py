"""The lower bound is never above the lightest set found by trying all, and not far below it."""

import numpy as np
from farfield.placement.antichain import Offers, offers_of
from farfield.placement.bound import lower_bound_bytes
from farfield.placement.rescue import rescue
from farfield.placement.tighten import Impostors
from naive import greedy as naive

from .instances import random_instance
from .test_greedy import placed, prospects


def chosen_and_offers(x, chosen):
    c = x.candidates
    row, id, saved = offers_of(chosen, c.row, c.view, c.saved, np.ones(len(x.views.cell), bool))
    columns = {name: getattr(c, name)[chosen] for name in ("cluster", "kind", "view_cell", "bytes", "layers", "cost")}
    return Impostors(**columns), Offers(row=row, id=id, saved=saved)


def test_no_set_of_candidates_weighs_less_than_the_bound_nor_much_more():
    total_bound, total_lightest = 0, 0
    for seed in range(50):
        x = random_instance(seed, n_objects=6, n_candidates=9)
        found, end = prospects(x)
        need = x.views.cost - found.target
        chosen = rescue(x.candidates, np.zeros(0, np.int32), need=need, end=end)
        bound = lower_bound_bytes(x.candidates, *chosen_and_offers(x, chosen), need=need, end=end)
        lightest = naive.lightest_bytes(x.hierarchy, x.views, x.candidates, found.target)
        assert bound <= lightest <= placed(x).bytes.sum(), f"{seed=}"
        assert (bound == 0) == (lightest == 0), f"{seed=}"
        total_bound, total_lightest = total_bound + bound, total_lightest + lightest
    assert total_bound >= 0.8 * total_lightest, "whole impostors are dearer than parts, but not by so much"
