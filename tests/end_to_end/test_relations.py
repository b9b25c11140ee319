"""Relations that hold between placements of levels that are the same in another guise [evidence.md]."""

from dataclasses import replace

import numpy as np
import pytest
from farfield.stability.level import street
from farfield.stability.relations import differences, served
from farfield.stability.run import run
from farfield.stages import Stage

BUDGETS = ["34 calls", "1100 triangles", "1.4 ms"]
STAGES = (Stage.RENDERTIME, Stage.HIERARCHY, Stage.VIEWSPACE, Stage.CANDIDATES, Stage.PLACEMENT)


@pytest.fixture(scope="module")
def level():
    return street(70)


@pytest.fixture(scope="module")
def plain(level, tmp_path_factory):
    """The level placed with each budget."""
    path = level.write(tmp_path_factory.mktemp("plain") / "scene.glb")
    return {budget: run(path, level.settings(budget=budget)) for budget in BUDGETS}


def test_there_is_something_to_place(plain):
    for budget, placed in plain.items():
        found = placed.get(Stage.PLACEMENT)
        assert len(found.cluster) > 3, budget
        assert len(found.view_cost) > 20
        assert not found.hopeless.all()


@pytest.mark.parametrize("budget", BUDGETS)
@pytest.mark.parametrize("scale", [2.0**-10, 2.0**7])
def test_scaling_by_a_power_of_two_scales_the_placement_bit_for_bit(level, plain, tmp_path, budget, scale):
    path = level.write(tmp_path / "scene.glb")
    scaled = run(path, replace(level, unit_m=scale).settings(budget=budget))
    for stage in STAGES:
        assert differences(plain[budget].get(stage), scaled.get(stage), length_factor=scale) == []
    one, other = (r.get(Stage.PLACEMENT) for r in (plain[budget], scaled))
    assert one.bytes.tobytes() == other.bytes.tobytes() and one.serve.tobytes() == other.serve.tobytes()


@pytest.mark.parametrize("budget", BUDGETS)
def test_the_order_of_the_objects_in_the_file_leaves_no_trace(level, plain, tmp_path, budget):
    order = np.random.default_rng(1).permutation(len(level.box)).tolist()
    shuffled = run(replace(level, order=order).write(tmp_path / "scene.glb"), level.settings(budget=budget))
    assert shuffled.artifacts == plain[budget].artifacts


def test_the_order_of_the_shards_leaves_no_trace(level, plain, tmp_path):
    path = level.write(tmp_path / "scene.glb")
    for order in (lambda s: s[::-1], lambda s: [s[i] for i in np.random.default_rng(2).permutation(len(s))]):
        again = run(path, level.settings(budget=BUDGETS[0]), order=order)
        assert again.artifacts == plain[BUDGETS[0]].artifacts


@pytest.mark.parametrize("budget", BUDGETS)
@pytest.mark.parametrize("axis", [0, 2])
def test_mirroring_mirrors_the_placement(level, tmp_path, budget, axis):
    """Where candidates are cut into shards shapes which of them are kept, and no cut is its own mirror image: one shard."""
    one, other = (
        run(h.write(tmp_path / f"{i}.glb"), h.settings(budget=budget), one_shard=True)
        for i, h in enumerate((level, level.mirrored(axis)))
    )
    assert sorted(one.get(Stage.VIEWSPACE).cost.tolist()) == sorted(other.get(Stage.VIEWSPACE).cost.tolist())
    assert served(one) == served(other)
    assert sorted(one.get(Stage.PLACEMENT).view_cost.tolist()) == sorted(other.get(Stage.PLACEMENT).view_cost.tolist())


@pytest.mark.parametrize("budget", BUDGETS)
def test_a_translation_that_the_grid_shares_changes_nothing(level, plain, tmp_path, budget):
    """By 2**24 m, more than 1e7: a whole number of every cell of the Morton grid that the level touches."""
    moved = replace(level, shift=(2.0**24, -(2.0**24), 2.0**24))
    found = run(moved.write(tmp_path / "scene.glb"), moved.settings(budget=budget))
    for stage in STAGES:
        assert differences(plain[budget].get(stage), found.get(stage)) == []


@pytest.mark.parametrize("budget", BUDGETS)
def test_a_translation_by_ten_million_changes_only_how_clusters_are_cut(level, plain, tmp_path, budget):
    """1e7 is a whole number of 8 m cells, but not of the larger ones of the fixed grid: ties of the cluster tree, which
    is cut where that grid has its borders, fall another way. What views cost and which are problems stays as it is."""
    moved = replace(level, shift=(1e7, 0.0, -1e7))
    found = run(moved.write(tmp_path / "scene.glb"), moved.settings(budget=budget))
    one, other = (r.get(Stage.VIEWSPACE) for r in (plain[budget], found))
    for column in ("cell", "interval", "cost", "cell_cost"):
        np.testing.assert_array_equal(getattr(one, column), getattr(other, column))
    a, b = (r.get(Stage.PLACEMENT) for r in (plain[budget], found))
    assert a.hopeless.sum() == b.hopeless.sum() or b.hopeless.mean() < 0.1
    assert 0.6 < b.bytes.sum() / a.bytes.sum() < 1.6


@pytest.mark.parametrize("unit", ["calls", "triangles", "ms"])
def test_a_larger_budget_has_no_more_problem_views(level, tmp_path, unit):
    path = level.write(tmp_path / "scene.glb")
    amounts = {"calls": range(20, 75, 9), "triangles": range(500, 1800, 250), "ms": (1.1, 1.2, 1.35, 1.5, 1.7)}[unit]
    before = None
    for amount in amounts:
        found = run(path, level.settings(budget=f"{amount} {unit}"), until=Stage.VIEWSPACE).get(Stage.VIEWSPACE)
        views = set(zip(found.cell.tolist(), found.interval.tolist()))
        assert before is None or views <= before, "a problem at a larger budget is one at a smaller"
        before = views
    assert not before or len(before) < 400


@pytest.mark.parametrize("seed", range(3))
def test_more_candidates_never_spoil_a_placement(tmp_path, seed):
    level = street(60, seed=10 + seed)
    path = level.write(tmp_path / "scene.glb")
    best = {}
    for kinds in ("shafts", "boxes", "shafts+boxes"):
        found = run(path, level.settings(budget="30 calls", placement__candidates=kinds)).get(Stage.PLACEMENT)
        assert (found.view_cost[~found.hopeless] <= found.view_target[~found.hopeless]).all()
        best[kinds] = found
    both = best["shafts+boxes"]
    for kinds in ("shafts", "boxes"):
        assert (both.view_best <= best[kinds].view_best).all()
        assert not (both.hopeless & ~best[kinds].hopeless).any()
