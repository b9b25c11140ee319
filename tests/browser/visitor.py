"""What who visits the pages does first: signs in, and sends a toy level."""

import json
from typing import Any

from browser.page_service import PageService


def sign_in(
    page: Any, service: PageService, key: str | None = None, *, address: str = "/jobs", there: str = "#new"
) -> None:
    """Open the address as a stranger and sign in, by default with the key that submits; `there`: what the page then shows."""
    page.goto(service.url + address)
    page.fill("#key", key or service.key)
    page.keyboard.press("Enter")
    page.wait_for_selector(there)


def level(name: str = "level.glb", **wish: Any) -> dict[str, Any]:
    """Return a toy level as a file to choose; `salt` tells levels apart that wish for the same."""
    return {"name": name, "mimeType": "model/gltf-binary", "buffer": json.dumps(wish).encode()}


def submit(page: Any, file: dict[str, Any]) -> str:
    """Choose the file, start its job, and return the job's id once its page is there."""
    page.set_input_files("#new input[type=file]", file)
    page.click("text=Start job")
    page.wait_for_url("**/jobs/*")
    return str(page.url.rsplit("/", 1)[1])


def finished(browser: Any, service: PageService, name: str) -> str:
    """Return the id of a finished job of the operator's, of a level with this name."""
    page = browser.new_page()
    sign_in(page, service, service.operator)
    job = submit(page, level(name, shards=3, picture=True))
    page.wait_for_selector("text=Compare", timeout=30_000)
    page.close()
    return job
