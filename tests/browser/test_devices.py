"""Devices: presets and measured ones; the device at hand is measured, stopped, refused, and fitted."""

import re

import numpy as np
import pytest
from browser.visitor import sign_in

pytestmark = pytest.mark.browser
SEND = """async ([id, samples]) => {
  const { csrf_token } = await (await fetch('/v1/session')).json();
  const headers = { 'content-type': 'application/json', 'x-csrf-token': csrf_token };
  return (await fetch(`/v1/devices/${id}/samples`, { method: 'POST', headers, body: JSON.stringify({ samples }) })).status;
}"""


def _samples(n):
    """Return made-up frames whose costs are known: 2 ms a frame, 8 us a call, 4 ns a triangle, ..."""
    rng = np.random.default_rng(5)
    of = {"calls": (2000, 8e-3), "triangles": (800_000, 4e-6), "pixels": (4_000_000, 2e-7), "impostors": (400, 1e-3),
          "impostor_triangles": (4000, 5e-6), "impostor_pixels": (3_000_000, 2e-7)}  # fmt: skip
    rows = []
    for _ in range(n):
        drawn = {name: int(most * rng.uniform(0.05, 1.0) ** 2) for name, (most, _) in of.items()}
        rows.append({**drawn, "ms": 2.0 + sum(drawn[name] * ms for name, (_, ms) in of.items())})
    return rows


def test_a_device_is_measured_until_it_is_stopped_and_what_is_missing_is_said(open_page, service):
    page, wrong = open_page()
    sign_in(page, service, address="/devices", there="#dh")
    assert "preset, not measured" in page.inner_text(".devs")
    page.fill("#dev-name", "laptop")
    page.keyboard.press("Enter")
    page.wait_for_selector("text=is a preset")
    page.fill("#dev-name", "this machine")
    page.select_option("#dev-size", "0")
    page.keyboard.press("Enter")
    page.wait_for_selector("text=/[2-9] of 180 frames/", timeout=90_000)
    said = page.inner_text("#measure p.small")
    assert "SwiftShader" in said and re.search("gpu timer|fences", said)
    page.click("#measure form button")
    page.wait_for_selector("text=No profile yet", timeout=20_000)
    note = page.inner_text("#measure .note")
    assert "too few" in note and "measure 100" in note and "You stopped early" in note
    assert page.get_attribute("#measure .dots.open", "d").count("M") >= 2
    device = page.evaluate("fetch('/v1/devices').then(r => r.json()).then(d => d.devices[0])")
    assert device["name"] == "this machine" and device["samples"] >= 2 and device["profile"] is None
    assert page.evaluate(SEND, [device["id"], _samples(150)]) == 200
    page.reload()
    page.wait_for_selector(".devs tbody tr >> text=this machine")
    row = page.inner_text(".devs tbody tr >> nth=0")
    assert "of unseen frames took longer" in row and re.search(r"[\d.]+ µs", row)
    page.click("[aria-label='Delete this machine']")
    page.click("dialog[open] >> text=Delete the device")
    page.wait_for_selector(".devs tbody tr >> text=this machine", state="detached")
    assert [text for text in wrong if "status of 40" not in text] == []


def test_who_only_reads_is_told_why_nothing_is_measured(open_page, service):
    page, _ = open_page(390)
    sign_in(page, service, service.reader, address="/devices", there="#dh")
    assert page.is_disabled("#measure form button") and "may read only" in page.inner_text("#measure")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
