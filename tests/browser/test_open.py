"""The link that `farfield serve` prints opens the viewer without a key being typed, once."""

import json
import os
import shutil
import subprocess
import sys

import pytest

pytestmark = pytest.mark.browser
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture
def served(tmp_path):
    web, town = tmp_path / "web", tmp_path / "town"
    for folder in (web / "assets", town / "placement"):
        folder.mkdir(parents=True)
    (town / "placement" / "manifest.json").write_text('{"version": 1}')
    (web / "viewer.html").write_text('<!doctype html><script type="module" src="/assets/a.js"></script>')
    script = 'const r = await fetch("/v1/placements/town/manifest.json");'
    (web / "assets" / "a.js").write_text(script + 'document.body.append(`status ${r.status}`); eval("1");')
    command = [sys.executable, "-m", "farfield.cli.main", "serve", "--port", "0", "--workers", "0", "--json",
               "--data", str(tmp_path / "data"), "--placement", str(town)]  # fmt: skip
    environment = {**os.environ, "FARFIELD_WEB": str(web)}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        yield {**json.loads(process.stdout.readline()), "key": (tmp_path / "data" / "api-key").read_text()}
        process.terminate()


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
def test_a_login_link_opens_the_viewer_once(served):
    from playwright.sync_api import sync_playwright

    link = served["viewers"]["town"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        errors = []
        page = browser.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(link)
        page.wait_for_url("**/viewer/town")
        page.wait_for_selector("text=status 200")
        assert "unsafe-eval" in errors[0]  # the policy holds
        page.goto(link)  # used, but this browser has its session
        page.wait_for_url("**/viewer/town")
        stranger = browser.new_context().new_page()
        stranger.goto(link)
        stranger.wait_for_selector("text=used before")
        assert stranger.url.endswith("/open")  # the token has left the address
        stranger.fill("#key", served["key"])
        stranger.click("button")
        stranger.wait_for_url("**/viewer/town")
        browser.close()
