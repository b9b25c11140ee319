"""Every page of the dashboard against the rules of axe-core, light and dark, wide and small."""

import pytest
from browser.page_service import ROOT
from browser.visitor import finished, sign_in
from farfield.store import workers
from farfield.store.workers import Telling

AXE = ROOT / "webviewer" / "node_modules" / "axe-core" / "axe.min.js"
pytestmark = pytest.mark.browser
PAGES = [
    "/jobs",
    "/jobs/JOB",
    "/jobs/JOB/report",
    "/viewer/town/report",
    "/compare#a=JOB&b=JOB",
    "/workers",
    "/storage",
    "/devices",
]
READY = {
    "/jobs": ".jt tbody tr",
    "/jobs/JOB": "#hopeless",
    "/workers": ".ops tbody tr",
    "/storage": "#kh",
    "/devices": "#dh",
}
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
BY_LOOK = ["color-contrast", "scrollable-region-focusable", "target-size"]  # what theme and width may change


@pytest.fixture(scope="module")
def service(service):
    capability = {"cores": 2, "memory_bytes": 24 << 30, "version": "0.1.0", "renderer": None}
    told = {"host": "a", "queues": ("cpu",), "capability": capability}
    workers.tell(service.engine, Telling(name="a:1", failed=2, shard_id="ab" * 16, stage="bake", **told))
    workers.tell(service.engine, Telling(name="a:2", **told))
    return service


@pytest.fixture(scope="module")
def job(browser, service):
    return finished(browser, service, "a.glb")


def _violations(page):
    """All rules as it is; those that look at it again dark, and dark on a small screen.

    axe is evaluated, not added as a script: the pages' policy forbids that.
    """
    if not page.evaluate("typeof window.axe === 'object'"):
        page.evaluate(AXE.read_text())
    found = []
    for scheme, width, rules in (("light", 1280, RULES), ("dark", 1280, BY_LOOK), ("dark", 390, BY_LOOK)):
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=scheme)
        page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        said = page.evaluate("rules => axe.run(document, {runOnly: rules, resultTypes: ['violations']})", rules)
        found += [
            (scheme, width, v["id"], n["target"], n["failureSummary"]) for v in said["violations"] for n in v["nodes"]
        ]
    page.set_viewport_size({"width": 1280, "height": 900})
    page.emulate_media(color_scheme="light")
    return found


@pytest.mark.skipif(not AXE.is_file(), reason="axe-core is not installed: make setup")
def test_no_page_breaks_a_rule_of_accessibility(open_page, service, job):
    page, _ = open_page()
    page.goto(f"{service.url}/jobs")
    page.wait_for_selector("#key")
    found = {"sign in": _violations(page)}
    sign_in(page, service, service.operator)
    for address in PAGES:
        page.goto("about:blank")
        page.goto(service.url + address.replace("JOB", job))
        page.wait_for_selector(READY.get(address, "#hopeless" if "report" in address else "#df-h"))
        found[address] = _violations(page)
    page.goto(f"{service.url}/jobs")
    page.set_input_files("#new input[type=file]", {"name": "b.glb", "mimeType": "", "buffer": b'{"picture": true}'})
    page.wait_for_selector("text=Start job")
    page.wait_for_selector("#s-device option >> nth=1", state="attached")
    found["a new job"] = _violations(page)
    page.focus("main")
    page.keyboard.press("?")
    page.wait_for_selector("dialog[open]")
    found["keys"] = _violations(page)
    assert {where: what for where, what in found.items() if what} == {}
