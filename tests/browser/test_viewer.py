"""The viewer in headless Chromium on the golden placements: right draws, exact texels, honest states, no inline script."""

import base64
import hashlib
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
from PIL import Image

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(
        not (DIST / "viewer.html").is_file(), reason="the pages are not built: npm run build in webviewer"
    ),
]
GOLDEN = ROOT / "tests" / "golden"


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    out = {}
    for name in ("placementdb", "placementdb-visible", "placementdb-ktx2"):
        folder = tmp_path_factory.mktemp(name)
        shutil.copytree(GOLDEN / name, folder / "placement")
        placement = Placement.open(folder)
        level = box_level(placement.index["object_box"] + placement.origin_m, notice="Data (c) the town")
        give_level(folder, level)
        out[name] = folder
    return out


def _picture(url: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))).convert("RGB"))


def _set_view(page: Any, position: Any, direction: Any) -> dict[str, Any]:
    page.evaluate("([p, d]) => farfield.setView(p, d)", [list(map(float, position)), list(map(float, direction))])
    return page.evaluate("farfield.stats()")


@pytest.mark.parametrize("name", ["placementdb", "placementdb-visible"])
def test_draws_what_python_looks_up(name: str, folders: dict[str, Path], open_page: Any) -> None:
    page, wrong = open_page()
    placement = Placement.open(folders[name])
    golden = json.loads((folders[name] / "placement" / "lookups.json").read_text())["lookups"]
    index, model = placement.index, placement.manifest["cost_model"]
    with serving(folders) as url:
        page.goto(f"{url}/viewer/{name}")
        page.evaluate("farfield.ready()")
        shown, covered = 0, 0.0
        for g in [g for g in golden if g["impostors"]][:12] + golden[-12:]:
            stats = _set_view(page, g["position"], g["direction"])
            assert (stats["cell"], stats["interval"], stats["problemView"]) == (
                g["cell"],
                g["interval"],
                g["problem_view"],
            )
            assert stats["hopeless"] == g["hopeless"]
            assert stats["impostors"] == len(g["impostors"])
            assert stats["impostorsWaiting"] == 0
            assert stats["costBound"] == g["cost_bound"]
            seen = _in_view(placement, g["position"], g["direction"])
            drawn = [o for o in g["objects"] if seen[o]]
            assert stats["objects"] == len(drawn)
            assert stats["calls"] == len(drawn) + (len(g["impostors"]) > 0)
            layers = sum(int(index["impostor_triangles"][i]) for i in g["impostors"])
            assert stats["triangles"] == 12 * len(drawn) + layers
            cost = sum(int(index["object_cost"][o]) for o in drawn) + len(g["impostors"]) * model["per_impostor"]
            assert stats["cost"] == cost + model["per_frame"]
            shown += len(g["impostors"])
            covered = max(covered, stats["coveredPixels"])
        assert shown > 10
        assert covered > 0.001
    assert wrong == []


def _in_view(placement: Placement, position: Any, direction: Any) -> np.ndarray:
    """Return (N,) bool: the box has a point in the view pyramid. Clips the box's edges and rays, as the naive twin does."""
    camera = placement.manifest["camera"]
    tan = np.tan(np.radians(camera["fov_deg"]) / 2) * np.array([camera["width"] / camera["height"], 1.0])
    f = np.array(direction) / np.abs(direction).max()  # 1e200 squared overflows
    f /= np.linalg.norm(f)
    r = np.cross(f, [0.0, 1.0, 0.0])
    r = r / np.linalg.norm(r) if np.linalg.norm(r) > 1e-300 else np.array([1.0, 0.0, 0.0])
    sides = np.array([tan[0] * f - r, tan[0] * f + r, tan[1] * f - np.cross(r, f), tan[1] * f + np.cross(r, f)])
    rays = [f + x * tan[0] * r + y * tan[1] * np.cross(r, f) for x in (-1, 1) for y in (-1, 1)]
    out = []
    for box in placement.index["object_box"] + placement.origin_m - np.array(position):
        corners = np.array([[box[k >> a & 1, a] for a in range(3)] for k in range(8)])
        hit = any(_ray_hits(ray, box) for ray in rays)
        for k in range(8):
            for bit in (1, 2, 4):
                if not k & bit:
                    hit = hit or _edge_enters(sides @ corners[k], sides @ corners[k | bit])
        out.append(hit)
    return np.array(out)


