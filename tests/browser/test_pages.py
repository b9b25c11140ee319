"""Jobs, job and report pages in a real browser against the real API, its worker running the toy pipeline."""

import csv
import gzip
import io
import re
import time

import playwright.sync_api
import pytest
from browser.page_service import WEB
from browser.visitor import level, sign_in, submit

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(not (WEB / "jobs.html").is_file(), reason="the pages are not built: make setup"),
]
# Nobody is signed in, a file is not known, a level is refused: answers that browsers log as errors.
EXPECTED = re.compile(r"status of (401|404|422)")


@pytest.fixture
def page(browser, service):
    """A page that nobody is signed in to; fails the test on any script error or breach of the policy."""
    context = browser.new_context(viewport={"width": 1280, "height": 900}, accept_downloads=True)
    page = context.new_page()
    found = []
    page.on("pageerror", lambda error: found.append(str(error)))
    page.on("console", lambda m: m.type == "error" and not EXPECTED.search(m.text) and found.append(m.text))
    page.allowed_errors = re.compile("(?!)")
    yield page
    context.close()
    assert [text for text in found if not page.allowed_errors.search(text)] == []


def downloaded(page, selector):
    with page.expect_download() as waiting:
        page.click(selector)
    return waiting.value.path().read_text()


def test_a_level_is_sent_placed_and_reported(page, service):
    sign_in(page, service)
    page.set_input_files("#new input[type=file]", level("Städtchen (1).glb", shards=24, seconds=0.03, picture=True))
    page.wait_for_selector(".plan.seen image")
    preview = page.inner_text("#new")
    for said in (
        "Städtchen (1).glb",
        "120 from 31 meshes",
        "21,540",
        "588 × 18 × 460 m",
        "split into 12",
        "1.5 to 1.8 m",
        "910 cells × 1,536 directions",
    ):
        assert said in preview
    page.fill("#s-budget", "21")
    page.select_option("#s-device", "laptop")
    page.select_option("#s-priority", "high")
    page.click("text=Start job")
    page.wait_for_url("**/jobs/*")
    page.wait_for_selector("text=/[0-9]+ of [0-9]+ done/")
    page.wait_for_selector(".stages .skipd")
    assert "visibility skipped: the toy has nothing to hide" in page.inner_text(".whyskip")
    page.wait_for_selector(".tobe.inf", timeout=30_000)
    page.wait_for_selector(".map .cells")
    assert "184 of 231" in page.inner_text(".tobe")
    assert "laptop" in page.inner_text(".facts")
    job = page.evaluate("fetch('/v1/jobs/' + location.pathname.split('/')[2]).then(r => r.json())")
    assert (job["priority"], job["settings"]["device"]) == ("high", "laptop")
    assert "24 calls, against 21 calls now" in page.inner_text("#hopeless")
    assert page.inner_text("[data-stage=viewspace] span:last-child") == "24 / 24"
    cell = page.inner_text(".pick b")
    page.focus(".map")
    page.keyboard.press("ArrowLeft")
    assert page.inner_text(".pick b") != cell
    where = page.get_attribute("#hopeless a >> nth=0", "href")
    assert re.fullmatch(r"/viewer/[0-9a-f]{32}#at=[-0-9.,]+&to=[-0-9.e,]+", where)
    page.click("text=Report")
    page.wait_for_selector(".cert")
    page.wait_for_selector(".map .cells")
    certificate = page.inner_text(".cert")
    for said in ("infeasible", "21 calls", "24 calls", "45.6 kB", "1,000", "95.0 %"):
        assert said in certificate
    rows = list(csv.reader(io.StringIO(downloaded(page, "#hopeless >> text=CSV"))))
    assert rows[0][:3] == ["problem_view", "cell", "interval"] and len(rows) == 101
    assert rows[1][-1].startswith("'=")  # a name that a spreadsheet would run
    stages = list(csv.DictReader(io.StringIO(downloaded(page, "[aria-label='stages as CSV']"))))
    assert [s["stage"] for s in stages][:2] == ["scene", "hierarchy"]
    assert next(s["skipped"] for s in stages if s["stage"] == "visibility")


