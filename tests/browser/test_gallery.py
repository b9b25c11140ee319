"""Pictures of every page, to be looked at: out/pictures/pages/, light, dark and small. None jumps or is too wide."""

import json

import pytest
from browser.page_service import GOLDEN, ROOT
from browser.test_live import words
from browser.visitor import level, sign_in
from farfield.store import workers
from farfield.store.workers import Telling

pytestmark = pytest.mark.browser
GALLERY = ROOT / "out" / "pictures" / "pages"
LOOKS = (("light", 1280), ("dark", 1280), ("light", 390))
# name -> (address, what is there once the page is)
PAGES = {
    "jobs": ("/jobs", ".jt tbody tr"),
    "job": ("/jobs/JOB", "#hopeless"),
    "report": ("/jobs/JOB/report", "#hopeless"),
    "compare": ("/compare#a=JOB&b=JOB", "#df-h"),
    "workers": ("/workers", ".ops tbody tr"),
    "devices": ("/devices", "#dh"),
    "storage": ("/storage", "#kh"),
    "viewer": ("/viewer/town#at=AT&to=TO", "#attribution a"),
    "viewer-layers": ("/viewer/town#at=AT&to=TO&show=ilc", "#attribution a"),
    "viewer-difference": ("/viewer/town#at=AT&to=TO&show=ie", "#difference:not([hidden])"),
    "viewer-nothing": ("/viewer/nowhere", "text=No placement here"),
    "methods": ("/methods.html", "#said"),
    "nothing": (f"/jobs/{'0' * 32}", "text=cannot be shown"),
}
MOST_SHIFT = 0.1  # "good" of web.dev's cumulative layout shift
WATCH = """() => {
  window.shift = 0;
  const add = list => { for (const e of list.getEntries()) if (!e.hadRecentInput) window.shift += e.value; };
  new PerformanceObserver(add).observe({type: 'layout-shift', buffered: true});
}"""


@pytest.fixture(scope="module")
def context(browser, service):
    """A signed-in operator with one finished job; its id is `job`."""
    capability = {"cores": 2, "memory_bytes": 24 << 30, "version": "0.1.0", "renderer": "Mesa, llvmpipe"}
    told = {"host": "node-1", "queues": ("cpu", "gl"), "capability": capability}
    workers.tell(
        service.engine, Telling(name="node-1:1", done=41, shard_id="ab" * 16, stage="bake", shard_age_s=7.0, **told)
    )
    workers.tell(service.engine, Telling(name="node-1:2", failed=2, **told))
    found = browser.new_context(viewport={"width": 1280, "height": 900})
    page = found.new_page()
    page.goto(f"{service.url}/jobs")
    page.wait_for_selector("#key")
    _pictures(page, "sign-in")
    sign_in(page, service, service.operator)
    file = level("Innere Stadt.glb", shards=40, picture=True, tell=words(), tell_seconds=0.1)
    page.set_input_files("#new input[type=file]", file)
    page.wait_for_selector("text=Start job")
    page.wait_for_selector(".plan.seen image")
    _pictures(page, "new-job")
    page.click("text=Start job")
    page.wait_for_url("**/jobs/*")
    page.wait_for_selector("text=Compare", timeout=40_000)
    found.job = page.url.rsplit("/", 1)[1]
    page.close()
    found.add_init_script(f"({WATCH})()")
    yield found
    found.close()


def _pictures(page, name):
    GALLERY.mkdir(parents=True, exist_ok=True)
    for scheme, width in LOOKS:
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size({"width": width, "height": 900})
        tall = page.evaluate("document.documentElement.scrollHeight")
        page.set_viewport_size(
            {"width": width, "height": min(6000, max(900, tall))}
        )  # what sticks to an edge is at the end
        page.wait_for_timeout(80)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), (name, width)
        page.screenshot(path=str(GALLERY / f"{name}-{scheme}-{width}.png"))


def _filled(address, job):
    """The address with the job's id, and a view that shows most impostors."""
    told = json.loads((GOLDEN / "lookups.json").read_text())["lookups"]
    view = max(told, key=lambda g: len(g["impostors"]))
    at, to = (",".join(map(str, view[key])) for key in ("position", "direction"))
    return address.replace("JOB", job).replace("AT", at).replace("TO", to)


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_pictured_fits_and_does_not_jump(context, service, name):
    address, there = PAGES[name]
    page = context.new_page()
    for width in (1280, 390):
        page.set_viewport_size({"width": width, "height": 900})
        page.goto("about:blank")
        page.goto(service.url + _filled(address, context.job))
        page.wait_for_selector(there)
        page.wait_for_timeout(300)
        assert page.evaluate("window.shift") < MOST_SHIFT, width
    _pictures(page, name)
    page.close()
