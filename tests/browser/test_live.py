"""A running optimiser as the job page shows it: curves, the map of what is unsolved, the heading; from its events alone."""

import math
import re

import pytest
from browser.visitor import level, sign_in, submit

pytestmark = pytest.mark.browser
WIDE, DEEP, SIDE_M, STEPS = 24, 16, 20, 7
BUDGET_NS = 16_000_000


def words():
    """Return what a made-up optimiser tells: a view space that is worst about one place, solved bit by bit."""
    boxes, cost, views = [], [], []
    for k in range(WIDE * DEEP):
        x, z = SIDE_M * (k % WIDE), SIDE_M * (k // WIDE)
        boxes += [x, z, x + SIDE_M, z + SIDE_M]
        cost.append(int(1e6 * max(2.0, 40 - math.hypot(x - 200, z - 160) / 6)))
        views.append(max(0, (cost[-1] - BUDGET_NS) // 1_000_000))
    told = [{"map": {"boxes": boxes, "cost": cost, "budget": BUDGET_NS, "unit": "ns", "views": views}}]
    for step in range(STEPS):
        tiles = [int(v * (1 - step / (STEPS - 1))) + (v > 20) for v in views]
        hopeless = sum(v > 20 for v in views)
        told.append({"share": step / STEPS, "bytes": 9_000_000 * step, "choices": 300 * step, "unsolved": sum(tiles),
                     "hopeless": hopeless, "smallest_budget": 17_912_345, "tiles": tiles})  # fmt: skip
    return told


def test_the_optimiser_is_watched_while_it_runs(open_page, service):
    page, wrong = open_page()
    sign_in(page, service)
    submit(page, level("live.glb", shards=4, picture=True, tell=words(), tell_seconds=1.2))
    page.wait_for_selector(".map .cells .u3", timeout=30_000)
    page.wait_for_selector("text=Heading for infeasible")
    banner = page.inner_text(".tobe")
    assert re.search(r"\d+ of [\d,]+ problem views cannot meet", banner) and "17.92 ms" in banner  # rounded up
    point = "document.querySelector('.chart.live path.ln')?.getAttribute('d').split('L').length"
    page.wait_for_function(f"() => {point} > 2")
    page.reload()  # all of it comes again from the events
    page.wait_for_function(f"() => {point} > 2")
    page.wait_for_selector(".map .cells .u2")
    page.keyboard.press("m")
    page.wait_for_selector(".map .cells .c8")
    assert "predicted / 16.0 ms" in page.inner_text(".mapfoot")
    page.keyboard.press("m")
    page.wait_for_selector(".map .cells .u2")
    box = page.get_attribute(".map svg", "viewBox")
    page.keyboard.press("+")
    assert page.get_attribute(".map svg", "viewBox") != box
    page.keyboard.press("-")
    assert page.get_attribute(".map svg", "viewBox") == box
    page.focus(".map")
    page.keyboard.press("ArrowRight")
    facts = page.inner_text(".pick").split()
    assert "unsolved" in facts and "40.0" not in facts
    # The log reads its past after the map has its own.
    page.locator(".log summary", has_text=re.compile(r"choices, [\d.]+ MB, [\d,]+ views? unsolved")).wait_for()
    page.wait_for_selector("text=Run again", timeout=40_000)
    page.wait_for_selector("#hopeless")  # the map is that of the placement now
    assert page.locator(".map .cells [class^=u]").count() == 0
    assert "54.0 MB" in page.get_attribute(".chart.live >> nth=0", "aria-label")
    page.focus("[data-stage=viewspace] svg")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")  # the log of that shard alone
    page.wait_for_selector(".log[open] pre .wh")
    assert set(page.locator(".log pre .wh").all_inner_texts()) == {"viewspace 2"}
    with page.expect_download() as waiting:
        page.click("[aria-label='Curves as CSV']")
    rows = waiting.value.path().read_text().strip().splitlines()
    assert rows[0].strip("\ufeff") == "seconds,bytes,unsolved_views" and len(rows) >= 4
    assert [text for text in wrong if "status of 40" not in text] == []
