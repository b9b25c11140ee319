"""The viewer on a finished placement, against the figures that it has to reach; `make` targets run none of it: it takes minutes.

    cd tests && python -m benchmarks.viewer PLACED [--plain PLAIN] [--only first|walk|frames|cost] [--out FILE.json]

PLACED is what `farfield place` wrote; PLAIN the same level placed without a budget to meet and without visibility, which is
geometry with frustum culling. Four parts, each of its own browser (headless, SwiftShader):

first   from the address to the first image without stand-ins, and the bytes of the placement that had come by then; best of 3
walk    five minutes on foot, steered by keyboard and mouse along `farfield.experiment.route`, there and back, with half of what
        the placement holds; what the browser holds every 10 s, every request, and pictures against geometry at stops
frames  a walk of 1,000 frames drawn by impostors and by PLAIN, in turns of pieces so that both meet the same machine
cost    the same walk replayed in the page: counted cost against budget, and the processor's time of the placement code

Nothing is asserted: what comes out is written down (results/viewer.md).
"""

import argparse
import json
import os
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from accept.measure import held_bytes, tree
from browser.chromium import CHROMIUM, FLAGS, launch
from browser.static_server import DIST, serving
from browser.walks import encode_walk
from farfield.evaluation.resident import peak_resident
from farfield.experiment.browser import Pages, find_browser
from farfield.experiment.route import make_route
from farfield.placementdb.read import Placement
from pictures import compare, view_of
from playwright.sync_api import Page, sync_playwright

FRAMES, PIECES = 1000, 10
WALK_S, STEER_S, SAMPLE_S = 300.0, 0.2, 10.0
STOPS = 4
_AHEAD_M, STUCK_S = 3.0, 1.0
RADIANS_PER_PX = 0.0035
HOLD = "() => window.gc && gc()"


def first(folder: Path) -> dict[str, Any]:
    """Return the best of three cold starts."""
    found = []
    with serving({"level": folder}) as url, sync_playwright() as playwright:
        for _ in range(3):
            browser = launch(playwright)
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            page.goto(f"{url}/viewer/level")
            page.evaluate("farfield.ready()")
            stats = page.evaluate("farfield.stats()")
            found.append({key: round(stats[key]) for key in ("firstWholeMs", "firstWholeBytes")})
            browser.close()
    return {"starts": found, "best": min(found, key=lambda f: f["firstWholeMs"])}


def walk(folder: Path, seconds: float) -> dict[str, Any]:
    """Walk for so long with half the memory, and return what was held, asked for and seen."""
    boxes = np.array(Placement.open(folder).manifest["view_space"])
    route = make_route(boxes, 4000)
    held = peak_resident(Placement.open(folder))["all_bytes"]
    asked: Counter[str] = Counter()

    def note(path: str) -> None:
        if path.startswith("/v1/placements/"):
            asked[path] += 1

    with (
        serving({"level": folder}, trouble=note) as url,
        tempfile.TemporaryDirectory() as profile,
        sync_playwright() as playwright,
    ):
        context = playwright.chromium.launch_persistent_context(
            profile, executable_path=CHROMIUM, args=[*FLAGS, "--js-flags=--expose-gc"],
            viewport={"width": 480, "height": 300}
        )  # fmt: skip
        page = context.new_page()
        page.set_default_timeout(120_000)
        given_up: Counter[str] = Counter()
        page.on("requestfailed", lambda r: given_up.update([r.url.removeprefix(url)]))
        at, to = (",".join(map(str, row)) for row in (route[0, :3], route[1, :3] - route[0, :3]))
        page.goto(f"{url}/viewer/level?memory={held / 2e6}#at={at}&to={to}")
        page.evaluate("farfield.ready()")
        told = _on_foot(page, route[:, :3], seconds)
        stats = page.evaluate("farfield.stats()")
        late = page.inner_text("#stream-late")
        context.close()
    repeated = {path: n - 1 - given_up[path] for path, n in asked.items() if n - 1 > given_up[path]}
    return {
        "held_bytes": held, "cap_bytes": held // 2, "stats": stats["memory"], "over": stats["over"], "said": late,
        "over_for_streaming": stats["overForStreaming"], "incomplete": stats["incomplete"],
        "requests": sum(asked.values()), "files": len(asked), "given_up": sum(given_up.values()), "repeated": repeated, **told,
    }  # fmt: skip