def test_a_known_file_is_not_sent_again(page, service):
    sign_in(page, service)
    sent = []
    page.on("request", lambda r: r.method == "POST" and r.url.endswith("/v1/uploads") and sent.append(r.url))
    for _ in range(2):
        page.set_input_files("#new input[type=file]", level("twice.glb", salt=1))
        page.wait_for_selector("text=Start job")
        page.click("text=Discard")
    assert len(sent) == 1


def _chooser(page):
    """The file chooser that Space opens; headless Chromium misses one now and then."""
    for _ in range(5):
        try:
            with page.expect_file_chooser(timeout=5000) as chooser:
                page.keyboard.press("Space")
            return chooser.value
        except playwright.sync_api.TimeoutError:
            continue
    raise AssertionError("Space opens no file chooser")


def test_the_pages_work_with_the_keyboard_alone(page, service):
    page.goto(f"{service.url}/jobs")
    page.wait_for_selector("#key")
    page.keyboard.type(service.key)
    page.keyboard.press("Enter")
    page.wait_for_selector("#new")
    page.keyboard.press("n")
    page.wait_for_function("document.activeElement.closest('#new')")
    _chooser(page).set_files([level("keys.glb", shards=3)])
    page.wait_for_selector("text=Start job")
    assert page.evaluate("document.activeElement.id") == "s-budget"
    page.keyboard.press("Enter")
    page.wait_for_url("**/jobs/*")
    page.wait_for_selector("text=Run again", timeout=30_000)
    page.keyboard.press("l")
    page.wait_for_selector(".log[open] pre")
    page.keyboard.press("6")
    assert page.get_attribute(".stages li >> nth=5 >> button", "aria-pressed") == "true"
    page.wait_for_function(
        "[...document.querySelectorAll('.log pre .wh')].every(e => e.textContent.startsWith('viewspace'))"
    )
    for key, stage in (("1", "scene"), ("4", "proof")):  # 14 soon after 1
        page.keyboard.press(key)
        assert page.inner_text(".stages button[aria-pressed=true] .n").split()[0] == stage
    page.keyboard.press("t")
    theme = page.evaluate("document.documentElement.dataset.theme")
    page.reload()
    page.wait_for_selector(".stages")
    assert page.evaluate("document.documentElement.dataset.theme") == theme == "dark"
    page.keyboard.press("?")
    page.wait_for_selector("dialog[open]")
    page.keyboard.press("Escape")
    for _ in range(12):  # reading order: skip link, mark, Jobs, Sign out, theme, path, viewer, report
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.textContent") == "Report":
            break
    page.keyboard.press("Enter")
    page.wait_for_selector(".cert")
    page.goto(f"{service.url}/jobs")
    page.wait_for_selector(".jt .scene a")
    page.keyboard.press("/")
    page.keyboard.type("keys.glb")
    assert page.locator(".jt tbody tr").count() == 1
    assert page.url.endswith("#find=keys.glb")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.wait_for_url("**/jobs/*")


def test_what_is_refused_says_what_to_do(page, service):
    page.goto(f"{service.url}/jobs")
    page.fill("#key", "ff_wrong")
    page.keyboard.press("Enter")
    page.wait_for_selector("text=This key is not valid")
    sign_in(page, service)
    page.set_input_files("#new input[type=file]", {"name": "bad.glb", "mimeType": "", "buffer": b"not a level"})
    page.wait_for_selector("text=SceneUnreadable")
    assert "Export the level again" in page.inner_text("#new .note")
    page.set_input_files("#new input[type=file]", level("wide.glb", salt=2))
    page.wait_for_selector("text=Start job")
    page.fill("[id='s-camera.fov_deg']", "500")
    page.click("text=Start job")
    page.wait_for_selector("[id='s-camera.fov_deg'][aria-invalid=true]")
    assert "must be in (0, 150] degrees" in page.inner_text("#new .err:visible")
    page.fill("[id='s-camera.fov_deg']", "wide")
    page.click("text=Start job")
    page.wait_for_selector("text=Needs a number.")
    page.fill("[id='s-camera.fov_deg']", "60")
    page.click("text=Start job")
    page.wait_for_url("**/jobs/*")
    assert "60°" in page.inner_text(".facts")
    page.goto(f"{service.url}/jobs/{'0' * 32}")
    page.wait_for_selector("text=This job cannot be shown")


