"""Every page with the keyboard alone: what can be operated is reached by Tab, in view and visibly focused, and none is a trap."""

import pytest
from browser.visitor import finished, sign_in

pytestmark = pytest.mark.browser
# address -> what is there once the page is
PAGES = {
    "/jobs": ".jt tbody tr",
    "/jobs/JOB": "#hopeless",
    "/jobs/JOB/report": "#hopeless",
    "/compare#a=JOB&b=JOB": "#df-h",
    "/workers": "main h1",
    "/devices": "#dh",
    "/storage": "#kh",
    "/viewer/town": "#worst a",
}
# What a pointer could use: of a group of arrow keys (radio buttons, roving tabindex) only the one that Tab stops at.
OPERABLE = """() => {
  const all = [...document.querySelectorAll('a[href], button, input, select, textarea, summary, [tabindex]')];
  const able = e => !e.closest('[inert]') && !e.disabled && e.tabIndex >= 0;
  const shown = e => e.checkVisibility({ checkOpacity: false, checkVisibilityCSS: true }) && able(e);
  const radios = new Set();
  return all.filter(shown).filter(e => {
    if (e.type !== 'radio') return true;
    if (radios.has(e.name)) return false;
    return radios.add(e.name);
  }).map((e, k) => (e.dataset.stop = k, e.outerHTML.slice(0, 160)));
}"""
FOCUSED = """() => {
  const e = document.activeElement;
  if (!e || e === document.body) return null;
  const drawn = ['checkbox', 'radio', 'file'].includes(e.type); // what stands for it may show the focus
  const shown = drawn ? [e, e.parentElement, e.nextElementSibling] : [e];
  const box = e.getBoundingClientRect();
  const of = x => { const s = getComputedStyle(x); return `${s.outlineStyle} ${s.outlineWidth}`; };
  const marked = shown.some(x => x && /^(solid|auto|dashed|double) [1-9]/.test(of(x)));
  return { stop: e.dataset.stop ?? null, html: e.outerHTML.slice(0, 160), marked,
    inside: box.bottom > 0 && box.right > 0 && box.top < innerHeight && box.left < innerWidth };
}"""


@pytest.fixture(scope="module")
def job(browser, service):
    return finished(browser, service, "keyboard.glb")


@pytest.fixture(scope="module")
def signed_in(browser, service, job):
    """Pages of one profile that is signed in."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = context.new_page()
    sign_in(page, service, service.operator)
    page.close()
    yield context
    context.close()


@pytest.mark.parametrize("address", PAGES)
def test_tab_reaches_all_that_can_be_operated(signed_in, service, job, address):
    page = signed_in.new_page()
    page.goto(service.url + address.replace("JOB", job))
    page.wait_for_selector(PAGES[address])
    if address.startswith("/viewer"):
        page.evaluate("farfield.ready()")
    page.wait_for_timeout(300)
    page.evaluate("() => document.activeElement?.blur()")
    operable = page.evaluate(OPERABLE)
    assert len(operable) > 3
    stops = []
    for _ in range(2 * len(operable) + 10):
        page.keyboard.press("Tab")
        at = page.evaluate(FOCUSED)
        if at is None or (stops and at == stops[0]):
            if len(stops) > 1:
                break
            continue
        stops.append(at)
    else:
        raise AssertionError(f"Tab never comes round: {[s['html'] for s in stops[-4:]]}")
    reached = {s["stop"] for s in stops}
    assert [html for k, html in enumerate(operable) if str(k) not in reached] == []
    assert [s["html"] for s in stops if not s["marked"]] == [], "focused, and nothing shows it"
    assert [s["html"] for s in stops if not s["inside"]] == [], "focused out of sight"
    page.close()
