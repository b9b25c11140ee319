"""`make demo`: serve farfield, submit San Francisco over REST as a studio's pipeline would, end with the viewer's address.

The second run finds the same level and settings done already. FRESH=1 begins anew, DEMO_EXIT=1 takes a screenshot of the
viewer and ends, PORT=8123 listens there.
"""

import hashlib
import json
import os
import secrets
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from urllib.parse import quote

sys.path.insert(0, str(Path(__file__).parent))
import san_francisco

ROOT = Path(__file__).parents[2]
HOME = ROOT / ".cache" / "demo"
# On Russian Hill, looking west: most of what would be too much stands in sight.
START = "at=327.25,43.55,-119.25&to=-0.985,-0.019,0.17"
FARFIELD = str(Path(sys.executable).with_name("farfield"))


def main() -> int:
    """Run the demo; return its exit code."""
    if os.environ.get("FRESH"):
        shutil.rmtree(HOME, ignore_errors=True)
    HOME.mkdir(parents=True, exist_ok=True)
    scene, settings = HOME / "san_francisco.glb", HOME / "san_francisco.toml"
    if not (scene.exists() and settings.exists()):
        print("Building the demo city from OpenStreetMap data ...", flush=True)
        san_francisco.build(scene, settings)
    port = os.environ.get("PORT", "8000")
    command = [FARFIELD, "serve", "--json", "--data", str(HOME / "service"), "--port", port]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            line = server.stdout.readline()
            if not line:
                return server.wait() or 1
            told = json.loads(line)
            job = submit(scene, settings, told)
            if job is None:
                return 1
            viewer = told["jobs"].replace("to=/jobs", "to=" + quote(f"/viewer/{job}#{START}", safe="/"))
            if os.environ.get("DEMO_EXIT"):
                return screenshot(viewer)
            print(f"dashboard: {told['url']}/jobs/{job}\nreport: {told['url']}/jobs/{job}/report", flush=True)
            print(f"viewer: {viewer}\nThe address opens once; afterwards use {told['url']}/viewer/{job}. Stop with Ctrl-C.",
                  flush=True)  # fmt: skip
            return server.wait()
        except KeyboardInterrupt:
            return 0
        finally:
            if server.poll() is None:
                server.send_signal(signal.SIGTERM)


def submit(scene: Path, settings: Path, told: dict[str, str]) -> str | None:
    """Submit the city, show its progress, return the job's id; None when it failed."""
    print("Submitting San Francisco: 4,735 objects, at most 1,300 draw calls a view. The first time takes some minutes.",
          flush=True)  # fmt: skip
    content = hashlib.sha256(scene.read_bytes() + settings.read_bytes()).hexdigest()
    words = [FARFIELD, "submit", str(scene), "--url", told["url"], "--key-file", told["key_file"],
             "--settings", str(settings), "--watch", "--json"]  # fmt: skip
    # The same level again is the same job; if that one failed, a new one, which starts from what was done.
    for key in (f"demo-{content}", f"demo-{secrets.token_hex(8)}"):
        done = subprocess.run([*words, "--idempotency-key", key], stdout=subprocess.PIPE, text=True, check=False)
        if done.returncode in (0, 4) and done.stdout:
            job = json.loads(done.stdout)
            print(f"verdict: {job.get('verdict')}", flush=True)
            return str(job["id"])
        if done.returncode != 1:
            break
    return None


def screenshot(viewer: str) -> int:
    """Open the viewer in headless Chromium, wait for its picture, write out/demo.png."""
    from playwright.sync_api import sync_playwright

    sys.path.insert(0, str(ROOT / "tests"))
    from browser.chromium import launch

    out = ROOT / "out" / "demo.png"
    out.parent.mkdir(exist_ok=True)
    with sync_playwright() as playwright:
        page = launch(playwright).new_page(viewport={"width": 1440, "height": 900})
        page.goto(viewer)
        page.wait_for_url("**/viewer/**")
        page.wait_for_selector("#picture")
        page.evaluate("window.farfield.ready()")
        page.screenshot(path=str(out))
        print(json.dumps(page.evaluate("window.farfield.stats()")))
    print(f"viewer: {viewer}\nscreenshot: {out.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