def test_a_failed_job_shows_its_error_and_can_be_run_again(page, service):
    sign_in(page, service)
    submit(page, level("broken.glb", fail="bake", error="named"))
    page.wait_for_selector(".tobe.bad", timeout=30_000)
    told = page.inner_text(".tobe")
    assert "bake failed" in told and "the toy has no triangles. Check that the export" in told
    page.click("text=Run again")
    page.wait_for_selector("text=Start job")
    assert "broken.glb" in page.inner_text("#new h3")


def test_a_job_is_cancelled_after_asking(page, service):
    sign_in(page, service)
    submit(page, level("slow.glb", shards=200, seconds=0.1))
    page.wait_for_selector(".stages .now")
    page.click("text=Cancel job")
    page.wait_for_selector("dialog[open]")
    page.keyboard.press("Escape")
    assert page.locator(".tobe:has-text('Cancelled')").count() == 0
    page.click("text=Cancel job")
    page.click("dialog[open] >> text=Cancel the job")
    page.wait_for_selector(".tobe:has-text('Cancelled')")
    page.wait_for_selector("text=Run again")


def test_a_lost_connection_is_dated_and_resumed(page, service):
    page.allowed_errors = re.compile("Failed to load resource|net::ERR")
    sign_in(page, service)
    submit(page, level("long.glb", shards=40, seconds=0.15))
    page.wait_for_selector(".stages .now:has-text('viewspace')", timeout=15_000)
    service.stop_api()
    page.wait_for_selector("text=/Not live since .*/")
    assert "nothing is lost, the stream resumes after event" in page.inner_text(".toast")
    time.sleep(0.5)
    service.start_api()
    page.wait_for_selector(".toast .note", state="detached", timeout=15_000)
    page.wait_for_selector("text=Run again", timeout=30_000)
    page.wait_for_function("document.querySelector('[data-stage=viewspace] span:last-child').textContent === '40 / 40'")


def test_a_job_done_without_map_and_figures_is_shown_with_what_there_is(page, service):
    sign_in(page, service)
    job = submit(page, level("plain.glb", plain=True, shards=2))
    page.wait_for_selector(".tobe.ok", timeout=30_000)
    page.goto(f"{service.url}/jobs/{job}/report")
    page.wait_for_selector(".cert .st.ok")
    assert page.locator("text=undefined").count() == page.locator("text=NaN").count() == 0


def test_a_registered_folder_has_its_report(page, service):
    sign_in(page, service)
    page.goto(f"{service.url}/viewer/town/report")
    page.wait_for_selector(".map .cells")
    assert "town, 21 calls" in page.inner_text("h1")
    assert page.get_attribute("text=Open in viewer", "href") == "/viewer/town"
    assert page.locator("#hopeless tbody tr").count() == 20
    page.click("text=Show all 100")
    assert page.locator("#hopeless tbody tr").count() == 100
    page.check("text=By object")
    assert "scaffold_north" in page.inner_text("#hopeless")
    views = page.evaluate("""[...document.querySelectorAll('.histo tbody tr')].map(r => r.innerText.split('\\t'))""")
    counts = [[int(n.replace(",", "")) for n in row[1:]] for row in views]
    assert sum(a for a, _ in counts) == sum(b for _, b in counts) > 0
    assert all(geometry == 0 for row, (geometry, _) in zip(views, counts, strict=True) if row[0].endswith("to 1"))
    assert page.locator(".sbar rect").count() == 28  # time and memory of each stage
    told = "Memory over budget: 45.6 kB at 20 calls, falling to none at 27 calls"
    assert page.get_attribute(".curve svg", "aria-label") == told
    rows = page.locator(".curve:not(.histo) tbody tr")
    assert page.locator(".curve circle").count() == rows.count() == 5
    assert rows.nth(2).inner_text().split() == [
        "22",
        "calls",
        "21.5",
        "kB",
        "47",
        "%",
        "1",
    ]


