"""Memory of our placements against the paper's own way, on levels and budgets where both bring every view to the budget."""

import dataclasses

import pytest
from benchmarks.inputs import Level, town_level
from farfield.settings import PlacementSettings

PAPERS_WAY = PlacementSettings(candidates="shafts", view_cells="raw", assignment="all", reverse_delete=False)


@pytest.mark.parametrize(
    ("n", "view_m", "budget"), [(400, 128.0, "184 calls"), (1600, 64.0, "400 calls"), (900, 192.0, "239 calls")]
)
def test_ours_needs_at_most_half_of_the_papers_way(n, view_m, budget, report):
    ours = town_level(n, budget=budget, view_m=view_m)
    theirs = Level(
        f"{ours.name}, the paper's way", ours.scene, dataclasses.replace(ours.settings, placement=PAPERS_WAY)
    )
    a, b = ours.placement, theirs.placement
    assert not a.hopeless.any() and not b.hopeless.any()
    ratio = a.bytes.sum() / b.bytes.sum()
    report(
        stage="placement", work="memory against the paper's way", input=f"{ours.name}, {view_m:g} m, {budget}", seconds=0.0,
        rate=ratio, unit=f"of its {b.bytes.sum() / 1e6:,.1f} MB",
    )  # fmt: skip
    assert ratio <= 0.5
