"""The heat map of texels a pixel: colours of the tokens' scale on impostors, grey on geometry, a legend, picking."""

import base64
import io
import json
import re
import shutil

import numpy as np
import pytest
from browser.levels import box_level, give_level
from browser.static_server import DIST, ROOT, serving
from farfield.placementdb.read import Placement
from PIL import Image

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(not (DIST / "viewer.html").is_file(), reason="the pages are not built: make setup"),
]
SCALE = "[...Array(7).keys()].map(k => getComputedStyle(document.documentElement).getPropertyValue(`--q${k}`).trim())"


def _picture(page):
    text = page.evaluate("farfield.capture()")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(text.split(",")[1]))).convert("RGB")).astype(int)


def test_texels_a_pixel_are_shown_in_the_colours_of_the_scale(open_page, tmp_path):
    shutil.copytree(ROOT / "tests" / "golden" / "placementdb", tmp_path / "placement")
    placement = Placement.open(tmp_path)
    give_level(tmp_path, box_level(placement.index["object_box"] + placement.origin_m))
    lookups = json.loads((tmp_path / "placement" / "lookups.json").read_text())["lookups"]
    page, wrong = open_page()
    with serving({"town": tmp_path}) as url:
        page.goto(f"{url}/viewer/town")
        page.evaluate("farfield.ready()")
        for view in [g for g in lookups if g["impostors"]][:12]:
            page.evaluate("([p, d]) => farfield.setView(p, d)", [view["position"], view["direction"]])
            if page.evaluate("farfield.stats()")["coveredPixels"] > 0.001:
                break
        else:
            pytest.fail("no view shows an impostor")
        covered = np.asarray(
            Image.open(io.BytesIO(base64.b64decode(page.evaluate("farfield.coverage()").split(",")[1]))).convert("RGB")
        ).any(2)

        def share_of_scale():
            """Return which share of the covered pixels has a colour of the scale: edges mix, and golden texels have many."""
            scale = np.array([[int(c[k : k + 2], 16) for k in (1, 3, 5)] for c in page.evaluate(SCALE)])
            return (np.abs(_picture(page)[covered][:, None, :] - scale[None]).max(2).min(1) <= 2).mean()

        plain = share_of_scale()
        page.keyboard.press("m")
        page.wait_for_selector("#heat:not([hidden])")
        light = share_of_scale()
        page.keyboard.press("t")
        dark = share_of_scale()
        assert min(light, dark) > max(0.15, 10 * plain), (plain, light, dark)
        assert "m" in re.search("show=([a-z]*)", page.evaluate("farfield.share()"))[1]
        y, x = np.argwhere(covered)[len(np.argwhere(covered)) // 2]
        box = page.locator("#picture").bounding_box()
        high, wide = covered.shape
        page.evaluate("farfield.setMode({overlay: true})")
        page.mouse.click(box["x"] + (x + 0.5) * box["width"] / wide, box["y"] + (y + 0.5) * box["height"] / high)
        page.wait_for_selector("#picked:not([hidden])")
        for said in ("objects", "problem views", "at most"):
            assert said in page.inner_text("#picked")
        page.keyboard.press("l")
        page.wait_for_selector("#heat[hidden]", state="attached")
        page.keyboard.press("l")
    assert [text for text in wrong if "status of 40" not in text] == []
