"""The exported impostors in three.js' own GLTFLoader against the viewer's: the same picture, but for depth in a texel.

Tolerance: of the pixels within what the viewer shows of impostors (one pixel off the rim, where the viewer mixes by
share and a mask cannot), at most 0.1 % are not covered by the export, the mean difference is at most 3 of 255 and at
most 3 % differ by more than 24 (neighbouring texels: the viewer takes four points a pixel, the export the middle's). No pixel
that the viewer covers is farther than one pixel from one that the export covers.
"""

import base64
import io

import numpy as np
import pytest
from browser.chromium import CHROMIUM, launch
from browser.gltf_page import THREE, serving_gltf
from browser.static_server import DIST, serving
from farfield.evaluation.verify import draw_views
from farfield.export.gltf import export_gltf
from farfield.export.select import select_view
from farfield.placementdb.read import Placement
from pictures import picture, set_view
from PIL import Image

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(not (DIST / "viewer.html").is_file(), reason="the pages are not built: npm run build in webviewer"),
    pytest.mark.skipif(not THREE.is_dir(), reason="the npm packages are not installed: make setup"),
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine"),
]  # fmt: skip
VIEWS = 3


def _wide(mask):
    w = np.pad(mask, 1)
    return np.logical_or.reduce([w[i : i + mask.shape[0], j : j + mask.shape[1]] for i in range(3) for j in range(3)])


def _shoot(page, view, background):
    url = page.evaluate("view => shoot(view)", view | {"background": background})
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))).convert("RGB")).astype(int)


def test_three_js_shows_what_the_viewer_shows(placed, tmp_path):
    api = pytest.importorskip("playwright.sync_api")
    placement = Placement.open(placed[0])
    views = []
    for position, direction in draw_views(placement, 1000, 3):
        shown = placement.lookup(position, direction)
        if shown.problem_view is not None and -0.5 < direction[1] < 0.1:
            views.append((len(shown.impostors), position.tolist(), direction.tolist()))
    views = [sorted(views)[i] for i in np.linspace(len(views) // 2, len(views) - 1, VIEWS).astype(int)]
    camera = placement.manifest["camera"]
    covered, compared = 0.0, 0
    with (
        serving({"cutout": placed[0]}) as viewer_url,
        serving_gltf(tmp_path) as url,
        api.sync_playwright() as playwright,
    ):
        browser = launch(playwright)
        viewer, three = browser.new_page(), browser.new_page()
        viewer.goto(f"{viewer_url}/viewer/cutout")
        viewer.evaluate("farfield.ready()")
        wrong: list[str] = []
        three.goto(url)
        three.on("console", lambda m: wrong.append(m.text) if m.type in ("error", "warning") else None)
        three.on("pageerror", lambda e: wrong.append(str(e)))
        three.wait_for_function("window.started")
        for n, position, direction in views:
            export_gltf(placement, select_view(placement, position, direction), tmp_path / f"{n}.glb")
            loaded = three.evaluate("url => load(url)", f"/files/{n}.glb")
            assert loaded == {"kinds": ["MeshBasicMaterial 0.5"], "scenes": 1}
            view = {"position": position, "direction": direction, "fov": camera["fov_deg"]}
            view |= {"width": camera["width"], "height": camera["height"]}
            black, white = (_shoot(three, view, k) for k in (0, 1))
            through = np.abs(white - black).max(-1)  # of the background: 0 where the export covers the pixel
            set_view(viewer, position, direction)
            impostor = picture(viewer, "coverage").any(-1)
            shown = picture(viewer).astype(int)
            assert not (impostor & ~_wide(through < 255)).any()
            inner = ~_wide(~impostor)
            assert (inner & (through > 2)).sum() <= 0.001 * inner.sum() + 3
            both = inner & (through <= 2)
            difference = np.abs(black - shown).max(-1)[both]
            assert difference.mean() <= 3.0
            assert (difference > 24).mean() <= 0.03
            covered, compared = max(covered, impostor.mean()), compared + both.sum()
        browser.close()
    assert wrong == []
    assert covered > 0.01 and compared > 10_000
