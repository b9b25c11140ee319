"""A budget in triangles over curved meshes: levels of detail counted, written, verified, and drawn as counted."""

import json

import numpy as np
import pytest
from browser.chromium import CHROMIUM, launch
from browser.static_server import DIST, serving
from curved import SETTINGS, curved_level
from farfield.evaluation.verify import Eye, draw_views, refuted, verify
from farfield.placementdb.read import Placement
from pictures import picture, set_view
from scipy.ndimage import maximum_filter, minimum_filter

SHADING = 16  # of 255: normals of a simplified mesh turn a little


@pytest.fixture(scope="module")
def folders(run, tmp_path_factory):
    """The curved level, placed with levels by two workers, left to itself by one, and without."""
    folder = tmp_path_factory.mktemp("curved")
    (folder / "level.glb").write_bytes(curved_level())
    out = {}
    for name, mode, workers in (("on", "on", 2), ("auto", "auto", 1), ("off", "off", 1)):
        settings = folder / f"{mode}.toml"
        settings.write_text(SETTINGS.format(budget="12000 triangles", mode=mode))
        words = ("place", folder / "level.glb", "--settings", settings, "--workers", workers, "--json")
        ran = run(*words, "--out", folder / name)
        assert ran.code == 0, ran.err
        out[name] = folder / name, ran.document
    return out


def test_levels_spare_problem_views_and_memory(folders):
    (folder, on), (plain, off) = folders["on"], folders["off"]
    assert on["verdict"] == off["verdict"] == "valid"
    assert on["worst_geometry_cost"] < 0.5 * off["worst_geometry_cost"]
    assert on["problem_views"] < off["problem_views"] and on["bytes"] < 0.6 * off["bytes"]
    assert {s["name"]: s["skipped"] for s in off["stages"]}[
        "detail"
    ] == "detail.mode is off: objects are drawn as they are"
    assert Placement.open(folder).manifest["version"] == Placement.open(plain).manifest["version"] == 6
    assert (folder / "scene.glb").stat().st_size < 1.5 * (plain / "scene.glb").stat().st_size


def test_the_report_says_what_levels_bring(folders):
    (folder, on), (_, off) = folders["on"], folders["off"]
    assert off["detail"] is None
    detail, index = on["detail"], Placement.open(folder).index
    rows = np.diff(index["level_row"])
    assert detail["objects"] == (rows > 0).sum() > 0 and 0 < detail["levels"] <= rows.sum()
    placement, spared, coarser = Placement.open(folder), [], []
    for cell in range(placement.manifest["counts"]["cells"]):  # the slow way, by the reader
        level = placement.levels_in(cell)
        at = [int(index["level_row"][o]) + int(k) - 1 for o, k in enumerate(level) if k]
        drawn = int(index["object_triangles"][level == 0].sum()) + int(index["level_triangles"][at].sum())
        spared.append(1 - drawn / index["object_triangles"].sum())
        coarser.append((level > 0).mean())
    assert detail["spared"] == pytest.approx(np.mean(spared)) and detail["spared"] > 0.1
    assert detail["drawn_coarser"] == pytest.approx(np.mean(coarser))
    glb = (folder / "scene.glb").read_bytes()
    document = json.loads(glb[20 : 20 + int.from_bytes(glb[12:16], "little")])
    of_levels = {k for mesh in document["meshes"] for k in mesh.get("extras", {}).get("levels", [])}
    assert len(of_levels) == detail["levels"]
    accessors = [document["accessors"][p["indices"]] for k in of_levels for p in document["meshes"][k]["primitives"]]
    assert sum(a["count"] for a in accessors) == 3 * detail["triangles"]
    assert sum(a["count"] * {5123: 2, 5125: 4}[a["componentType"]] for a in accessors) == detail["bytes"]


def test_workers_leave_no_trace_and_auto_is_on_where_triangles_are_counted(folders, files_of):
    on, auto = (files_of(folders[name][0]) for name in ("on", "auto"))
    assert on.keys() == auto.keys()
    stating_the_settings = {"report.json", "base.ffc", "placement/manifest.json"}
    assert {name for name in on if on[name] != auto[name]} <= stating_the_settings


def test_no_view_is_over_budget_or_too_coarse(folders):
    folder, _ = folders["on"]
    found = verify(folder, views=3000, seed=9)
    assert (found["over_budget"], found["over_bound"], found["outside_view_cell"], found["too_coarse"]) == (0, 0, 0, 0)
    assert found["in_problem_views"] > 200 and found["worst_ratio"] > 0.9


def test_verify_sees_levels_that_are_shown_too_near(folders):
    placement = Placement.open(folders["on"][0])
    eye, coarse = Eye(placement), 0
    views = [(p, placement.lookup(p, d)) for p, d in draw_views(placement, 200, 1)]
    assert any(v.levels.any() for _, v in views)
    assert sum(eye.too_coarse(v, p) for p, v in views) == 0
    placement.index["level_from"] = placement.index["level_from"] * 1.5  # after the lookups: what they allowed is wrong
    coarse = sum(eye.too_coarse(v, p) for p, v in views)
    assert coarse > 0
    assert refuted({"over_budget": 0, "over_bound": 0, "outside_view_cell": 0, "too_coarse": coarse})


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
@pytest.mark.skipif(not (DIST / "viewer.html").is_file(), reason="the pages are not built: npm run build in webviewer")
def test_the_viewer_draws_the_levels_that_were_counted(folders):
    """In a browser: the triangles of each view as counted, and the picture that of the full meshes to within a pixel."""
    api = pytest.importorskip("playwright.sync_api")
    (folder, _), (plain, _) = folders["on"], folders["off"]
    placement = Placement.open(folder)
    eye = Eye(placement)
    views = [(p, d, placement.lookup(p, d)) for p, d in draw_views(placement, 300, 4)]
    views = sorted(views, key=lambda told: -eye.cost(told[2], told[0], told[1])[1])[:3]  # objects in sight
    pictures = {}
    with api.sync_playwright() as playwright, serving({"on": folder, "off": plain}) as url:
        page = launch(playwright).new_page(viewport={"width": 700, "height": 420})
        for name in ("on", "off"):
            page.goto(f"{url}/viewer/{name}")
            page.evaluate("farfield.ready()")
            for k, (position, direction, view) in enumerate(views):
                stats = set_view(page, position, direction)
                assert np.count_nonzero(view.levels) > 3 and not stats["missing"]
                if name == "on":
                    assert stats["cost"] == eye.cost(view, position, direction)[0] <= view.cost_bound
                else:
                    page.evaluate("farfield.setMode({impostors: false})")
                pictures[name, k] = picture(page)
    for k in range(len(views)):
        on, off = pictures["on", k], pictures["off", k]
        assert not np.array_equal(on, off)
        assert _elsewhere(on, off) < 0.05 * _elsewhere(np.roll(off, 3, axis=1), off)


def _elsewhere(shown: np.ndarray, truth: np.ndarray) -> float:
    """Return the share of pixels whose color is, by more than shading, none of those within a pixel of it in `truth`."""
    truth = truth.astype(np.int16)
    low, high = (f(truth, (3, 3, 1)) for f in (minimum_filter, maximum_filter))
    return float(((shown < low - SHADING) | (shown > high + SHADING)).any(-1).mean())