def _ray_hits(ray: np.ndarray, box: np.ndarray) -> bool:
    with np.errstate(divide="ignore", invalid="ignore"):
        t = box / ray
    near, far = np.nanmax(np.minimum(t[0], t[1])), np.nanmin(np.maximum(t[0], t[1]))
    return max(near, 0.0) <= far


def _edge_enters(a: np.ndarray, b: np.ndarray) -> bool:
    """Is some point between two points (their distances to the four sides) on the inner side of all?"""
    low, high = 0.0, 1.0
    for x, y in zip(a, b, strict=True):
        if x < 0 and y < 0:
            return False
        if x < 0:
            low = max(low, x / (x - y))
        elif y < 0:
            high = min(high, x / (x - y))
    return low <= high


def test_video_memory_holds_the_pages_texel_for_texel(folders: dict[str, Path], open_page: Any) -> None:
    page, wrong = open_page()
    with serving(folders) as url:
        for name, folder in folders.items():
            placement = Placement.open(folder)
            page.goto(f"{url}/viewer/{name}")
            page.evaluate("farfield.ready()")
            view = next(
                g for g in json.loads((folder / "placement/lookups.json").read_text())["lookups"] if g["impostors"]
            )
            _set_view(page, view["position"], view["direction"])
            image = placement.page(0)
            expected = [
                hashlib.sha256(image[v["y"] : v["y"] + v["size"], v["x"] : v["x"] + v["size"]].tobytes()).hexdigest()
                for v in placement.manifest["page"]["levels"]
            ]
            assert page.evaluate("farfield.pageDigests(0)") == expected
            small = image[..., 3]
            assert ((small > 0) & (small < 8) & (image[..., :3].max(-1) > 8)).any(), (
                "colour under small alpha is what is at stake"
            )
    assert wrong == []


def test_geometry_is_lit_as_the_bake_lights_it(folders: dict[str, Path], open_page: Any) -> None:
    """A picture of geometry alone holds only background and the shades of six box faces in three materials."""
    from farfield.bake.shade import encode_srgb, light

    page, _ = open_page()
    faces = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
    base = np.array([[0.8, 0.7, 0.6], [0.6, 0.3, 0.2], [0.5, 0.5, 0.55]])
    allowed = encode_srgb((base[:, None] * light(faces)[None]).reshape(-1, 3)).astype(int)
    with serving(folders) as url:
        page.goto(f"{url}/viewer/placementdb")
        page.evaluate("farfield.setMode({impostors: false, background: [1, 0, 1]})")
        found = 0
        for g in json.loads((folders["placementdb"] / "placement/lookups.json").read_text())["lookups"][:8]:
            _set_view(page, g["position"], g["direction"])
            picture = _picture(page.evaluate("farfield.capture()")).astype(int)
            packed = picture @ [65536, 256, 1]
            inner = packed[1:-1, 1:-1]  # edges are mixed: only pixels like all four neighbours
            around = (packed[:-2, 1:-1], packed[2:, 1:-1], packed[1:-1, :-2], packed[1:-1, 2:])
            packed = np.unique(inner[np.logical_and.reduce([inner == other for other in around])])
            colors = np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=-1)
            colors = colors[(colors != [255, 0, 255]).any(1)]
            found += len(colors)
            for color in colors:
                assert np.abs(allowed - color).max(1).min() <= 1, f"{color} is no shade of a face"
        assert found > 5


