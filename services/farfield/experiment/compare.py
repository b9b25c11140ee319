"""`farfield experiment compare`: farfield against what a user would pick instead, on one walk, one device, in one run.

Problem  Is it worth it? Plain geometry, visibility, batching, simplified meshes, octahedral impostors, environment maps,
         impostors a cell, the paper's own algorithm and farfield, measured alike.
Method   Each way draws the same walk in the same headless browser with the viewer's own camera, culling, shaders and target
         (webviewer/src/compare). Calls, triangles and video memory are counted where they reach WebGL, not by who draws. A
         frame's time is the least of some passes, until its last pixel can be read back, everything it needs resident
         before. FLIP is against plain geometry's picture.
Errs     Software rendering weighs pixels more, and calls less, than a GPU does. A way that fails keeps its row and says why.
"""

import argparse
import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from farfield.errors import FarfieldError, SettingsInvalid
from farfield.experiment.browser import PageFailed, Pages, find_browser, find_pages
from farfield.experiment.document import Column, Job, Plot, Section, Series, document
from farfield.experiment.error_time import in_boxes
from farfield.experiment.route import district, make_route
from farfield.experiment.sweep import Ran, Sweep
from farfield.settings import Settings, parse_budget
from farfield.stages import Stage
from farfield.steps.result import write_files

HELP = "farfield beside what else could draw this level: frame time, calls, memory, error, preprocessing"
SAID = ("frames", "passes", "pictures", "boxes", "gpu")
LIMIT_S = 600.0  # of one way in the browser
NOT_NEEDED = (Stage.BOUND,)


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """A row. `placed` names the placement it draws, `drawn` how the page draws it."""

    key: str
    label: str
    placed: str
    drawn: str = "engine"
    stages: tuple[Stage, ...] | None = ()  # that its preprocessing consists of; None: all up to the placement database


WAYS = (
    Way(key="geometry", label="geometry, frustum culling", placed="plain"),
    Way(
        key="visibility", label="geometry, our visibility", placed="visibility", stages=(Stage.SCENE, Stage.VISIBILITY)
    ),
    Way(key="batched", label="batched geometry (BatchedMesh)", placed="plain", drawn="batched"),
    Way(key="simplified", label="simplified meshes by distance (meshoptimizer)", placed="plain", drawn="simplified"),
    Way(key="octahedral", label="octahedral impostors, one an object", placed="plain", drawn="octahedral"),
    Way(key="environment", label="layered environment maps", placed="environment", stages=None),
    Way(key="cells", label="impostors a cell", placed="cells", stages=None),
    Way(key="paper", label="the paper's algorithm", placed="paper", stages=None),
    Way(key="farfield", label="farfield", placed="farfield", stages=None),
)

