"""Seconds, ratios and scaling exponents of one run, as rows of a table.

Seconds depend on the machine and on what else it does; ratios within one run hardly do. So a row holds, next to the
seconds, ratios and a slope:

    x naive    how many times our time the naive twin takes on one small input
    x before   how many times our time the golden run took (results/golden.csv), both in units of the machine's own `sort`
    x bound    how many times a physical bound our time is: the bytes that must move over the memory's bandwidth, or the rays
               over what the ray caster alone does, both measured in the same run
    exponent   slope of log seconds over log size
"""

import csv
import io
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np


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
    least_bytes: int | None = None  # that must be read or written
    bound_s: float | None = None  # what a physical bound allows at best; of `least_bytes` where it is not given
    bound: str = ""
    times_before: float | None = None
    sorts: float | None = None  # seconds in units of the machine's sort


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """What this machine does at best, now."""

    copy_bytes_s: float  # read and written by a copy of an array that no cache holds
    sort_s: float  # numpy's sort of 2**20 random int64: the unit of golden times

    def __str__(self) -> str:
        return f"copies {self.copy_bytes_s / 1e9:.2f} GB/s, sorts 2**20 int64 in {1e3 * self.sort_s:.1f} ms"


def measure_machine() -> Machine:
    """Return the best of a few tries."""
    source = np.zeros(2**24, dtype=np.int64)
    target = np.ones_like(source)
    values = np.random.default_rng(0).integers(0, 2**62, 2**20)
    copied = best_seconds(lambda: np.copyto(target, source))
    return Machine(copy_bytes_s=2 * source.nbytes / copied, sort_s=best_seconds(lambda: np.sort(values)))


def nbytes(*made: Any) -> int:
    """Return the bytes of arrays, and of the arrays that objects of named fields hold."""
    total = 0
    for value in made:
        names = getattr(value, "__dataclass_fields__", None)
        held = [value] if names is None else [getattr(value, name) for name in names]
        total += sum(v.nbytes for v in held if isinstance(v, np.ndarray))
    return total


def finished(row: Row, machine: Machine, golden: Mapping[tuple[str, str], float]) -> Row:
    """Return the row with what needs the machine and the golden run (stage, work -> seconds in units of its sort)."""
    if row.least_bytes is not None and row.bound_s is None:
        row = replace(row, bound_s=row.least_bytes / machine.copy_bytes_s, bound=f"{_short(row.least_bytes)}B moved")
    row = replace(row, sorts=row.seconds / machine.sort_s)
    before = golden.get((row.stage, row.work))
    return replace(row, times_before=before * machine.sort_s / row.seconds) if before and row.seconds else row


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


_HEAD = ("stage", "work", "input", "seconds", "throughput", "x naive", "x before", "x bound", "exponent")


def _cells(row: Row) -> tuple[str, ...]:
    return (
        row.stage, row.work, row.input, f"{row.seconds:.3g}", f"{_short(row.rate)} {row.unit}",
        "-" if row.times_naive is None else f"{row.times_naive:,.3g} ({row.naive_input})",
        "-" if row.times_before is None else f"{row.times_before:.2f}",
        "-" if not row.bound_s else f"{row.seconds / row.bound_s:,.3g} ({row.bound})",
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


def read_rows(text: str) -> list[Row]:
    """Return the rows that `as_csv` wrote."""
    words = {"stage", "work", "input", "unit", "naive_input", "sizes", "bound"}
    return [
        Row(
            **{
                f.name: told[f.name] if f.name in words else float(told[f.name]) if told[f.name] else None
                for f in fields(Row)
            }
        )  # type: ignore[arg-type]
        for told in csv.DictReader(io.StringIO(text))
    ]


def read_golden(text: str) -> dict[tuple[str, str], float]:
    """Return (stage, work) -> seconds in units of that run's sort."""
    return {(row.stage, row.work): row.sorts for row in read_rows(text) if row.sorts is not None}


def as_page(rows: Sequence[Row], machine: Machine, *, command: str, where: str) -> str:
    """Return all rows as a Markdown table with what they rest on."""
    lines = [_HEAD, tuple("---" for _ in _HEAD), *map(_cells, rows)]
    table = "\n".join("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |" for cells in lines)
    return f"    {command}\n\n{where}; it {machine}. Columns: `tests/benchmarks/measure.py`.\n\n{table}\n"