def _on_foot(page: Page, route: np.ndarray, seconds: float) -> dict[str, Any]:
    """Steer along the route and back until the time is over; stop now and then to compare with geometry."""
    cdp = page.context.new_cdp_session(page)
    cdp.send("Performance.enable")
    samples: list[dict[str, float]] = []
    holes: list[int] = []
    walked, metres, last = 0.0, 0.0, None
    sampled, stopped, moved = -SAMPLE_S, 0.0, 0.0
    page.focus("#picture")
    page.keyboard.down("w")
    target, forth = 0, 1
    while walked < seconds:
        began = time.monotonic()
        position, heading = _where(page)
        step = float(np.linalg.norm(position - last)) if last is not None else 1.0
        metres += step if last is not None else 0.0
        moved = walked if step > 0.1 else moved
        last = position
        near = _AHEAD_M if walked - moved < STUCK_S else 0.5  # a corner was cut: back to the route itself
        if near == 0.5:
            target = int(np.linalg.norm((route - position)[:, [0, 2]], axis=1).argmin())
        while np.linalg.norm((route[target] - position)[[0, 2]]) < near:
            target += forth
            if not 0 < target < len(route) - 1:
                forth = -forth
        aim = route[target] - position
        turn = (np.arctan2(-aim[0], -aim[2]) - heading + np.pi) % (2 * np.pi) - np.pi
        if abs(turn) > 0.02:
            page.mouse.move(240, 150)
            page.mouse.down()
            page.mouse.move(240 + float(np.clip(turn / RADIANS_PER_PX, -220, 220)), 150)
            page.mouse.up()
        if walked - sampled >= SAMPLE_S:
            sampled = walked
            samples.append({"s": round(walked, 1), "metres": round(metres), **_memory(page, cdp)})
        page.wait_for_timeout(1000 * max(0.0, STEER_S - (time.monotonic() - began)))
        walked += time.monotonic() - began
        if walked - stopped >= seconds / STOPS:
            stopped = walked
            page.keyboard.up("w")
            view = compare(page, *view_of(page))
            holes.append(view.holes)
            page.focus("#picture")
            page.keyboard.down("w")
    page.keyboard.up("w")
    return {"seconds": round(walked), "metres": round(metres), "samples": samples, "holes": holes}


def _where(page: Page) -> tuple[np.ndarray, float]:
    position, direction = view_of(page)
    return np.array(position), float(np.arctan2(-direction[0], -direction[2]))


def _memory(page: Page, cdp: Any) -> dict[str, float]:
    """Return MB: what JavaScript holds once it has cleared up, and the proportional sets of all processes of the browser."""
    page.evaluate(HOLD)
    told = {m["name"]: m["value"] for m in cdp.send("Performance.getMetrics")["metrics"]}
    browser = [pid for pid in tree(os.getpid()) if "chrom" in Path(f"/proc/{pid}/comm").read_text()]
    held = sum(map(held_bytes, browser))
    return {"js_mb": round(told["JSHeapUsedSize"] / 1e6, 1), "browser_mb": round(held / 1e6, 1)}


