"""A placement opens again while the service is stopped, and never for a session that it was not fetched in."""

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser.page_service import GOLDEN, WEB, PageService
from browser.visitor import sign_in
from pictures import picture

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(not (WEB / "viewer.html").is_file(), reason="the pages are not built: make setup"),
]
KEPT = """async () => {
  const names = [];
  for (const name of await caches.keys())
    for (const r of await (await caches.open(name)).keys()) names.push(new URL(r.url).pathname);
  return names;
}"""
FILES = "/v1/placements/town/"


@pytest.fixture
def restarted(service: PageService) -> Iterator[PageService]:
    yield service
    if not service._api.is_alive():
        service.start_api()


@pytest.fixture
def visitor(browser: Any, service: PageService) -> Iterator[Callable[[str | None], Any]]:
    """Return a function: with a key it signs in; a page of the one browser profile of the test."""
    profile = browser.new_context(viewport={"width": 640, "height": 400})

    def visit(key: str | None) -> Any:
        page = profile.new_page()
        if key is not None:
            sign_in(page, service, key, there="#sign-out:not([hidden])")
        return page

    yield visit
    profile.close()


def _open(page: Any, service: PageService) -> None:
    page.goto(f"{service.url}/viewer/town")
    page.evaluate("farfield.ready()")


def _open_and_keep(page: Any, service: PageService) -> None:
    _open(page, service)
    page.wait_for_selector("#stream-state:text-is('all resident')")
    manifest = json.loads((GOLDEN / "manifest.json").read_text())
    geometry = manifest["geometry"]
    entries = [manifest["index"], *manifest["chunks"], *manifest["pages"], geometry["index"], *geometry["pages"]]
    _wait_for(page, {"/viewer/", *(FILES + entry["file"] for entry in entries)})


def _wait_for(page: Any, names: set[str]) -> None:
    for _ in range(100):
        if names <= set(page.evaluate(KEPT)):
            return
        page.wait_for_timeout(100)
    raise AssertionError(f"not kept: {names - set(page.evaluate(KEPT))}")


def test_a_viewed_placement_opens_with_the_server_stopped(
    restarted: PageService, visitor: Callable[[str | None], Any]
) -> None:
    page = visitor(restarted.key)
    _open_and_keep(page, restarted)
    before = picture(page)
    restarted.stop_api()
    page.reload()
    page.evaluate("farfield.ready()")
    np.testing.assert_array_equal(picture(page), before)
    assert page.evaluate("farfield.stats()")["missing"] == 0
    page.wait_for_selector("#notice:not([hidden])")
    assert "does not answer" in page.text_content("#notice-title")
    restarted.start_api()
    page.reload()
    page.evaluate("farfield.ready()")
    assert page.is_hidden("#notice")


def test_what_is_kept_goes_with_the_session(restarted: PageService, visitor: Callable[[str | None], Any]) -> None:
    page = visitor(restarted.key)
    _open_and_keep(page, restarted)
    page.goto(f"{restarted.url}/jobs")
    page.click("#sign-out")
    page.wait_for_selector("#key")
    assert not [name for name in page.evaluate(KEPT) if name.startswith("/v1/")]

    page = visitor(restarted.key)
    _open_and_keep(page, restarted)
    page.context.clear_cookies()  # the session ends without a word to the page
    page.reload()
    page.wait_for_selector("#notice:not([hidden])")
    assert page.text_content("#notice-title") == "Not signed in"
    assert not [name for name in page.evaluate(KEPT) if name.startswith("/v1/")]
    restarted.stop_api()
    page.reload()
    page.wait_for_selector("#loading:not([hidden]), #notice:not([hidden])")
    assert not page.evaluate("performance.getEntriesByType('resource').some((e) => e.name.includes('.ffz'))")


def test_a_placement_made_anew_is_never_shown_as_it_was(
    restarted: PageService, visitor: Callable[[str | None], Any], tmp_path: Path
) -> None:
    page = visitor(restarted.key)
    _open_and_keep(page, restarted)
    folder = restarted.settings.placements["town"] / "placement"
    shutil.copytree(folder, tmp_path / "was")
    shutil.rmtree(folder)
    shutil.copytree(GOLDEN.with_name("placementdb-detail"), folder)
    try:
        page.reload()  # the new one has no level to show: its manifest and index are enough
        index = json.loads((folder / "manifest.json").read_text())["index"]["file"]
        _wait_for(page, {FILES + index})
        kept = page.evaluate(KEPT)
        assert FILES + json.loads((GOLDEN / "manifest.json").read_text())["index"]["file"] not in kept
    finally:
        shutil.rmtree(folder)
        shutil.copytree(tmp_path / "was", folder)
