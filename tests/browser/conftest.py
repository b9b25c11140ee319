"""One headless Chromium a file of browser tests, and pages that remember what went wrong in them."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from browser.chromium import CHROMIUM, launch
from browser.page_service import WEB, PageService


@pytest.fixture(
    scope="module"
)  # not the session: one thread can hold only one Playwright, and later files start theirs
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine")
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as playwright:
        chromium = launch(playwright)
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageService]:
    if not (WEB / "workers.html").is_file():
        pytest.skip("the pages are not built: make setup")
    service = PageService(tmp_path_factory.mktemp("service"))
    service.start()
    yield service
    service.stop()


@pytest.fixture
def open_page(browser: Any) -> Iterator[Callable[..., tuple[Any, list[str]]]]:
    """Return a function: size -> (page, list of console errors, exceptions and policy violations, live)."""
    pages = []

    def make(width: int = 1280, height: int = 800) -> tuple[Any, list[str]]:
        page = browser.new_page(viewport={"width": width, "height": height})
        pages.append(page)
        wrong: list[str] = []
        page.on("console", lambda m: wrong.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda e: wrong.append(str(e)))
        return page, wrong

    yield make
    for page in pages:
        page.close()