def test_two_jobs_are_compared(page, service):
    sign_in(page, service)
    jobs = []
    for budget in ("21", "23"):
        page.goto(f"{service.url}/jobs")
        page.set_input_files("#new input[type=file]", level("pair.glb", shards=2, salt=5))
        page.wait_for_selector("text=Start job")
        page.fill("#s-budget", budget)
        page.click("text=Start job")
        page.wait_for_url("**/jobs/*")
        jobs.append(page.url.rsplit("/", 1)[1])
        page.wait_for_selector("text=Compare", timeout=30_000)
    page.click("text=Compare")
    page.wait_for_selector("text=Choose two jobs")
    assert page.input_value("#pick-a") == jobs[1]
    page.select_option("#pick-b", jobs[0])
    page.wait_for_selector("#df-h")
    settings = list(csv.reader(io.StringIO(downloaded(page, "[aria-label='settings as CSV']"))))
    assert settings == [["setting", "a", "b"], ["budget", "23 calls", "21 calls"]]
    assert page.locator(".curve path").count() == 2
    page.reload()  # the address names both
    page.wait_for_selector("#df-h")
    page.goto(f"{service.url}/compare#a={jobs[0]}&b={'0' * 32}")
    page.reload()
    page.wait_for_selector("text=These jobs cannot be compared")


def test_a_key_that_only_reads_starts_nothing(page, service):
    sign_in(page, service, service.reader)
    assert "lacks the scope submit" in page.inner_text("#new")
    page.click("text=Sign out")
    page.wait_for_selector("#key")


@pytest.mark.parametrize("width, scheme", [(390, "dark"), (768, "light"), (1280, "light")])
def test_pages_fit_their_window_and_do_not_jump(page, service, width, scheme):
    sign_in(page, service)
    jobs = page.evaluate("fetch('/v1/jobs?state=done').then(r => r.json())")["jobs"]
    page.set_viewport_size({"width": width, "height": 844})
    page.emulate_media(color_scheme=scheme)
    addresses = ["/jobs", "/viewer/town/report", *(f"/jobs/{j['id']}" for j in jobs[:1])]
    for address in addresses:
        page.goto(service.url + address)
        page.wait_for_selector(".jt, .map .cells, .cert, .stages")
        page.wait_for_timeout(400)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), address
        unnamed = """[...document.querySelectorAll('button, a[href], input, select')].filter(e => e.offsetParent &&
          !(e.textContent.trim() || e.ariaLabel || e.labels?.length || e.getAttribute('aria-labelledby'))).length"""
        assert page.evaluate(unnamed) == 0, address
    shift = """new Promise(done => {
      let sum = 0;
      const add = list => { for (const e of list.getEntries()) if (!e.hadRecentInput) sum += e.value; };
      new PerformanceObserver(add).observe({type: 'layout-shift', buffered: true});
      setTimeout(() => done(sum), 300); })"""
    page.goto(f"{service.url}/jobs")
    page.wait_for_selector(".jt tbody tr, .empty h2")
    page.wait_for_timeout(500)
    assert page.evaluate(shift) < 0.1


@pytest.mark.parametrize("name", ["jobs", "job", "report", "compare", "workers", "storage", "devices"])
def test_a_page_is_small_and_holds_no_inline_code(name):
    html = (WEB / f"{name}.html").read_text()
    assert not re.search(r"<script(?![^>]*\bsrc=)|<style|\bstyle=|\bon\w+=", html)
    files = [WEB / path.lstrip("/") for path in re.findall(r'(?:src|href)="(/[^"#]+)"', html)]
    seen, size = set(), 0
    while files:
        file = files.pop()
        if file in seen:
            continue
        seen.add(file)
        size += len(gzip.compress(file.read_bytes()))
        assert b"WebGLRenderer" not in file.read_bytes(), f"{file.name}: three.js is the viewer's alone"
        if file.suffix == ".js":
            files += [file.parent / f for f in re.findall(r'from"\./([^"]+)"', file.read_text())]
    assert size < 250_000, size
    assert len(seen) >= 5
