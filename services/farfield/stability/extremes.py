"""Stiff and extreme cases through the whole pipeline: each gives a right answer, checked, or a named error.

Right    Not refuted by `verify`: random views and climbs towards the worst of each cell, costs by other code than the
         placement's, no view over budget outside those it calls hopeless, no impostor outside its view cell; every
         number of every artifact finite where it must be; and what the case itself says (`expect`).
"""

import json
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from farfield.errors import FarfieldError
from farfield.stability.level import FACES, Level, street
from farfield.stability.parts import SETUPS, layers_of, many_views
from farfield.stability.run import Run, run
from farfield.stages import Stage
from farfield.steps.result import write_files

LIMIT_S = 60.0
VIEWS, CLIMBS = 300, 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A level and settings. `error` names what must be refused; else `expect` checks what came out (None: nothing more).

    alone  instead of a level: a part of the pipeline by itself; returns (how it ended, what is wrong with that)
    """

    group: str
    name: str
    level: Callable[[], Level] | None = None
    settings: dict[str, Any] = field(default_factory=dict)
    alone: Callable[[], tuple[str, str]] | None = None
    limit_s: float = LIMIT_S
    error: str | None = None
    expect: Callable[[dict[str, Any], Run], str | None] | None = None
    short: bool = False  # also in the short form


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """How a case ended; `wrong` is empty where that is right."""

    group: str
    name: str
    outcome: str
    seconds: float
    wrong: str


def _objects(low: Any, size: Any, **more: Any) -> Level:
    low, size = np.asarray(low, float).reshape(-1, 3), np.asarray(size, float).reshape(-1, 3)
    return Level(np.stack(np.broadcast_arrays(low, low + size), 1), **more)


def _flat(axes: tuple[int, ...]) -> Level:
    """A street whose objects have no extent along some axes: planes, lines, points (as vertices of their triangles)."""
    level = street(30)
    box = level.box.copy()
    for a in axes:
        box[:, 1, a] = box[:, 0, a]
    return replace(level, box=box)


def _in_units(unit_m: float) -> Level:
    return replace(street(30), unit_m=unit_m)


def _one_place(n: int) -> Level:
    return _objects(np.tile([20.0, 0, -3], (n, 1)), np.tile([5.0, 6, 5], (n, 1)))


def _detail_at_distance() -> Level:
    """A centimetre's objects 100 km away, and houses near by."""
    near = street(20).box
    far = np.stack([np.full((10, 3), [1e5, 1.0, 0.0])] * 2, 1)
    far[:, :, 2] += np.arange(10)[:, None] * 0.02
    far[:, 1] += 0.01
    return Level(np.concatenate([near, far]))


def _near_and_far() -> Level:
    """Near / far of 1e9: a millimetre before the view space, a thousand kilometres behind it."""
    return _objects(
        [[-7.999, 1.2, k * 0.01] for k in range(15)] + [[1e6 + 10 * k, 0, 30.0 * k] for k in range(15)],
        [[0.001, 0.002, 0.003]] * 15 + [[3e3, 5e3, 20.0]] * 15,
    )


def _larger_than_view_space() -> Level:
    return _objects(
        [[4.0, -500, -5e3], *([k * 9.0 + 10, 0, 3] for k in range(20))], [[9e3, 900, 1e4], *[[4.0, 5, 6]] * 20]
    )


def _around_the_view_space() -> Level:
    return _objects(
        [[-60.0, -5, -60], *([k * 9.0 + 10, 0, 3] for k in range(20))], [[200.0, 40, 120], *[[4.0, 5, 6]] * 20]
    )


def _touching() -> Level:
    """Objects that share a face, an edge and a corner with the view space."""
    rest = street(20).box
    return Level(
        np.concatenate([[[[-8.0, 1, -4], [-4, 2, 4]], [[-8, 2, -4], [-5, 6, 4]], [[-8, 2, 4], [-6, 3, 7]]], rest])
    )


def _spoiled(which: float) -> Callable[[np.ndarray, int], None]:
    def spoil(position: np.ndarray, i: int) -> None:
        if i == 3:
            position[5, 1] = which

    return spoil


def _slivers(position: np.ndarray, i: int) -> None:
    position[::2, 0] = position[1::2, 0] * np.float32(1 + 1e-7)


def _grid(n: int) -> Level:
    """n alike boxes on a square raster, one mesh: as many draw calls as there are."""
    side = math.ceil(math.sqrt(n))
    raster = np.stack(np.divmod(np.arange(n), side), 1)
    low = np.column_stack([raster[:, 0] * 4.0 + 10, np.zeros(n), raster[:, 1] * 4.0 - side * 2])
    return replace(_objects(low, np.tile([1.0, 2.0, 1.0], (n, 1))), shared=True, faces=FACES)


