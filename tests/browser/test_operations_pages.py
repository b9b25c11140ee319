"""The pages of operators in a real browser: workers, storage, and what those see who may not."""

import csv
import io
import re

import pytest
from browser.visitor import sign_in
from farfield.store import workers
from farfield.store.workers import Telling

pytestmark = pytest.mark.browser


@pytest.fixture
def visit(open_page, service):
    """Return a function: (address, key) -> the page, signed in."""

    def make(address, key, width=1280):
        page, wrong = open_page(width)
        sign_in(page, service, key, address=address, there="main h1:not(#sign-h)")
        return page, wrong

    return make


def _tell(service, name, queues, renderer=None, **told):
    capability = {"cores": 2, "memory_bytes": 24 << 30, "version": "0.1.0", "renderer": renderer}
    workers.tell(service.engine, Telling(name=name, host="node-1", queues=queues, capability=capability, **told))


def _bad(wrong):
    return [text for text in wrong if not re.search(r"status of (401|403|404)", text)]


def test_workers_are_shown_and_kept_fresh(visit, service):
    page, wrong = visit("/workers", service.operator)
    page.wait_for_selector("text=No worker has told of itself")
    shard = {"shard_id": "ab" * 16, "stage": "bake", "shard_age_s": 7.0}
    _tell(service, "node-1:1", ("cpu", "gl"), "Mesa, llvmpipe", done=41, failed=2, recent=10, **shard)
    _tell(service, "node-1:2", ("cpu",))
    page.reload()
    page.wait_for_selector(".ops tbody tr")
    first, second = (page.locator(".ops tbody tr").nth(k).inner_text() for k in (0, 1))
    for said in ("busy", "node-1:1", "cpu, gl", "25.77 GB", "Mesa, llvmpipe", "bake", "abababab", "41", "2", "2.0"):
        assert said in first
    assert "idle" in second and "does not bake" in second
    assert "Nobody works on optimizer" in page.inner_text(".note.inf")
    _tell(service, "node-1:3", ("optimizer",))
    page.wait_for_selector(".ops tbody tr >> nth=2", timeout=12_000)  # by itself
    assert page.locator(".note.inf").count() == 0
    with page.expect_download() as waiting:
        page.click("[aria-label='workers as CSV']")
    rows = list(csv.DictReader(io.StringIO(waiting.value.path().read_text())))
    assert [r["worker"] for r in rows] == ["node-1:1", "node-1:2", "node-1:3"] and rows[0]["failed"] == "2"
    assert _bad(wrong) == []


def test_storage_is_shown_by_kind_and_tenant(visit, service):
    page, wrong = visit("/storage", service.operator)
    page.wait_for_selector("#uh")
    assert "no limit" in page.inner_text(".quotas")
    page.wait_for_selector("text=/Nothing is stored yet|By kind/")
    page.goto(f"{service.url}/jobs")
    page.set_input_files("#new input[type=file]", {"name": "a.glb", "mimeType": "", "buffer": b"{}"})
    page.wait_for_selector("text=Start job")
    page.goto(f"{service.url}/storage")
    page.wait_for_selector("#kh >> text=By kind")
    assert "the operator" in page.inner_text("#th >> xpath=../..")
    table = page.inner_text("#kh >> xpath=../..")
    assert table.index("Scenes") < table.index("Reports")  # what takes most stands first
    assert _bad(wrong) == []


@pytest.mark.parametrize("address", ["/workers", "/storage"])
def test_who_may_not_see_it_is_told_why(visit, service, address):
    page, wrong = visit(address, service.reader, 390)
    page.wait_for_selector("text=For the operator")
    assert "scope admin" in page.inner_text(".note")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.get_attribute(f"nav a[href='{address}']", "aria-current") == "page"
    if address == "/storage":
        assert "Jobs queued or running" in page.inner_text(".quotas")  # the own room is everybody's to see
    assert _bad(wrong) == []


@pytest.mark.parametrize("address", ["/workers", "/storage"])
def test_a_service_that_is_away_is_dated_and_asked_again(visit, service, address):
    page, _ = visit(address, service.operator)
    page.wait_for_selector(".panel header")
    page.route("**/v1/workers", lambda route: route.abort())
    page.route("**/v1/storage", lambda route: route.abort())
    page.reload()
    page.wait_for_selector("text=cannot be read")
    page.unroute("**/v1/workers")
    page.unroute("**/v1/storage")
    page.click("text=Try again")
    page.wait_for_selector("text=cannot be read", state="detached")
    page.wait_for_selector("#wh" if address == "/workers" else "#kh")
