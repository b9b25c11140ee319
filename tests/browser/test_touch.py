"""Two thumbs: the stick walks, a finger on the picture looks around, and letting go stops."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser.levels import box_level, give_level
from browser.static_server import DIST, ROOT, serving
from farfield.placementdb.read import Placement
from pictures import view_of

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(
        not (DIST / "viewer.html").is_file(), reason="the pages are not built: npm run build in webviewer"
    ),
]


def _where(page: Any) -> np.ndarray:
    return np.array(view_of(page))


def test_a_small_screen_is_walked_by_touch(browser: Any, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "tests" / "golden" / "placementdb", tmp_path / "placement")
    placement = Placement.open(tmp_path)
    give_level(tmp_path, box_level(placement.index["object_box"] + placement.origin_m))
    context = browser.new_context(viewport={"width": 390, "height": 700}, has_touch=True, is_mobile=True)
    page = context.new_page()
    cdp = context.new_cdp_session(page)

    def touch(kind: str, *points: tuple[float, float]) -> None:
        cdp.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [{"x": x, "y": y} for x, y in points]})

    with serving({"town": tmp_path}) as url:
        page.goto(f"{url}/viewer/town")
        page.evaluate("farfield.ready()")
        stick = page.locator("#stick").bounding_box()
        x, y = stick["x"] + stick["width"] / 2, stick["y"] + stick["height"] / 2
        start = _where(page)
        touch("touchStart", (x, y))
        touch("touchMove", (x, y - 40))
        for _ in range(40):
            page.wait_for_timeout(100)
            if np.linalg.norm(_where(page)[0] - start[0]) > 0.5:
                break
        touch("touchEnd")
        page.wait_for_timeout(300)
        walked = _where(page)
        assert np.linalg.norm(walked[0] - start[0]) > 0.5
        np.testing.assert_allclose(walked[1], start[1], atol=1e-9)
        picture = page.locator("#picture").bounding_box()
        x, y = picture["x"] + 60, picture["y"] + picture["height"] / 2
        touch("touchStart", (x, y))
        touch("touchMove", (x + 30, y))
        touch("touchMove", (x + 80, y))
        touch("touchEnd")
        page.wait_for_timeout(300)
        turned = _where(page)
        np.testing.assert_allclose(turned[0], walked[0], atol=1e-9)
        assert np.dot(turned[1], walked[1]) < 0.999
    context.close()
