"""The demo city, end to end, against the figures it has to reach. `make accept` runs it and prints them.

Times are the machine's: nothing else should run beside it. FARFIELD_ACCEPT_OUT=DIR keeps placement and pictures there.
"""

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from accept.measure import Measured, run
from accept.streets import Streets, StreetView, apart
from browser.chromium import CHROMIUM, launch
from browser.static_server import DIST, serving
from cutout import demo_city
from pictures import Compared, compare, save

SECONDS, OPTIMIZE_SECONDS, BYTES = 300, 120, 3 << 30
HOPELESS_SHARE = 0.03
VIEWS = 10_000
DENSE, COVERAGE, FLIP = 1.5, 0.20, 0.05
STREETS, STREETS_APART_M, STREET_VIEWS = 3, 25.0, 600


class Figures:
    """What was measured, beside what it has to be."""

    def __init__(self) -> None:
        self.rows: list[tuple[str, str, str, str]] = []

    def check(self, what: str, value: float, limit: float, *, text: str = "{:,.0f}", least: bool = False) -> None:
        """Note a figure; fail unless it is below the limit (at most it, for 0; at least it where `least`)."""
        holds = value >= limit if least else value < limit or value == limit == 0
        sign = "at least" if least else "below" if limit else "none"
        self.rows.append(
            (what, text.format(value), f"{sign} {text.format(limit)}" if limit else sign, "ok" if holds else "FAILS")
        )
        assert holds, f"{what}: {text.format(value)}, must be {sign} {text.format(limit)}"

    def note(self, what: str, value: str) -> None:
        self.rows.append((what, value, "", ""))


@pytest.fixture(scope="module")
def figures() -> Iterator[Figures]:
    table = Figures()
    yield table
    wide = [max(len(row[k]) for row in table.rows) for k in range(4)]
    print("\n\n" + "\n".join("  ".join(cell.ljust(w) for cell, w in zip(row, wide, strict=True)) for row in table.rows))


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    kept = os.environ.get("FARFIELD_ACCEPT_OUT")
    folder = Path(kept) if kept else tmp_path_factory.mktemp("accept")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@pytest.fixture(scope="module")
def city(home: Path) -> tuple[Path, Path]:
    demo = demo_city()
    try:
        demo.build(home / "city.glb", home / "city.toml")
    except demo.WheelMissing as error:
        pytest.skip(str(error))
    return home / "city.glb", home / "city.toml"


def place(city: tuple[Path, Path], out: Path, workers: int) -> Measured:
    scene, settings = map(str, city)
    words = ["place", scene, "--settings", settings, "--workers", str(workers), "--json", "--out", str(out)]
    return farfield(*words)


def farfield(*words: str) -> Measured:
    return run([sys.executable, "-m", "farfield.cli.main", *words], timeout_s=1800)


@pytest.fixture(scope="module")
def placed(city: tuple[Path, Path], home: Path) -> tuple[Path, Measured, dict[str, Any]]:
    import json

    done = place(city, home / "two", 2)
    assert done.code in (0, 4), done.err
    return home / "two", done, json.loads(done.out)


def test_the_city_is_placed_in_time(placed: tuple[Path, Measured, dict[str, Any]], figures: Figures) -> None:
    _, done, report = placed
    for key in (
        "objects",
        "cells",
        "problem_views",
        "candidates",
        "impostors",
        "layers",
        "bytes",
        "file_bytes",
        "video_bytes",
    ):
        figures.note(key, f"{report[key]:,}")
    for stage in report["stages"]:
        figures.note(
            f"  {stage['name']}", f"{stage['seconds']:.1f} s, {stage['peak_bytes'] / 2**20:,.0f} MiB a process"
        )
    assert report["verdict"] == "valid"
    seconds = {stage["name"]: stage["seconds"] for stage in report["stages"]}
    # From problem views to chosen impostors: the stages that end with the placement.
    chosen = sum(seconds[name] for name in ("viewspace", "candidates", "placement"))
    for what, value, limit in (
        ("place, 2 workers (s)", done.seconds, SECONDS),
        ("problem views to chosen impostors (s)", chosen, OPTIMIZE_SECONDS),
    ):
        figures.check(what, value, limit, text="{:.1f}")


def test_the_city_is_placed_in_memory(placed: tuple[Path, Measured, dict[str, Any]], figures: Figures) -> None:
    _, done, report = placed
    figures.check("peak memory of all processes (MiB)", done.peak_bytes / 2**20, BYTES / 2**20)
    figures.check("peak memory of one process (MiB)", report["peak_bytes"] / 2**20, BYTES / 2**20)


def test_few_views_are_hopeless(placed: tuple[Path, Measured, dict[str, Any]], figures: Figures) -> None:
    report = placed[2]
    share = report["hopeless_views"] / max(report["problem_views"], 1)
    figures.check("hopeless share of problem views", share, HOPELESS_SHARE, text="{:.4f}")


