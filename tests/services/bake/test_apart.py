"""OpenGL in a child process: what takes the driver takes the child, never the worker, and changes no texel."""

import os
from typing import Any

import pytest
from farfield.bake.bake import bake_batch
from farfield.bake.gl.apart import Child, ContextLost, child
from farfield.bake.gl.context import NoContext
from farfield.bake.gl.record import RecorderApart
from farfield.candidates.model import BOX
from farfield.columns import pack_dataclass
from farfield.errors import FarfieldError
from farfield.hierarchy.build import build_hierarchy
from farfield.rendertime.cost import build_cost_model
from farfield.settings import from_mapping
from panels import Panel, box_cell, chosen, panel_scene

SETTINGS = from_mapping({"camera": {"width": 320, "height": 180}})


def baked() -> Any:
    scene = panel_scene([Panel(low=(-20, 0, -30), u=(40, 1, 3), v=(2, 9, -60))])
    hierarchy, model = build_hierarchy(scene), build_cost_model(scene, settings=SETTINGS)
    placement = chosen([0], BOX, box_cell((-2, 1, -2), (2, 3, 2)))
    return bake_batch(scene, hierarchy, model, placement, settings=SETTINGS, impostors=(0, 1), renderer="egl")


def test_a_child_that_aborts_is_replaced():
    other = Child()
    try:
        mine = other.call("os:getpid")
        assert mine != os.getpid()
        with pytest.raises(ContextLost, match="status -6"):
            other.call("os:abort")
        assert other.call("os:getpid") not in (mine, os.getpid())
        with pytest.raises(ZeroDivisionError):  # what a call raises is no crash
            other.call("operator:truediv", 1, 0)
        with pytest.raises(RuntimeError, match="TextIOWrapper"):
            other.call("os:fdopen", 2)  # an answer that cannot travel
        assert other.call("os:getpid") > 0
    finally:
        other.end()
    assert not issubclass(ContextLost, FarfieldError)  # those are facts about the input, and never tried again


def test_a_call_that_is_broken_off_leaves_no_answer_for_the_next(monkeypatch: pytest.MonkeyPatch):
    other = Child()
    try:
        other.call("os:getpid")
        with pytest.MonkeyPatch.context() as patch:

            def cancelled(stream: Any) -> Any:
                raise KeyboardInterrupt

            patch.setattr("farfield.bake.gl.apart.pickle.load", cancelled)
            with pytest.raises(KeyboardInterrupt):
                other.call("operator:add", 1, 1)
        assert other.call("operator:add", 2, 3) == 5
    finally:
        other.end()


def test_a_driver_that_crashes_once_changes_no_texel(gl: Any, monkeypatch: pytest.MonkeyPatch):
    sound = pack_dataclass(baked())
    crashes = []

    def crash(self: RecorderApart, width: int, height: int) -> None:
        if not crashes:
            crashes.append(1)
            child().call("os:abort")
        begin(self, width, height)

    begin = RecorderApart.begin
    monkeypatch.setattr(RecorderApart, "begin", crash)
    assert pack_dataclass(baked()) == sound
    assert crashes


def test_sheets_that_grow_keep_the_child(gl: Any):
    """A framebuffer that goes while it is bound leaves an error behind: each larger sheet once cost a process."""
    recorder = RecorderApart()
    recorder.begin(64, 32)
    recorder.end()
    first = child()._process
    for width, height in ((64, 64), (200, 80), (16, 16), (512, 300)):
        recorder.begin(width, height)
        assert recorder.end().shape == (height, width)
    assert child()._process is first


def test_a_driver_that_always_crashes_fails_the_shard_alone(gl: Any, monkeypatch: pytest.MonkeyPatch):
    sound = pack_dataclass(baked())
    with monkeypatch.context() as patch:
        patch.setattr(RecorderApart, "blocks", lambda *given: child().call("os:abort"))
        with pytest.raises(ContextLost):
            baked()
    assert pack_dataclass(baked()) == sound


def test_no_context_crosses_the_border():
    other = Child()
    try:
        found = other.call("farfield.bake.gl.context:NoContext", "spawn it instead")
    finally:
        other.end()
    assert isinstance(found, NoContext) and "spawn it" in str(found)