COLUMNS = (
    Column(key="way", label="way to draw"),
    Column(key="worst_ms", label="worst frame, ms", digits=1),
    Column(key="p99_ms", label="99th percentile, ms", digits=1),
    Column(key="median_ms", label="median, ms", digits=1),
    Column(key="worst_calls", label="most draw calls"),
    Column(key="worst_parts", label="most draws, multi-draws taken apart"),
    Column(key="worst_triangles", label="most triangles"),
    Column(key="over", label="frames over the budget"),
    Column(key="frames", label="frames"),
    Column(key="resident_mb", label="video memory, MB", digits=1),
    Column(key="flip", label="FLIP, mean", digits=4),
    Column(key="worst_flip", label="FLIP, worst picture", digits=4),
    Column(key="seconds", label="preprocessing, s", digits=1),
    Column(key="file_mb", label="files beside the level, MB", digits=2),
    Column(key="said", label="what it is"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what only this experiment asks."""
    parser.add_argument("--frames", type=int, default=120, metavar="N", help="frames of the walk (default 120)")
    parser.add_argument("--passes", type=int, default=3, metavar="N", help="times each is drawn and timed (default 3)")
    parser.add_argument("--pictures", type=int, default=8, metavar="N", help="frames compared by FLIP (default 8)")
    parser.add_argument("--boxes", type=int, metavar="N",
                        help="only the N boxes of the view space around its middle: placements in minutes")  # fmt: skip
    parser.add_argument("--gpu", action="store_true", help="let the browser use the GPU (default: software)")


def variants(settings: Settings) -> dict[str, Settings]:
    """Return the settings of every placement that is drawn. The paper's own way: docs/decisions/0011."""
    settings = replace(settings, placement=replace(settings.placement, bound="off"))
    free = replace(settings, budget=_without_limit(settings.budget), detail=replace(settings.detail, mode="off"))
    placed = settings.placement

    def of(**changed: Any) -> Settings:
        return replace(settings, placement=replace(placed, **changed))

    seen = settings.visibility if settings.visibility.mode != "off" else replace(settings.visibility, mode="sampled")
    return {
        "plain": replace(free, visibility=replace(settings.visibility, mode="off")),
        "visibility": replace(free, visibility=seen),
        "environment": of(candidates="environment"),
        "cells": of(candidates="cells"),
        "paper": of(candidates="shafts", view_cells="raw", assignment="all", reverse_delete=False),
        "farfield": settings,
    }


def build(job: Job, args: argparse.Namespace) -> dict[str, Any]:
    """Return the document. Raises SettingsInvalid for counts that are none."""
    started = time.monotonic()
    for flag, least in (("frames", 2), ("passes", 1), ("pictures", 1)):
        if getattr(args, flag) < least:
            raise SettingsInvalid(f"--{flag}", f"must be at least {least}")
    if args.boxes is not None and args.boxes < 1:
        raise SettingsInvalid("--boxes", "must be at least 1")
    title = "Farfield beside what else could draw the level"
    browser, web = find_browser(), find_pages()
    if browser is None or web is None:
        missing = (
            "no Chromium was found; FARFIELD_CHROMIUM names one" if browser is None else "the web pages are not built"
        )
        section = _section((), {}, job.settings, args, missing=missing)
        return document("compare", title, job, [section], seconds=time.monotonic() - started)
    with (
        Sweep(job.scene, job.cache, workers=job.workers, tell=job.tell) as sweep,
        Pages(web, browser, gpu=args.gpu) as pages,
    ):
        settings = job.settings if args.boxes is None else _in_district(sweep, job.settings, args.boxes)
        runs = _placements(sweep, variants(settings))
        counts, found = _draw_all(runs, pages, args, job)
    rows = [_row(way, runs[way.placed], found[way.key], job.settings, args.frames) for way in WAYS]
    drawn = {way.label: f for way in WAYS if isinstance(f := found[way.key], dict)}
    defects = [f"{label}: {line}" for label, f in drawn.items() for line in f["wrong"]]
    notes = sorted({f"{f['renderer']}; {f['browser']}" for f in drawn.values()})
    return document(
        "compare", title, replace(job, settings=settings), [_section(rows, found, settings, args)],
        seconds=time.monotonic() - started, counts=counts, defects=defects, notes=notes,
    )  # fmt: skip


def _in_district(sweep: Sweep, settings: Settings, boxes: int) -> Settings:
    """Return the settings with a view space of so many boxes, cells as large as they were."""
    scene = sweep.run(settings, until=Stage.SCENE, label="view space").inputs().get(Stage.SCENE)
    chosen = (scene.view_boxes + scene.origin_m)[district(scene.view_boxes, boxes)]
    return in_boxes(settings, chosen, cell_m=float(scene.cell_m))


def _without_limit(budget: str) -> str:
    return {"ns": "9000000000 ms", "calls": f"{2**52} calls", "triangles": f"{2**52} triangles"}[
        parse_budget(budget).unit
    ]


def _placements(sweep: Sweep, wanted: dict[str, Settings]) -> dict[str, Ran | str]:
    """Return every placement, or why there is none."""
    made: dict[str, Ran | str] = {}
    for name, settings in wanted.items():
        try:
            made[name] = sweep.run(settings, until=Stage.PLACEMENTDB, label=name, skip=NOT_NEEDED)
        except FarfieldError as error:
            made[name] = f"{error.code}: {error}"
    return made


def _draw_all(
    runs: dict[str, Ran | str], pages: Pages, args: argparse.Namespace, job: Job
) -> tuple[dict[str, Any], dict[str, dict[str, Any] | str]]:
    """Return what the level holds, and what the page measured for each way, or why it did not."""
    from farfield.executor import map_file
    from farfield.placementdb.read import Placement

    found: dict[str, dict[str, Any] | str] = {}
    counts: dict[str, Any] = {}
    walk: list[list[float]] = []
    with tempfile.TemporaryDirectory(prefix="farfield-compare-") as name:
        for way in WAYS:
            ran = runs[way.placed]
            if isinstance(ran, str):
                found[way.key] = ran
                continue
            folder = Path(name) / way.placed
            if not folder.exists():
                write_files(map_file(ran.artifacts[Stage.PLACEMENTDB]), folder)
            if not walk:  # the same for all: their view spaces are
                manifest: dict[str, Any] = Placement.open(folder).manifest
                counts = {key: manifest["counts"][key] for key in ("objects", "triangles", "cells")}
                walk = make_route(np.array(manifest["view_space"]), args.frames).tolist()
            every = max(1, args.frames // args.pictures)
            task = {"way": way.drawn, "reference": way.key == "geometry", "walk": walk, "passes": args.passes,
                    "pictures": list(range(every // 2, args.frames, every))[: args.pictures]}  # fmt: skip
            job.tell(f"{way.label}: drawing")
            try:
                found[way.key] = pages.measure(task, folder / "placement", folder / "scene.glb", limit_s=LIMIT_S)
            except PageFailed as error:
                found[way.key] = str(error)
    return counts, found


def percentile(values: Sequence[float], share: float) -> float:
    """Return the least value that `share` of them do not exceed."""
    ordered = sorted(values)
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]


def _row(way: Way, ran: Ran | str, drawn: dict[str, Any] | str, settings: Settings, frames: int) -> dict[str, Any]:
    row: dict[str, Any] = {"way": way.label, "mark": "current" if way.key == "farfield" else ""}
    if isinstance(ran, str) or isinstance(drawn, str):
        return row | {"said": f"failed: {drawn}"}
    stages = tuple(s for s in Stage if s in ran.times) if way.stages is None else way.stages
    taken = ran.seconds(*stages) if stages else 0.0
    ms = [f["ms"] for f in drawn["frames"]]
    flips = [p["flip"] for p in drawn["pictures"] if p["flip"] is not None]  # none: geometry was not drawn
    budget = parse_budget(settings.budget)
    spent = {"ns": [1e6 * m for m in ms], "calls": [f["calls"] for f in drawn["frames"]],
             "triangles": [f["triangles"] for f in drawn["frames"]]}[budget.unit]  # fmt: skip
    in_page = drawn["prepared_seconds"] if way.drawn != "engine" else 0.0
    stored = drawn["prepared_bytes"] if way.placed != "plain" or way.drawn != "engine" else 0
    return row | {
        "worst_ms": max(ms), "p99_ms": percentile(ms, 0.99), "median_ms": percentile(ms, 0.5),
        "worst_calls": max(f["calls"] for f in drawn["frames"]), "worst_parts": max(f["parts"] for f in drawn["frames"]),
        "worst_triangles": max(f["triangles"] for f in drawn["frames"]), "over": sum(s > budget.amount for s in spent),
        "frames": len(ms), "resident_mb": drawn["bytes"] / 1e6, "flip": sum(flips) / len(flips) if flips else None,
        "worst_flip": max(flips, default=None),
        "seconds": None if taken is None else taken + in_page, "file_mb": stored / 1e6,
        "said": drawn["said"] + (f"; {drawn['fetched']} frames had to fetch again" if drawn["fetched"] else ""),
    }  # fmt: skip


def _section(
    rows: Sequence[dict[str, Any]], found: dict[str, dict[str, Any] | str], settings: Settings, args: argparse.Namespace,
    *, missing: str | None = None,
) -> Section:  # fmt: skip
    drawn = [(way, f) for way in WAYS if isinstance(f := found.get(way.key), dict)]
    curve = lambda value: tuple(  # noqa: E731
        Series(name=way.key, x=tuple(range(len(f["frames"]))), y=tuple(value(frame) for frame in f["frames"]))
        for way, f in drawn
    )
    budget = parse_budget(settings.budget)
    by_row = {row["way"]: row for row in rows}
    points = tuple(
        Series(name=way.key, x=(by_row[way.label]["worst_flip"],), y=(by_row[way.label]["worst_ms"],), line=False,
               labels=(way.key,))
        for way, _ in drawn
    )  # fmt: skip
    plots = (
        Plot(key="compare-time", title="Frame time along the walk", x="frame", y="ms", series=curve(lambda f: f["ms"]),
             log_y=True, level=budget.amount / 1e6 if budget.unit == "ns" else None, level_label="budget"),
        Plot(key="compare-calls", title="Draw calls along the walk", x="frame", y="calls", series=curve(lambda f: f["calls"]),
             log_y=True, level=float(budget.amount) if budget.unit == "calls" else None, level_label="budget"),
        Plot(key="compare-error", title="Worst frame time against worst FLIP", x="FLIP against geometry, worst picture",
             y="worst frame, ms", series=points, log_y=True),
    )  # fmt: skip
    return Section(
        key="compare", title="Ways to draw this level",
        text=_text(rows) if rows else "Nothing was drawn.",
        truth="Plain geometry's own picture, drawn in the same browser; calls, triangles and bytes as they reach WebGL.",
        samples=f"{args.frames} frames, each drawn {args.passes} times; FLIP of {args.pictures} of them",
        columns=COLUMNS, rows=tuple(rows), plots=plots if drawn else (), missing=missing,
    )  # fmt: skip


def _text(rows: Sequence[dict[str, Any]]) -> str:
    """Say which rows beat ours, and in what: they stay."""
    ours = rows[-1]
    named = {"worst_ms": "in the worst frame", "resident_mb": "in video memory", "flip": "in FLIP", "seconds": "in preprocessing",
             "file_mb": "in files"}  # fmt: skip
    if ours.get("worst_ms") is None:
        return "farfield itself could not be drawn."
    beaten = [
        f"{words} by {', '.join(better)}" for key, words in named.items()
        if (better := [r["way"] for r in rows[:-1] if r.get(key) is not None and ours[key] is not None and r[key] < ours[key]])
    ]  # fmt: skip
    return "Ours is beaten " + "; ".join(beaten) + "." if beaten else "No other row is better in any column."