def _no_problem(report: dict[str, Any], done: Run) -> str | None:
    if len(done.get(Stage.VIEWSPACE).cell) or len(done.get(Stage.PLACEMENT).cluster):
        return "problem views or impostors where the whole scene is within the budget"
    return None


def _all_hopeless(report: dict[str, Any], done: Run) -> str | None:
    placed = done.get(Stage.PLACEMENT)
    return None if len(placed.hopeless) and placed.hopeless.all() else "a budget of nothing is met somewhere"


def _something(report: dict[str, Any], done: Run) -> str | None:
    return None if len(done.get(Stage.PLACEMENT).cluster) else "no impostor was chosen"


def _one_near(report: dict[str, Any], done: Run) -> str | None:
    placed = done.get(Stage.PLACEMENT)
    return (
        None
        if placed.hopeless.any()
        else "one object that no impostor may replace is over the budget, and nobody says so"
    )


def _one_view(report: dict[str, Any], done: Run) -> str | None:
    n = len(done.get(Stage.VIEWSPACE).cell)
    return None if n == 1 else f"{n} problem views where one was meant"


CALLS = {"budget": "14 calls"}
CASES = (
    *(Case(group="scales", name=f"unit {unit:g} m", level=partial(_in_units, unit), settings=CALLS,
           expect=_something, short=unit == 1e6)
      for unit in (1e-6, 1e-3, 1.0, 1e3, 1e6)),
    Case(group="scales", name="1 cm objects at 100 km", level=_detail_at_distance, settings=CALLS, short=True),
    Case(group="scales", name="near / far 1e9", level=_near_and_far, settings=CALLS, short=True),
    Case(group="scales", name="offset 1e7, 1 cm detail",
         level=lambda: Level(street(30).box * 0.01, view=((-0.24, 0.01, -0.04), (-0.08, 0.02, 0.04)), cell=0.08,
                             shift=(1e7, 0.0, -1e7)), settings=CALLS, short=True),
    Case(group="scales", name="planar objects", level=lambda: _flat((0,)), settings=CALLS),
    Case(group="scales", name="linear objects", level=lambda: _flat((0, 2)), settings=CALLS, error="SceneEmpty"),
    Case(group="scales", name="point objects", level=lambda: _flat((0, 1, 2)), settings=CALLS, error="SceneEmpty"),
    Case(group="scales", name="lines and points among houses", settings=CALLS, expect=_something,
         level=lambda: Level(np.concatenate([street(30).box, _flat((0, 2)).box, _flat((0, 1, 2)).box]))),
    Case(group="scales", name="object larger than the view space", level=_larger_than_view_space, settings=CALLS, short=True),
    Case(group="optimizer", name="budget 0", level=lambda: street(30), settings={"budget": "0 calls"}, expect=_all_hopeless),
    Case(group="optimizer", name="budget above the scene's cost", level=lambda: street(30),
         settings={"budget": "1000000 calls"}, expect=_no_problem, short=True),
    Case(group="optimizer", name="one near object over budget alone", level=_around_the_view_space,
         settings={"budget": "11 triangles"}, expect=_one_near),
    Case(group="optimizer", name="all objects in one place", level=lambda: _one_place(30), settings=CALLS, expect=_something,
         short=True),
    Case(group="optimizer", name="identical candidates",
         level=lambda: _objects([[20.0 + 9 * (k // 6), 0, 12.0 * (k % 6) - 33] for k in range(36)], [[4.0, 6, 4]] * 36),
         settings=CALLS, expect=_something),
    Case(group="optimizer", name="one problem view", expect=_one_view,
         settings={"budget": "11 calls", "view_space__interval_deg": 90.0, "camera__fov_deg": 10.0},
         level=lambda: _objects([[20.0 + 9 * k, 0, -2] for k in range(12)], [[4.0, 5, 4]] * 12,
                                view=((-16.0, 1.0, 1.0), (-15.0, 2.0, 2.0)))),
    Case(group="optimizer", name="a million problem views, the greedy alone", alone=lambda: many_views(1_000_000),
         limit_s=300.0),
    Case(group="layers", name="view space without volume", level=lambda: replace(street(30), view=((-9.0, 1.5, 0.0),) * 2),
         settings=CALLS, expect=_something, short=True),
    Case(group="layers", name="objects that touch the view space", level=_touching, settings=CALLS),
    Case(group="layers", name="view space inside an object", level=_around_the_view_space, settings=CALLS),
    Case(group="layers", name="pixel error 64", level=lambda: street(30), settings={**CALLS, "quality__pixel_error": 64.0}),
    Case(group="layers", name="16 x 16 pixels: impostors of a few texels", level=lambda: street(30),
         settings={**CALLS, "camera__width": 16, "camera__height": 16}),
    Case(group="layers", name="field of view 150 degrees", level=lambda: street(30),
         settings={**CALLS, "camera__fov_deg": 150.0}),
    Case(group="layers", name="field of view 0.1 degrees", level=lambda: street(30),
         settings={"budget": "3 calls", "camera__fov_deg": 0.1, "view_space__interval_deg": 45.0}),
    Case(group="layers", name="shafts only", level=lambda: street(30), settings={**CALLS, "placement__candidates": "shafts"}),
    *(Case(group="layers", name=name, alone=partial(layers_of, setup), error=error, short=True)
      for name, setup, error in SETUPS),
    Case(group="geometry", name="degenerate triangles", settings=CALLS,
         level=lambda: replace(street(30), faces=np.array([[0, 0, 0], [1, 1, 2], *FACES]))),
    Case(group="geometry", name="only degenerate triangles", level=lambda: replace(street(5), faces=np.zeros((4, 3), int)),
         settings=CALLS, error="SceneEmpty"),
    Case(group="geometry", name="duplicate triangles", level=lambda: replace(street(30), faces=np.tile(FACES, (9, 1))),
         settings=CALLS),
    Case(group="geometry", name="inverted triangles", level=lambda: replace(street(30), faces=FACES[:, ::-1]), settings=CALLS),
    Case(group="geometry", name="sliver triangles", level=lambda: replace(street(30), spoil=_slivers), settings=CALLS),
    Case(group="geometry", name="a NaN vertex", level=lambda: replace(street(9), spoil=_spoiled(math.nan)), settings=CALLS,
         error="SceneNotFinite", short=True),
    Case(group="geometry", name="an infinite vertex", level=lambda: replace(street(9), spoil=_spoiled(math.inf)),
         settings=CALLS, error="SceneNotFinite", short=True),
    Case(group="geometry", name="0 objects", level=lambda: Level(np.zeros((0, 2, 3))), settings=CALLS, error="SceneEmpty",
         short=True),
    Case(group="geometry", name="65,537 objects", level=lambda: _grid(65_537),
         settings={"budget": "40000 calls", "view_space__interval_deg": 45.0}),
)  # fmt: skip


def try_case(case: Case) -> Outcome:
    """Run one case through every stage and verify it."""
    begun = time.monotonic()
    wrong = ""
    with tempfile.TemporaryDirectory(prefix="farfield-") as name:
        folder = Path(name)
        try:
            if case.level is None:
                assert case.alone is not None
                outcome, wrong = case.alone()
                return _ended(case, outcome, wrong or (f"expected {case.error}" if case.error else ""), begun)
            level = case.level()
            done = run(level.write(folder / "scene.glb"), level.settings(**case.settings), until=Stage.PLACEMENTDB)
            outcome, wrong = _judge(case, done, folder / "placed")
        except FarfieldError as error:
            outcome = f"{error.code}: {error}"
            if error.code != case.error:
                wrong = f"expected {case.error or 'an answer'}"
        except Exception as error:
            outcome = wrong = f"{type(error).__name__}: {error}"
    return _ended(case, outcome, wrong, begun)


def _ended(case: Case, outcome: str, wrong: str, begun: float) -> Outcome:
    seconds = time.monotonic() - begun
    if seconds > case.limit_s:
        wrong = wrong or f"took longer than {case.limit_s:g} s"
    return Outcome(group=case.group, name=case.name, outcome=outcome, seconds=seconds, wrong=wrong)


def _judge(case: Case, done: Run, folder: Path) -> tuple[str, str]:
    """Return (how it ended, what is wrong with that)."""
    from farfield.evaluation.verify import refuted, verify

    folder.mkdir()
    write_files(done.artifacts[Stage.PLACEMENTDB], folder)
    found = verify(folder, views=VIEWS, climbs=CLIMBS)
    placed, views = done.get(Stage.PLACEMENT), done.get(Stage.VIEWSPACE)
    tried = found["views"] + found["climb"]["views"]
    outcome = (
        f"{found['verdict']}: {len(views.cell)} problem views, {int(placed.hopeless.sum())} hopeless, "
        f"{len(placed.cluster)} impostors, {int(placed.bytes.sum())} bytes; {tried} views, worst {found['worst_ratio']:.3f}"
    )
    if case.error:
        return outcome, f"expected {case.error}"
    if refuted(found):
        return outcome, "refuted by verify: " + json.dumps({k: v for k, v in found.items() if k != "worst_view"})
    if not (np.isfinite(placed.view_cell).all() and (placed.bytes >= 0).all() and math.isfinite(found["worst_ratio"])):
        return outcome, "a number is not finite, or negative"
    return outcome, (case.expect(found, done) if case.expect else None) or ""
