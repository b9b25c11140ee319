"""Find street views of a placement and look at them in the browser, with impostors and without."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from accept.figures import Figures
from accept.streets import Streets, StreetView, apart
from browser.chromium import CHROMIUM, launch
from browser.static_server import DIST, serving
from pictures import Compared, compare, save, shimmer

DENSE = 1.5  # times the budget, as geometry
STREETS, STREETS_APART_M, STREET_VIEWS = 3, 25.0, 600


@dataclass(frozen=True, slots=True, kw_only=True)
class Walked:
    streets: list[StreetView]
    views: list[Compared]
    complaints: list[str]  # of the browser's console
    shimmer: tuple[float, float]  # from frame to frame of a slow walk: with impostors, with geometry


def walk(
    folder: Path, budget: int, figures: Figures, pictures: Path, name: str, *, views: int = STREET_VIEWS
) -> Walked:
    """Return the street views of most coverage, apart from each other, of so many random ones dense in geometry."""
    if CHROMIUM is None or not (DIST / "viewer.html").is_file():
        pytest.skip("no chromium, or the pages are not built")
    api = pytest.importorskip("playwright.sync_api")
    at_least = int(np.ceil(DENSE * budget))
    survey = Streets(folder)
    seen = survey.sample(views, at_least=at_least)
    assert seen, f"no view from a street costs {at_least} as geometry"
    shares = np.quantile([view.coverage for view in seen], [0.5, 0.9, 0.99, 1.0])
    said = ", ".join(f"{q} {share:.2%}" for q, share in zip(("median", "90 %", "99 %", "best"), shares, strict=True))
    figures.note(f"coverage of {len(seen)} dense views, {name}s", said)
    best = apart(seen, 2 * STREETS, metres=STREETS_APART_M)
    best = [survey.improve(view, at_least=at_least, seed=k) for k, view in enumerate(best)]
    streets = apart(best, STREETS, metres=STREETS_APART_M)
    wrong: list[str] = []
    with serving({"city": folder}) as url, api.sync_playwright() as playwright:
        browser = launch(playwright)
        page = browser.new_page(viewport={"width": 640, "height": 400})
        page.set_default_timeout(300_000)
        page.on("console", lambda m: wrong.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda e: wrong.append(str(e)))
        page.goto(f"{url}/viewer/city")
        page.evaluate("farfield.ready()")
        compared = [compare(page, street.position, street.direction) for street in streets]
        change = shimmer(page, streets[0].position, streets[0].direction)
        browser.close()
    for k, view in enumerate(compared):
        save(pictures, f"{name.replace(' ', '-')}-{k}", view)
    return Walked(streets=streets, views=compared, complaints=wrong, shimmer=change)


def check_costs(walked: Walked, budget: int, figures: Figures, name: str) -> None:
    """Check that three views, dense as geometry, are drawn within the budget."""
    assert walked.complaints == []
    assert len(walked.views) == STREETS
    for k, (street, view) in enumerate(zip(walked.streets, walked.views, strict=True)):
        at = ", ".join(f"{x:.1f}" for x in street.position)
        figures.note(f"{name} {k}", f"at ({at}), {view.stats['calls']} draw calls, {view.stats['impostors']} impostors")
        assert view.stats["impostorsWaiting"] == 0
        ratio = view.stats["geometryCost"] / budget
        figures.check(f"  geometry over budget, {name} {k}", ratio, DENSE, text="{:.2f}", least=True)
        figures.check(f"  cost, {name} {k}", view.stats["cost"], budget + 1)
        assert max(view.stats["calls"], view.stats["cost"]) <= view.stats["costBound"]
