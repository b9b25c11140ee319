"""Headless Chromium as the tests use it: software WebGL2, and nothing that talks to the network."""

import shutil
from typing import Any

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = (
    "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--no-first-run",
)  # fmt: skip


def launch(playwright: Any) -> Any:
    """Return a browser of the Playwright instance; close it."""
    return playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
