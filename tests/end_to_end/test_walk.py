"""A walk over the cut-out in headless Chromium: calls against the budget, the picture against geometry."""

import numpy as np
import pytest
from browser.chromium import CHROMIUM, launch
from browser.static_server import DIST, serving
from farfield.evaluation.verify import Eye, draw_views
from farfield.placementdb.read import Placement
from pictures import compare, set_view

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.skipif(not (DIST / "viewer.html").is_file(), reason="the pages are not built: npm run build in webviewer"),
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine"),
]  # fmt: skip


@pytest.fixture(scope="module")
def page(placed):
    """The viewer on the cut-out, and what its console complained of."""
    api = pytest.importorskip("playwright.sync_api")
    with serving({"cutout": placed[0]}) as url, api.sync_playwright() as playwright:
        browser = launch(playwright)
        page = browser.new_page(viewport={"width": 640, "height": 400})
        page.set_default_timeout(120_000)
        page.wrong = []
        page.on("console", lambda m: page.wrong.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda e: page.wrong.append(str(e)))
        page.goto(f"{url}/viewer/cutout")
        page.evaluate("farfield.ready()")
        yield page
        browser.close()


@pytest.fixture(scope="module")
def views(placed):
    """Thirty random views, most of them in problem views: (lookup, cost, position, direction), fullest last."""
    placement = Placement.open(placed[0])
    eye, found = Eye(placement), []
    for position, direction in draw_views(placement, 1500, 3):
        shown = placement.lookup(position, direction)
        if shown.problem_view is not None and -0.5 < direction[1] < 0.1:
            found.append((shown, *eye.cost(shown, position, direction), position, direction))
    found.sort(key=lambda f: len(f[0].impostors))
    return [found[i] for i in np.linspace(0, len(found) - 1, 30).astype(int)]


def test_the_walk_stays_within_its_budget(placed, page, views):
    budget = placed[1]["budget_amount"]
    saved = 0
    for shown, cost, drawn, position, direction in views:
        stats = set_view(page, position, direction)
        assert stats["problemView"] == shown.problem_view and stats["impostorsWaiting"] == 0
        assert stats["impostors"] == len(shown.impostors)
        # Boxes that only touch the view may be culled by one of the two and not by the other.
        assert abs(stats["objects"] - drawn) <= 1
        assert abs(stats["cost"] - cost) <= 1
        assert stats["cost"] <= budget and stats["costBound"] <= budget
        # The scene's objects are one primitive each; all impostor layers are one call.
        assert stats["calls"] == stats["objects"] + (stats["impostors"] > 0)
        saved = max(saved, stats["geometryCost"] / budget)
    assert saved >= 1.2
    assert page.wrong == []


def test_impostors_look_like_what_they_replace(page, views):
    fullest = sorted(views, key=lambda v: -len(v[0].impostors))[:8]
    shares = [set_view(page, position, direction)["coveredPixels"] for *_, position, direction in fullest]
    for k in np.argsort(shares)[-2:]:
        *_, position, direction = fullest[k]
        view = compare(page, position, direction)
        assert view.coverage > 0.02, "no view shows much of an impostor"
        assert view.holes == 0
        # A pixel of parallax moves the edges of houses that are a few pixels wide.
        assert view.flip < 0.1
        assert view.flip_picture < 0.01
    assert page.wrong == []