def test_the_page_keeps_to_the_policy_and_the_camera_to_the_placement(folders: dict[str, Path], open_page: Any) -> None:
    for name in ("viewer.html",):
        text = (DIST / name).read_text()
        assert not re.search(
            r"<script(?![^>]*\bsrc=)|<style|\sstyle=|\son\w+=|https?://", text.replace("http://www.w3.org", "")
        )
    page, wrong = open_page(900, 900)
    with serving(folders) as url:
        page.goto(f"{url}/viewer/placementdb")
        page.evaluate("farfield.ready()")
        camera = Placement.open(folders["placementdb"]).manifest["camera"]
        size = page.evaluate("[picture.width, picture.height, picture.clientWidth, picture.clientHeight]")
        assert size[0] <= camera["width"]
        assert abs(size[0] / size[1] - camera["width"] / camera["height"]) < 0.01
        assert abs(size[2] / size[3] - camera["width"] / camera["height"]) < 0.01
        assert _picture(page.evaluate("farfield.capture()")).shape == (camera["height"], camera["width"], 3)
        outside = page.evaluate("farfield.setView([1e4, 1e4, 1e4], [0, 0, -1]).then(() => farfield.stats())")
        assert outside["inside"]
        page.evaluate("farfield.setMode({free: true})")
        free = page.evaluate("farfield.setView([1e4, 1e4, 1e4], [0, 0, -1]).then(() => farfield.stats())")
        assert not free["inside"]
        assert free["impostors"] == 0
        page.wait_for_timeout(300)
        assert "outside the view space" in page.inner_text("#outside")
        assert "Data (c) the town" in page.inner_text("#attribution")
    assert wrong == []


def test_walks_by_keyboard_and_toggles_by_key(folders: dict[str, Path], open_page: Any) -> None:
    page, wrong = open_page()
    with serving(folders) as url:
        page.goto(f"{url}/viewer/placementdb")
        page.evaluate("farfield.ready()")
        before = page.evaluate("farfield.stats()")
        page.keyboard.down("w")
        for _ in range(40):  # frames of a busy machine are few, and none moves farther than a tenth of a second's walk
            page.wait_for_timeout(250)
            after = page.evaluate("farfield.stats()")
            if np.linalg.norm(np.subtract(after["position"], before["position"])) > 0.5:
                break
        page.keyboard.up("w")
        assert np.linalg.norm(np.subtract(after["position"], before["position"])) > 0.5
        assert after["inside"]
        for key, box in {
            "i": "t-impostors",
            "x": "t-split",
            "l": "t-layers",
            "c": "t-cells",
            "f": "t-freeze",
            "g": "t-fly",
        }.items():
            was = page.is_checked(f"#{box}")
            page.keyboard.press(key)
            assert page.is_checked(f"#{box}") != was
        page.keyboard.press("h")
        assert page.is_hidden(".h-ft")
        page.keyboard.press("h")
        assert page.is_visible(".h-ft")
        assert page.is_hidden("#picked"), "nothing was picked"
    assert wrong == []


def test_what_was_switched_off_is_not_counted_as_over_budget(
    folders: dict[str, Path], open_page: Any, tmp_path: Path
) -> None:
    page, wrong = open_page()
    shutil.copytree(folders["placementdb"], tmp_path / "tight")
    manifest = tmp_path / "tight" / "placement" / "manifest.json"
    golden = json.loads((manifest.with_name("lookups.json")).read_text())["lookups"]
    helped = [g for g in golden if g["impostors"] and not g["hopeless"]]
    with serving({**folders, "tight": tmp_path / "tight"}) as url:
        page.goto(f"{url}/viewer/tight")
        loose = max(
            (_set_view(page, g["position"], g["direction"]) for g in helped),
            key=lambda s: s["geometryCost"] - s["cost"],
        )
        assert loose["geometryCost"] > loose["cost"]
        stated = json.loads(manifest.read_text())
        stated["budget"]["amount"] = loose["cost"]
        manifest.write_text(json.dumps(stated))
        give_level(tmp_path / "tight", (tmp_path / "tight" / "scene.glb").read_bytes())
        at, to = (",".join(map(repr, loose[key])) for key in ("position", "direction"))
        page.goto(f"{url}/viewer/tight#at={at}&to={to}")
        page.reload()  # a new fragment alone loads nothing; and no other view, over this budget by right, is drawn
        before = _set_view(page, loose["position"], loose["direction"])
        assert before["over"] == before["overForStreaming"], "what loading made late is said to be so"
        page.keyboard.press("i")
        page.wait_for_timeout(300)
        after = page.evaluate("farfield.stats()")
        assert after["cost"] > after["budget"]
        assert after["over"] == before["over"]
        assert page.inner_text("#impostors").startswith("0 of ")
    assert wrong == []