def frames(folder: Path, plain: Path, pieces: range) -> dict[str, Any]:
    """Return the times of these pieces of the walk, drawn in turns by both."""
    route = make_route(np.array(Placement.open(folder).manifest["view_space"]), FRAMES)
    found: dict[str, list[Any]] = {"farfield": [], "plain": []}
    browser = find_browser()
    assert browser is not None
    with Pages(DIST, browser) as pages:
        for k in pieces:
            rows = route[k * FRAMES // PIECES : (k + 1) * FRAMES // PIECES].tolist()
            for name, where in (("farfield", folder), ("plain", plain)):
                task = {"way": "engine", "reference": False, "walk": rows, "pictures": [], "passes": 1}
                told = pages.measure(task, where / "placement", where / "scene.glb", limit_s=300)
                found[name] += told["frames"]
                assert not told["wrong"], told["wrong"]
    return found


def ratios(found: dict[str, list[Any]]) -> dict[str, Any]:
    """Return worst, p99 and median of both, in ms, and the first through the second."""
    ms = {name: np.array([frame["ms"] for frame in rows]) for name, rows in found.items()}
    out: dict[str, Any] = {"frames": len(ms["plain"])}
    for what, share in (("worst", 1.0), ("p99", 0.99), ("median", 0.5)):
        a, b = (float(np.quantile(ms[name], share, method="inverted_cdf")) for name in ("farfield", "plain"))
        out[what] = {"farfield_ms": round(a, 1), "plain_ms": round(b, 1), "ratio": round(a / b, 3)}
    for what in ("calls", "triangles"):
        out[f"most_{what}"] = {name: max(frame[what] for frame in rows) for name, rows in found.items()}
    return out


def cost(folder: Path) -> dict[str, Any]:
    """Replay the walk in the page until everything on the way is there, and return what the last replay counted."""
    import csv
    import io

    route = make_route(np.array(Placement.open(folder).manifest["view_space"]), FRAMES)
    text = encode_walk(route[:: FRAMES // 250], ms=1000 / 60 * (FRAMES // 250))
    with serving({"level": folder}) as url, sync_playwright() as playwright:
        browser = launch(playwright)
        page = browser.new_page(viewport={"width": 640, "height": 400})
        page.set_default_timeout(300_000)
        page.goto(f"{url}/viewer/level")
        page.evaluate("farfield.ready()")
        page.wait_for_selector("#stream-state:text-is('all resident')")
        rows = list(csv.DictReader(io.StringIO(page.evaluate("text => farfield.replay(text)", text))))
        stats = page.evaluate("farfield.stats()")
        lookups = [page.evaluate("views => farfield.lookupUs(views)", route.tolist()) for _ in range(5)]
        browser.close()
    took = np.array([float(row["placement_ms"]) for row in rows])
    costs = np.array([int(row["cost"]) for row in rows])
    return {
        "frames": len(rows), "budget": stats["budget"], "worst_cost": int(costs.max()), "median_cost": int(np.median(costs)),
        "worst_geometry_cost": max(int(row["geometry_cost"]) for row in rows),
        "over_by_reason": Counter(row["over_budget"] for row in rows if row["over_budget"]),
        "views_with_impostors": sum(int(row["impostors"]) > 0 for row in rows),
        "placement_ms": {str(q): round(float(np.quantile(took, q)), 3) for q in (0.5, 0.9, 0.99, 1.0)},
        "lookup_us": [round(x, 2) for x in lookups],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("placed", type=Path)
    parser.add_argument("--plain", type=Path)
    parser.add_argument("--only", choices=("first", "walk", "frames", "cost"))
    parser.add_argument("--pieces", type=int, nargs=2, default=(0, PIECES), metavar=("FROM", "TO"), help="of `frames`")
    parser.add_argument("--seconds", type=float, default=WALK_S, help="of `walk`")
    parser.add_argument("--out", type=Path, help="keep what was measured, added to what is there")
    given = parser.parse_args()
    kept = json.loads(given.out.read_text()) if given.out and given.out.exists() else {}
    for part in ("first", "walk", "frames", "cost"):
        if given.only not in (None, part) or (part == "frames" and given.plain is None):
            continue
        if part == "frames":
            found = frames(given.placed, given.plain, range(*given.pieces))
            both = kept.setdefault("frame_rows", {"farfield": [], "plain": []})
            for name, rows in found.items():
                both[name] += rows
            kept["frames"] = ratios(both)
        else:
            kept[part] = {"first": first, "cost": cost, "walk": lambda f: walk(f, given.seconds)}[part](given.placed)
        print(part, json.dumps(kept[part], indent=1))
        if given.out:
            given.out.write_text(json.dumps(kept))


if __name__ == "__main__":
    main()
