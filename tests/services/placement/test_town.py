"""All stages up to placement on a made-up town: estimates, view cells and costs agree with each other."""

import numpy as np
import pytest
from farfield.candidates.generate import generate, merge, plan_shards
from farfield.candidates.model import BOX
from farfield.geometry.cells import build_cells
from farfield.hierarchy.build import build_hierarchy
from farfield.placement.greedy import place
from farfield.placement.repair import verdict
from farfield.rendertime.cost import build_cost_model
from farfield.settings import PlacementSettings, Settings
from farfield.viewspace.split import find_problem_views
from farfield.visibility.model import VisibleSets
from naive import greedy as naive
from towns import town


@pytest.fixture(scope="module")
def stages():
    scene = town(90, view_m=32)
    settings = Settings(budget="30 calls", placement=PlacementSettings(assignment="least"))
    hierarchy, model = build_hierarchy(scene), build_cost_model(scene, settings=settings)
    cells = build_cells(scene.view_boxes, scene.cell_m)
    visible = VisibleSets(mode="off", row=np.zeros(0, np.int64), object=np.zeros(0, np.int32))
    views = find_problem_views(scene, hierarchy, model, visible, settings=settings, node=0)
    shards = plan_shards(hierarchy)
    candidates = merge(
        [generate(scene, hierarchy, model, cells, views, settings=settings, nodes=nodes) for nodes in shards]
    )
    return scene, hierarchy, model, cells, views, candidates, settings


@pytest.fixture(scope="module")
def placement(stages):
    *inputs, settings = stages
    return place(*inputs, settings=settings)


def covers(kind, view_cell, box):
    """True if the view cell holds all corners of the box, up to rounding."""
    if kind == BOX:
        return bool((view_cell[:3] <= box[0]).all() and (box[1] <= view_cell[3:6]).all())
    corners = np.array([[box[i, 0], box[j, 1], box[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    apex, axis, slope, near, far = view_cell[:3], view_cell[3:6], *view_cell[6:]
    along = (corners - apex) @ axis
    aside = np.linalg.norm(corners - apex - along[:, None] * axis, axis=1)
    return bool((along >= near - 1e-6).all() and (along <= far + 1e-6).all() and (aside <= slope * along + 1e-6).all())


def test_the_town_is_placed_within_its_budget(stages, placement):
    _, hierarchy, model, _, views, _, _ = stages
    assert len(views.cell) > 100 and len(placement.cluster) > 3
    assert verdict(placement, model) == ("infeasible" if placement.hopeless.any() else "valid")
    assert (placement.view_cost <= placement.view_target).all()
    costs = naive.view_costs(hierarchy, views, placement.cluster, placement.cost, placement.serve_row, placement.serve)
    np.testing.assert_array_equal(costs, placement.view_cost)
    assert placement.curve_bytes[0] == placement.bytes.sum()


def test_an_impostor_is_shown_only_in_cells_that_its_view_cell_holds(stages, placement):
    cells, views = stages[3], stages[4]
    for v in range(len(views.cell)):
        box = cells.cell_box[views.cell[v]]
        for s in placement.serve[placement.serve_row[v] : placement.serve_row[v + 1]]:
            assert covers(placement.kind[s], placement.view_cell[s], box), f"{v=} impostor {s}"


def test_the_fastest_assignment_has_the_same_impostors_and_costs_no_more(stages, placement):
    *inputs, _ = stages
    fastest = place(*inputs, settings=Settings(budget="30 calls"))
    np.testing.assert_array_equal(fastest.view_cell, placement.view_cell)
    assert (fastest.view_cost <= placement.view_cost).all()
    assert len(fastest.serve) >= len(placement.serve)
