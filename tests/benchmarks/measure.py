"""Seconds, ratios and scaling exponents of one run, as rows of a table.

Seconds depend on the machine and on what else it does; ratios within one run hardly do. So a row holds, next to the
seconds, how many times our time the naive twin takes on one small input, and the slope of log seconds over log size.
"""

import csv
import io
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    stage: str
    work: str  # what was timed
    input: str  # on what
    seconds: float  # best of a few
    rate: float  # of `unit`
    unit: str
    times_naive: float | None = None  # seconds of the naive twin over ours, on `naive_input`
    naive_input: str = ""
    exponent: float | None = None  # seconds ~ size ** exponent, over `sizes`
    sizes: str = ""


def best_seconds(run: Callable[[], Any], *, most: int = 5, within_s: float = 4.0) -> float:
    """Return the least wall-clock seconds of at least two runs: the first may compile or read caches.

    most, within_s  no further run after so many, or after so many seconds in all
    """
    taken: list[float] = []
    while len(taken) < 2 or (len(taken) < most and sum(taken) < within_s):
        start = time.perf_counter()
        run()
        taken.append(time.perf_counter() - start)
    return min(taken)


def twin_seconds(run: Callable[[], Any]) -> float:
    """Return the same of a naive twin, which is slow."""
    return best_seconds(run, most=3, within_s=1.0)


def exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """Return the least-squares slope of log seconds over log sizes; at least two different sizes."""
    x, y = [math.log(s) for s in sizes], [math.log(s) for s in seconds]
    mean_x, mean_y = sum(x) / len(x), sum(y) / len(y)
    across = sum((a - mean_x) ** 2 for a in x)
    return sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True)) / across


_HEAD = ("stage", "work", "input", "seconds", "throughput", "x naive", "exponent")


def _cells(row: Row) -> tuple[str, ...]:
    return (
        row.stage, row.work, row.input, f"{row.seconds:.3g}", f"{_short(row.rate)} {row.unit}",
        "-" if row.times_naive is None else f"{row.times_naive:,.3g} ({row.naive_input})",
        "-" if row.exponent is None else f"{row.exponent:.2f} ({row.sizes})",
    )  # fmt: skip


def _short(value: float) -> str:
    for unit, name in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= unit:
            return f"{value / unit:.3g}{name}"
    return f"{value:.3g}"


def line(row: Row) -> str:
    """Return the row as one line."""
    return " | ".join(f"{name} {cell}" if k > 2 else cell for k, (name, cell) in enumerate(zip(_HEAD, _cells(row))))


def as_table(rows: Sequence[Row]) -> str:
    """Return all rows in columns."""
    lines = [_HEAD, *map(_cells, rows)]
    widths = [max(len(cells[k]) for cells in lines) for k in range(len(_HEAD))]
    return "\n".join("  ".join(c.ljust(w) for c, w in zip(cells, widths)).rstrip() for cells in lines)


def as_csv(rows: Sequence[Row], *, cores: int) -> str:
    """Return all rows as CSV, numbers to three digits; `cores` is what the machine had."""
    out = io.StringIO()
    names = [f.name for f in fields(Row)]
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*names, "cores"])
    for row in rows:
        values = [getattr(row, name) for name in names]
        writer.writerow([*("" if v is None else f"{v:.3g}" if isinstance(v, float) else v for v in values), cores])
    return out.getvalue()
