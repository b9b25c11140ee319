"""Walks, bookmarks and the difference picture of the viewer in headless Chromium, on a golden placement."""

import csv
import io
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser.levels import box_level, give_level
from browser.static_server import DIST, ROOT, serving
from farfield.placementdb.read import Placement
from pictures import flip, picture, set_view

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(
        not (DIST / "viewer.html").is_file(), reason="the pages are not built: npm run build in webviewer"
    ),
]
NAME = "placementdb"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("walks")
    shutil.copytree(ROOT / "tests" / "golden" / NAME, out / "placement")
    placement = Placement.open(out)
    give_level(out, box_level(placement.index["object_box"] + placement.origin_m))
    return out


def _views(folder: Path) -> list[dict[str, Any]]:
    """Return the golden lookups that show most impostors first."""
    told = json.loads((folder / "placement" / "lookups.json").read_text())["lookups"]
    return sorted(told, key=lambda g: -len(g["impostors"]))


def _rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def _both(page: Any, view: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return the view's pictures with impostors and as geometry alone. Leaves impostors on."""
    set_view(page, view["position"], view["direction"])
    shown = picture(page)
    page.evaluate("farfield.setMode({impostors: false})")
    truth = picture(page)
    page.evaluate("farfield.setMode({impostors: true})")
    return shown, truth


def _walked(page: Any) -> None:
    """Record a short walk with the keyboard alone."""
    page.focus("#picture")
    page.keyboard.press("r")
    page.keyboard.down("w")
    page.wait_for_timeout(300)
    page.keyboard.up("w")
    page.keyboard.down("d")
    page.wait_for_timeout(150)
    page.keyboard.up("d")
    page.keyboard.press("r")


def test_a_walk_replays_to_the_same_frames_from_its_link_on_another_page(folder: Path, open_page: Any) -> None:
    page, wrong = open_page(480, 300)
    view = _views(folder)[0]
    with serving({NAME: folder}) as url:
        page.goto(f"{url}/viewer/{NAME}")
        page.evaluate("farfield.ready()")
        at = [view["position"], view["direction"]]
        page.evaluate("([p, d]) => farfield.setView(p, d)", at)
        page.evaluate("farfield.setMode({cells: true})")
        _walked(page)
        assert page.text_content("#record-word") == "Record"
        first = _rows(page.evaluate("farfield.replay()"))
        link = page.evaluate("farfield.share()")
        assert len(first) > 5  # how long the keys were down is the machine's clock
        assert [r["frame"] for r in first] == [str(k) for k in range(len(first))]
        assert {r["over_budget"] for r in first} <= {"", "streaming", "hopeless"}

        other, wrong_there = open_page(360, 240)  # a smaller picture, other frame times
        other.goto(f"{url}/viewer/{NAME}{link}")
        other.evaluate("farfield.ready()")
        assert other.is_checked("#t-cells")
        other.evaluate("farfield.replay()")  # everything on the way is resident from here on
        again = _rows(other.evaluate("farfield.replay()"))
        for column in ("walk_ms", "cost", "geometry_cost", "cell", "problem_view"):
            assert [r[column] for r in again] == [r[column] for r in _rows(page.evaluate("farfield.replay()"))], column
        assert other.evaluate("farfield.share()").split("walk=")[1] == link.split("walk=")[1]
        said = other.text_content("#walk-result")
        assert re.search(r"p99 [\d.]+ ms, worst [\d.]+; .*Before:", said), said
        with other.expect_download() as saved:  # the panel is not shown on a screen this small; its buttons work
            other.evaluate("document.getElementById('b-plot').click()")
        assert Path(saved.value.path()).read_text().startswith("<svg")
    assert not wrong and not wrong_there


def test_a_damaged_walk_is_refused_by_name_and_the_view_still_shows(folder: Path, open_page: Any) -> None:
    page, wrong = open_page()
    view = _views(folder)[0]
    at, to = (",".join(map(str, view[key])) for key in ("position", "direction"))
    with serving({NAME: folder}) as url:
        page.goto(f"{url}/viewer/{NAME}#at={at}&to={to}&walk=AQIAAA")
        page.evaluate("farfield.ready()")
        assert "cannot be read" in page.text_content("#walk-said")
        assert page.is_disabled("#b-replay")
        assert page.evaluate("farfield.stats()")["cell"] == view["cell"]
    assert not wrong


def test_worst_views_are_one_key_away(folder: Path, open_page: Any) -> None:
    page, wrong = open_page()
    views = _views(folder)[:3]
    worst = [
        {"position": g["position"], "direction": g["direction"], "cell": g["cell"], "cost_bound": 100 - k, "hopeless": k == 1}
        for k, g in enumerate(views)
    ]  # fmt: skip
    (folder / "report.json").write_text(json.dumps({"worst_views": [*worst, {"position": "nowhere"}]}))
    with serving({NAME: folder}) as url:
        page.goto(f"{url}/viewer/{NAME}")
        page.evaluate("farfield.ready()")
        page.wait_for_selector("#worst a")
        assert page.locator("#worst a").count() == 3
        page.focus("#picture")
        for k, view in enumerate(views):
            page.keyboard.press(str(k + 1))
            stats = page.evaluate("farfield.stats()")
            assert (stats["cell"], stats["interval"]) == (view["cell"], view["interval"])
            assert page.get_attribute(f"#worst a:nth-child({k + 1})", "aria-current") == "true"
        assert "hopeless" in page.text_content("#worst a:nth-child(2)")
        page.click("#worst a:nth-child(1)")
        assert page.evaluate("farfield.stats()")["cell"] == views[0]["cell"]
    (folder / "report.json").unlink()
    assert not wrong


def test_difference_is_what_flip_evaluator_says_of_the_two_pictures(folder: Path, open_page: Any) -> None:
    page, wrong = open_page(2200, 1400)  # the picture has the placement's own size
    view = _views(folder)[0]
    with serving({NAME: folder}) as url:
        page.goto(f"{url}/viewer/{NAME}")
        page.evaluate("farfield.ready()")
        shown, truth = _both(page, view)
        mean = page.evaluate("farfield.difference()")
        size = page.evaluate("[picture.width, picture.height, difference.width, difference.height, difference.hidden]")
        assert size[:2] == size[2:4] == [truth.shape[1], truth.shape[0]]
        assert size[4] is False
        expected = flip(truth, shown).mean()
        assert expected > 1e-4
        assert mean == pytest.approx(expected, rel=0.01)
        assert f"mean {mean:.4f}" in page.text_content("#difference-mean")
        page.focus("#picture")
        page.keyboard.down("w")  # moving shows the picture itself again
        page.wait_for_selector("#difference", state="hidden")
        page.keyboard.press("e")
        page.keyboard.up("w")
        assert page.is_hidden("#difference") and page.is_hidden("#difference-said")
    assert not wrong


def test_split_screen_shows_the_middle_twice(folder: Path, open_page: Any) -> None:
    page, wrong = open_page()
    view = _views(folder)[0]
    with serving({NAME: folder}) as url:
        page.goto(f"{url}/viewer/{NAME}")
        page.evaluate("farfield.ready()")
        shown, truth = _both(page, view)
        page.focus("#picture")
        page.keyboard.press("b")
        both = picture(page)
        width = shown.shape[1]
        quarter, half = round(width / 4), width // 2
        left, right = shown[:, quarter : quarter + half], truth[:, half - quarter : half - quarter + width - half]
        # The rasteriser may round an edge the other way where the picture is moved.
        assert (both[:, :half] != left).any(-1).mean() < 0.002
        assert (both[:, half:] != right).any(-1).mean() < 0.002
        page.keyboard.press("x")
        assert page.is_checked("#t-split") and not page.is_checked("#t-beside")
        page.keyboard.press("l")
        page.keyboard.press("Enter")  # picks what is in the middle, if that is an impostor
    assert not wrong
