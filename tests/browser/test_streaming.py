"""A level in pages, streamed to headless Chromium: slow and failing lines, a small memory, levels of detail, a lost context."""

import json
import shutil
import threading
import time
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser.static_server import DIST, Cut, find, serving
from browser.walks import encode_walk
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


AT = "#at=0,1.6,0&to=0,0,-1"
BASE = "/v1/placements/curved/"


def test_a_lossy_line_shows_in_the_end_what_a_good_one_shows(folder: Path, page: Any) -> None:
    """Of every file the first answer is lost, cut off, refused, altered, or ends early as if that were all of it."""
    asked: Counter[str] = Counter()
    struck: Counter[str] = Counter()

    def trouble(path: str) -> int | bytes | Cut | None:
        name = path.removeprefix(BASE)
        if name == path or name == "report.json":
            return None
        asked[name] += 1
        if asked[name] > 1:
            return None
        found = find(path, {"curved": folder})
        assert found is not None
        kinds: dict[str, int | bytes | Cut] = {"refused": 503, "cut": Cut(0.5), "lost": Cut(-1)}
        if name != "manifest.json":  # its own seal is checked, and it has no second try
            content = found.read_bytes()
            kinds |= {"altered": content[:-1] + bytes([content[-1] ^ 1]), "short": content[: len(content) // 2]}
        kind = list(kinds)[zlib.crc32(name.encode()) % len(kinds)]
        struck[kind] += 1
        return kinds[kind]

    with serving({"curved": folder}) as url:
        page.goto(f"{url}/viewer/curved{AT}")
        page.evaluate("farfield.ready()")
        before = picture(page)
    with serving({"curved": folder}, trouble=trouble) as url:
        page.goto(f"{url}/viewer/curved{AT}")
        page.evaluate("farfield.ready()")
        page.wait_for_selector("#stream-state:text-matches('complete here|all resident')")
        np.testing.assert_array_equal(picture(page), before)
        assert page.evaluate("farfield.stats()")["missing"] == 0
        page.wait_for_selector("#notice", state="hidden")
    assert len(struck) >= 4, struck
    assert min(asked.values()) == 2
    assert max(asked.values()) <= 3, "the browser itself tries a lost connection once more"


def test_a_throttled_line_shows_stand_ins_first_and_all_of_it_in_the_end(folder: Path, page: Any) -> None:
    cdp = page.context.new_cdp_session(page)
    cdp.send("Network.enable")
    line = {"offline": False, "latency": 80, "downloadThroughput": 60_000, "uploadThroughput": 60_000}
    with serving({"curved": folder}) as url:
        page.goto(f"{url}/viewer/curved{AT}")  # what the page itself is made of
        page.evaluate("async () => { for (const name of await caches.keys()) await caches.delete(name); }")
        page.goto("about:blank")
        page.route(
            "**/v1/placements/**", lambda route: (cdp.send("Network.emulateNetworkConditions", line), route.continue_())
        )
        page.goto(f"{url}/viewer/curved{AT}")
        page.evaluate("farfield.ready()")
        stats = page.evaluate("farfield.stats()")
        assert stats["incomplete"] > 0 and stats["missing"] == 0
        page.wait_for_selector("#stream-state:text-matches('complete here|all resident')")


def test_what_is_no_longer_wanted_is_cancelled_and_what_is_wanted_again_comes(folder: Path, page: Any) -> None:
    given_up: list[str] = []
    go_on = threading.Event()
    page.on("requestfailed", lambda r: given_up.append(r.url) if "/geometry/" in r.url else None)
    pages = {BASE + entry["file"] for entry in Placement.open(folder).manifest["geometry"]["pages"]}
    with serving({"curved": folder}, trouble=lambda path: go_on.wait(20) and None if path in pages else None) as url:
        page.goto(f"{url}/viewer/curved{AT}")
        page.wait_for_function("() => document.getElementById('in-flight').textContent.match(/[1-9]/)")
        page.evaluate("() => { farfield.setView([0, 1.6, 0], [0, 0, 1]); }")  # the rows are behind now
        for _ in range(100):
            if given_up:
                break
            page.wait_for_timeout(50)
        assert given_up, "nothing was cancelled"
        go_on.set()
        stats = set_view(page, [0, 1.6, 0], [0, 0, -1])
        assert stats["missing"] == 0 and stats["objects"] > 0


def test_the_service_may_start_anew_while_a_level_comes(folder: Path, page: Any) -> None:
    with serving({"curved": folder}, trouble=lambda path: Cut(-1) if "/geometry/" in path else None) as url:
        page.goto(f"{url}/viewer/curved{AT}")
        page.wait_for_timeout(300)
    page.wait_for_timeout(700)  # nobody listens
    with serving({"curved": folder}, port=int(url.rsplit(":", 1)[1])):
        page.evaluate("farfield.ready()")
        assert page.evaluate("farfield.stats()")["missing"] == 0
        page.wait_for_selector("#notice", state="hidden")


def test_memory_does_not_grow_over_a_long_walk_and_nothing_is_asked_for_twice(folder: Path, page: Any) -> None:
    placement = Placement.open(folder)
    pages = placement.manifest["geometry"]["pages"]
    cap = max(p["memory"] for p in pages) + 1000
    low, high = np.array(placement.manifest["view_space"][0])
    turn = np.linspace(0, 2 * np.pi, 24)
    across = low + (high - low) * np.stack([(1 + np.sin(turn)) / 2, 0.5 + 0 * turn, (1 + np.cos(turn)) / 2], 1)
    lap = np.concatenate([across, np.stack([np.sin(3 * turn), 0 * turn, -np.cos(3 * turn)], 1)], 1)
    text = encode_walk(lap, ms=1000 / 60)
    cdp = page.context.new_cdp_session(page)
    cdp.send("Performance.enable")
    asked: Counter[str] = Counter()
    given_up: Counter[str] = Counter()
    page.on("requestfailed", lambda r: given_up.update([r.url.partition("/v1/")[2]]))

    def heap() -> float:
        cdp.send("HeapProfiler.collectGarbage")
        return float({m["name"]: m["value"] for m in cdp.send("Performance.getMetrics")["metrics"]}["JSHeapUsedSize"])

    def note(path: str) -> None:
        if path.startswith(BASE):
            asked[path.partition("/v1/")[2]] += 1

    page.set_viewport_size({"width": 320, "height": 200})
    with serving({"curved": folder}, trouble=note) as url:
        page.goto(f"{url}/viewer/curved?memory={2 * cap / 1e6}")  # of which the level may take half
        page.evaluate("farfield.ready()")
        heaps = []
        for _ in range(4):
            page.evaluate("text => farfield.replay(text)", text)
            heaps.append(heap())
        stats = page.evaluate("farfield.stats()")
    assert 0 < stats["memory"]["mostLevel"] <= cap < sum(p["memory"] for p in pages)
    assert heaps[-1] - heaps[1] < 1e6, heaps
    assert not {path: n for path, n in asked.items() if n - given_up[path] > 1}
