"""A level in pages, streamed to headless Chromium: slow and failing lines, a small memory, levels of detail, a lost context."""

import json
import shutil
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser.static_server import DIST, serving
from curved import SETTINGS, curved_level
from farfield.cli.main import main
from farfield.placementdb.read import Placement
from farfield.placementdb.write import sealed
from pictures import picture, set_view

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(
        not (DIST / "viewer.html").is_file(), reason="the pages are not built: npm run build in webviewer"
    ),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A placement of curved meshes with levels of detail, within its budget without impostors."""
    out = tmp_path_factory.mktemp("curved")
    (out / "level.glb").write_bytes(curved_level(rows=4, far_m=80.0))
    (out / "level.toml").write_text(SETTINGS.format(budget="60000 triangles", mode="on"))
    code = main(["place", str(out / "level.glb"), "--settings", str(out / "level.toml"), "--workers", "1",
                 "--out", str(out / "placed")])  # fmt: skip
    assert code in (0, None)
    return out / "placed"


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    page = browser.new_page(viewport={"width": 640, "height": 400})
    yield page
    page.close()


def _views(placement: Placement, n: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(3)
    low, high = np.array(placement.manifest["view_space"][0])
    return [(low + (high - low) * rng.random(3), rng.normal(size=3) * [0.3, 0.05, 0.1] - [0, 0, 1]) for _ in range(n)]


def test_levels_of_detail_are_drawn_as_they_were_counted(folder: Path, page: Any) -> None:
    placement = Placement.open(folder)
    assert placement.manifest["geometry"] is not None
    index, coarse = placement.index, 0
    with serving({"curved": folder}) as url:
        page.goto(f"{url}/viewer/curved")
        for position, direction in _views(placement, 12):
            stats = set_view(page, position, direction)
            assert (stats["missing"], stats["impostorsWaiting"]) == (0, 0)
            assert stats["cost"] <= stats["budget"]
            # The budget is in triangles: what was drawn is what was counted.
            assert stats["triangles"] == stats["cost"] - placement.manifest["cost_model"]["per_frame"]
            coarse += int((placement.levels_in(stats["cell"]) > 0).sum())
        assert coarse > 0
        assert len(index["level_from"]) > 0


def test_the_paged_level_shows_what_scene_glb_shows(folder: Path, page: Any, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "whole")
    manifest = json.loads((folder / "placement" / "manifest.json").read_text())
    (tmp_path / "whole" / "placement" / "manifest.json").write_bytes(sealed(manifest | {"geometry": None}))
    views = _views(Placement.open(folder), 4)
    with serving({"paged": folder, "whole": tmp_path / "whole"}) as url:
        shown = []
        for name in ("paged", "whole"):
            page.goto(f"{url}/viewer/{name}")
            shown.append([(set_view(page, p, d), picture(page))[1] for p, d in views])
    for a, b in zip(*shown, strict=True):
        assert a.std() > 5
        np.testing.assert_array_equal(a, b)


def test_a_slow_and_failing_line_shows_boxes_first_and_everything_in_the_end(folder: Path, page: Any) -> None:
    asked: Counter[str] = Counter()

    def trouble(path: str) -> int | None:
        if "/geometry/" not in path:
            return None
        asked[path] += 1
        time.sleep(1.0)  # so that some frames are drawn before
        return 503 if asked[path] == 1 else None  # each file fails once

    with serving({"curved": folder}, trouble=trouble) as url:
        page.goto(f"{url}/viewer/curved")
        page.evaluate("farfield.ready()")
        stats = page.evaluate("farfield.stats()")
        assert stats["missing"] == 0
        assert stats["incomplete"] > 0, "no frame was drawn before the geometry came"
        assert stats["firstWholeMs"] > 0
        assert set(asked.values()) == {2}, "asked again where it failed, and never else"


def test_nothing_is_fetched_beyond_the_first_image_before_it_is_there(folder: Path, page: Any) -> None:
    pages = {entry["file"] for entry in Placement.open(folder).manifest["geometry"]["pages"]}
    asked, go_on = [], threading.Event()

    def trouble(path: str) -> None:
        name = path.partition("/v1/placements/curved/")[2]
        if name in pages or name == "report.json":
            asked.append(name)
            if asked[0] == name:  # the first alone, however many ask at once
                go_on.wait(20)

    with serving({"curved": folder}, trouble=trouble) as url:
        page.goto(f"{url}/viewer/curved#at=0,1.6,0&to=0,0,1")  # the rows are behind
        page.wait_for_timeout(1000)
        before = set(asked)
        go_on.set()
        page.evaluate("farfield.ready()")
        stats = page.evaluate("farfield.stats()")
        assert 0 < len(before) < len(pages)
        assert "report.json" not in before
        assert stats["firstWholeMs"] > 1000
        assert 0 < stats["firstWholeBytes"] < sum(file.stat().st_size for file in (folder / "placement").rglob("*.*"))
        for _ in range(100):
            if "report.json" in asked and len(pages & set(asked)) > len(before):
                break
            page.wait_for_timeout(100)
        assert "report.json" in asked
        assert pages & set(asked) > before, "what the rest of the cell needs never came"
        assert len(asked) == len(set(asked)), "a file was asked for twice"


def test_a_small_memory_is_kept_to_and_leaves_no_hole(folder: Path, page: Any) -> None:
    pages = Placement.open(folder).manifest["geometry"]["pages"]
    assert len(pages) > 2
    held = sum(p["memory"] for p in pages)
    with serving({"curved": folder}) as url:
        page.goto(f"{url}/viewer/curved?memory={held / 1e6}")  # of which the level may take half
        for position, direction in _views(Placement.open(folder), 6):
            set_view(page, position, direction)
            stats = page.evaluate("farfield.stats()")
            assert stats["memory"]["mostLevel"] <= max(held / 2, *(p["memory"] for p in pages))
            assert stats["objects"] > 0
            picture(page)


def test_a_lost_context_comes_back_with_the_same_view(folder: Path, page: Any) -> None:
    position, direction = _views(Placement.open(folder), 1)[0]
    with serving({"curved": folder}) as url:
        page.goto(f"{url}/viewer/curved")
        set_view(page, position, direction)
        before = picture(page)
        with page.expect_event("load"):
            page.evaluate(
                "() => { const e = document.querySelector('#picture').getContext('webgl2').getExtension('WEBGL_lose_context');"
                " e.loseContext(); setTimeout(() => e.restoreContext(), 100); }"
            )
        page.evaluate("farfield.ready()")
        stats = page.evaluate("farfield.stats()")
        np.testing.assert_allclose(stats["position"], position, atol=1e-6)
        after = picture(page)
    assert np.abs(after.astype(int) - before.astype(int)).mean() < 1