def test_the_labels_of_the_plots_are_not_cut_off(folders: dict[str, Path], open_page: Any) -> None:
    page, wrong = open_page()
    with serving(folders) as url:
        page.goto(f"{url}/viewer/placementdb")
        page.evaluate("farfield.ready()")
        left = page.evaluate("""["plot-top", "around-top"].map((id) => {
            const label = document.getElementById(id);
            label.textContent = "2,612";
            return label.getBoundingClientRect().left - label.ownerSVGElement.getBoundingClientRect().left;
        })""")
        assert min(left) >= 0, left
        assert page.evaluate("document.getElementById('verdict').getClientRects().length") == 1
    assert wrong == []


def test_never_shows_a_hole_while_pages_are_on_their_way(folders: dict[str, Path], open_page: Any) -> None:
    """Pages fail at first: the view is drawn as geometry, the page says so, and recovers by itself."""
    page, _ = open_page()
    late = {"on": True}
    with serving(folders, trouble=lambda path: 503 if late["on"] and "/pages/" in path else None) as url:
        page.goto(f"{url}/viewer/placementdb")
        page.wait_for_selector("#loading", state="hidden")
        golden = json.loads((folders["placementdb"] / "placement/lookups.json").read_text())["lookups"]
        view = next(g for g in golden if len(g["impostors"]) > 1)
        page.evaluate("([p, d]) => { farfield.setView(p, d); }", [view["position"], view["direction"]])
        page.wait_for_selector("text=connection lost >> visible=true")
        assert "on its way" in page.inner_text("#this-cell")
        assert page.inner_text("#impostors").startswith("0 of ")
        late["on"] = False
        stats = page.evaluate("farfield.stats()")
        assert stats["impostors"] == len(view["impostors"])
        page.wait_for_selector("#notice", state="hidden")


@pytest.mark.parametrize(
    ("path", "content", "says"),
    [
        ("manifest.json", b"{}", "is not a farfield file"),
        (
            "manifest.json",
            b'{"format":"farfield placement","version":7}',
            "format version 7; this farfield reads version 6",
        ),
        ("manifest.json", 404, "manifest.json is missing"),
        ("index-", b"FARFIELD", "is truncated: 8 of at least"),
        ("scene.glb", b"glTF", "scene.glb is altered or damaged"),
        ("manifest.json", 401, "sign in again"),
    ],
)
def test_says_what_is_wrong(path: str, content: Any, says: str, folders: dict[str, Path], open_page: Any) -> None:
    page, _ = open_page()
    with serving(folders, trouble=lambda asked: content if path in asked else None) as url:
        page.goto(f"{url}/viewer/placementdb")
        page.wait_for_selector("#notice:not([hidden])")
        assert says in page.inner_text("#notice")


def test_a_damaged_page_leaves_its_impostors_as_geometry(folders: dict[str, Path], open_page: Any) -> None:
    page, _ = open_page()
    file = Placement.open(folders["placementdb"]).manifest["pages"][0]["file"]
    content = bytearray((folders["placementdb"] / "placement" / file).read_bytes())
    content[len(content) // 2] ^= 1
    with serving(folders, trouble=lambda asked: bytes(content) if file in asked else None) as url:
        page.goto(f"{url}/viewer/placementdb")
        golden = json.loads((folders["placementdb"] / "placement/lookups.json").read_text())["lookups"]
        view = next(g for g in golden if len(g["impostors"]) > 1)
        stats = _set_view(page, view["position"], view["direction"])
        assert stats["impostorsWaiting"] == len(view["impostors"])
        assert stats["objects"] == stats["geometryObjects"]
        page.wait_for_selector("#notice:not([hidden])")
        assert file in page.inner_text("#notice")


def test_without_webgl2_the_page_says_so(folders: dict[str, Path], open_page: Any) -> None:
    page, _ = open_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    with serving(folders) as url:
        page.goto(f"{url}/viewer/placementdb")
        page.wait_for_selector("#notice:not([hidden])")
        assert "No WebGL 2" in page.inner_text("#notice")


def test_pages_are_small() -> None:
    import gzip

    for script in (DIST / "assets").glob("*.js"):
        assert len(gzip.compress(script.read_bytes())) < 250_000, script.name
