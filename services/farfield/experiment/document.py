"""What an experiment hands on: one JSON document of sections, each a table with its plots, and what it all rests on.

`report.json` is this document; CSV files and the page are made from it and from nothing else (`files`). Every section
says how its truth was found, every document on what scene, settings, samples, machine, versions and command it rests.
"""

import dataclasses
import hashlib
import os
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from farfield.settings import Settings, to_mapping

FORMAT, VERSION = "farfield experiment", 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """What an experiment is asked to look at, and where it may keep its work."""

    scene: Path
    settings: Settings
    cache: Path
    workers: int
    command: str
    tell: Callable[[str], None] = lambda text: None


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A column of a section's table. `digits` are those after the point; None: as it is."""

    key: str
    label: str
    digits: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """Points of a plot, in the order in which a line joins them. `marked`, `pareto`: indices of points."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    line: bool = True
    marked: tuple[int, ...] = ()  # the setting that the job itself has
    pareto: tuple[int, ...] = ()  # no other point is better in both
    labels: tuple[str, ...] = ()  # of each point, shown where there is room and in its tooltip


@dataclass(frozen=True, slots=True, kw_only=True)
class Plot:
    """One plot. `level` draws a horizontal line: what a figure is held against."""

    key: str  # file name
    title: str
    x: str  # axis labels, with units
    y: str
    series: tuple[Series, ...]
    log_x: bool = False
    log_y: bool = False
    level: float | None = None
    level_label: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """One question, its table and its plots. A row is a mapping by the columns' keys; `mark` in a row: "current" or "".

    text    what was varied and what came out, in sentences
    truth   where the figures come from that the judged code had no hand in
    samples how many of what
    missing why there is no table, where something was not there to measure with; None: there is one
    """

    key: str
    title: str
    text: str
    truth: str
    samples: str
    columns: tuple[Column, ...] = ()
    rows: tuple[Mapping[str, Any], ...] = ()
    plots: tuple[Plot, ...] = ()
    missing: str | None = None


def document(
    name: str,
    title: str,
    job: Job,
    sections: Sequence[Section],
    *,
    seconds: float,
    notes: Sequence[str] = (),
    counts: Mapping[str, Any] | None = None,
    defects: Sequence[str] = (),
) -> dict[str, Any]:
    """Return the document as JSON values.

    counts    what is in the scene (objects, triangles, cells, ...)
    seconds   wall clock of all of it
    defects   what must not be and was found, in sentences
    Its settings are the job's own; what a row changed stands in its row.
    """
    with job.scene.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {
        "format": FORMAT, "version": VERSION, "name": name, "title": title, "command": job.command,
        "scene": {"name": job.scene.name, "sha256": digest, **(counts or {})},
        "settings": to_mapping(job.settings), "machine": machine(), "seconds": round(seconds, 1),
        "software": {package: version(package) for package in ("farfield", "numpy", "numba")},
        "notes": list(notes), "defects": list(defects), "sections": [_plain(section) for section in sections],
    }  # fmt: skip


def machine() -> dict[str, Any]:
    """Return what ran it: processor, cores that this process may use, system."""
    model = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.split(":", 1)[1].strip()
                break
    except OSError:  # not Linux
        pass
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"processor": model, "cores": cores, "system": f"{platform.system()} {platform.machine()}"}


def pareto(x: Sequence[float], y: Sequence[float]) -> tuple[int, ...]:
    """Return the indices of points that no other point beats: less or equal in both, and less in one."""
    points = list(zip(x, y, strict=True))
    return tuple(
        i for i, (a, b) in enumerate(points)
        if not any(p <= a and q <= b and (p < a or q < b) for p, q in points)
    )  # fmt: skip


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value