def test_no_random_view_is_over_budget(placed: tuple[Path, Measured, dict[str, Any]], figures: Figures) -> None:
    import json

    done = farfield("verify", str(placed[0]), "--views", str(VIEWS), "--json")
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert found["views"] == VIEWS
    figures.note(f"verify: worst of {VIEWS:,} views", f"{found['worst_ratio']:.3f} of the budget")
    for key in ("over_budget", "over_bound", "outside_view_cell"):
        figures.check(f"verify: {key}", found[key], 0)


def test_one_worker_gives_the_same_bytes(
    placed: tuple[Path, Measured, dict[str, Any]], city: tuple[Path, Path], home: Path, figures: Figures
) -> None:
    done = place(city, home / "one", 1)
    assert done.code == 0, done.err
    figures.note("place, 1 worker (s)", f"{done.seconds:.1f}")
    folders = [home / "one" / "placement", placed[0] / "placement"]
    files = [{p.relative_to(f): p for p in f.rglob("*") if p.is_file()} for f in folders]
    assert files[0].keys() == files[1].keys()
    different = sum(files[0][name].read_bytes() != path.read_bytes() for name, path in files[1].items())
    figures.check(f"files that differ, of {len(files[0])}", different, 0)


@pytest.fixture(scope="module")
def streets(placed: tuple[Path, Measured, dict[str, Any]], figures: Figures, gl: Any) -> list[StreetView]:
    """The street views of most coverage, apart from each other, of many random ones dense in geometry."""
    budget = placed[2]["budget_amount"]
    at_least = int(np.ceil(DENSE * budget))
    survey = Streets(placed[0])
    seen = survey.sample(STREET_VIEWS, at_least=at_least)
    assert seen, f"no view from a street costs {at_least} as geometry"
    shares = np.quantile([view.coverage for view in seen], [0.5, 0.9, 0.99, 1.0])
    said = ", ".join(
        f"{name} {share:.2%}" for name, share in zip(("median", "90 %", "99 %", "best"), shares, strict=True)
    )
    figures.note(f"coverage of {len(seen)} dense street views", said)
    best = apart(seen, 2 * STREETS, metres=STREETS_APART_M)
    best = [survey.improve(view, at_least=at_least, seed=k) for k, view in enumerate(best)]
    return apart(best, STREETS, metres=STREETS_APART_M)


@pytest.fixture(scope="module")
def walked(
    placed: tuple[Path, Measured, dict[str, Any]], streets: list[StreetView], home: Path
) -> tuple[list[Compared], list[str]]:
    """The street views in the browser, and what its console complained of."""
    if CHROMIUM is None or not (DIST / "viewer.html").is_file():
        pytest.skip("no chromium, or the pages are not built")
    api = pytest.importorskip("playwright.sync_api")
    wrong: list[str] = []
    with serving({"city": placed[0]}) as url, api.sync_playwright() as playwright:
        browser = launch(playwright)
        page = browser.new_page(viewport={"width": 640, "height": 400})
        page.set_default_timeout(300_000)
        page.on("console", lambda m: wrong.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda e: wrong.append(str(e)))
        page.goto(f"{url}/viewer/city")
        page.evaluate("farfield.ready()")
        views = [compare(page, street.position, street.direction) for street in streets]
        browser.close()
    for k, view in enumerate(views):
        save(home / "pictures", f"street-{k}", view)
    return views, wrong


def test_streets_are_drawn_within_the_budget(
    placed: tuple[Path, Measured, dict[str, Any]], streets: list[StreetView], walked: Any, figures: Figures
) -> None:
    budget = placed[2]["budget_amount"]
    views, wrong = walked
    assert wrong == []
    assert len(views) == STREETS
    for k, (street, view) in enumerate(zip(streets, views, strict=True)):
        at = ", ".join(f"{x:.1f}" for x in street.position)
        figures.note(f"street {k}", f"at ({at}), {view.stats['calls']} draw calls, {view.stats['impostors']} impostors")
        assert view.stats["impostorsWaiting"] == 0
        ratio = view.stats["geometryCost"] / budget
        figures.check(f"  geometry over budget, street {k}", ratio, DENSE, text="{:.2f}", least=True)
        figures.check(f"  cost, street {k}", view.stats["cost"], budget + 1)
        assert max(view.stats["calls"], view.stats["cost"]) <= view.stats["costBound"]


def test_streets_look_like_their_geometry(walked: Any, figures: Figures) -> None:
    failed = []
    for k, view in enumerate(walked[0]):
        figures.note(f"  FLIP of the picture, street {k}", f"{view.flip_picture:.4f}")
        for what, value, limit, text, least in (
            (f"  holes, street {k}", view.holes, 0, "{:,.0f}", False),
            (f"  FLIP over covered pixels, street {k}", view.flip, FLIP, "{:.4f}", False),
            (f"  coverage, street {k}", view.coverage, COVERAGE, "{:.2%}", True),
        ):
            try:
                figures.check(what, value, limit, text=text, least=least)
            except AssertionError as error:
                failed.append(str(error))
    assert not failed
