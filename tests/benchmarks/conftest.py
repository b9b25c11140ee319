"""Benchmarks run with --bench only; their rows are printed at the end, and kept with --bench-save.

Kept are results/VERSION.csv and .md; results/golden.csv, what later runs are held against, is made by copying the former: it
changes on purpose only. What was kept of benchmarks that a run leaves out stays: a long run can be made in pieces.
"""

import os
import platform
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from benchmarks.inputs import Level, cutout_level
from benchmarks.measure import (
    Machine,
    Row,
    as_csv,
    as_page,
    as_table,
    finished,
    line,
    measure_machine,
    read_golden,
    read_rows,
)  # fmt: skip
from farfield.stages import Stage

HERE = Path(__file__).parent
_ORDER: list[str] = [*Stage, "service"]
_ORDER.insert(_ORDER.index(Stage.CANDIDATES), "impostor")  # the leaf that candidates stands on
_ROWS = pytest.StashKey[list[Row]]()
_MACHINE = pytest.StashKey[Machine]()
_GOLDEN = HERE / "results" / "golden.csv"


def _place(row: Row) -> int:
    return _ORDER.index(row.stage.split()[0])


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--bench"):
        for item in items:
            if HERE in item.path.parents:
                item.add_marker(pytest.mark.skip(reason="a benchmark: run `make bench`, or pytest with --bench"))
    if not config.getoption("--bench-large"):
        for item in items:
            if item.path == HERE / "test_scale.py":
                item.add_marker(pytest.mark.skip(reason="minutes each: run pytest with --bench --bench-large"))


def pytest_terminal_summary(terminalreporter: Any, exitstatus: int, config: pytest.Config) -> None:
    rows = sorted(config.stash.get(_ROWS, []), key=_place)
    if not rows:
        return
    machine = config.stash[_MACHINE]
    terminalreporter.section("benchmarks")
    terminalreporter.write_line(f"The machine {machine}.")
    terminalreporter.write_line(as_table(rows))
    if config.getoption("--bench-save"):
        if exitstatus:
            terminalreporter.write_line("not saved: a benchmark failed")
            return
        path = HERE / "results" / f"{version('farfield')}.csv"
        path.parent.mkdir(exist_ok=True)
        cores = len(os.sched_getaffinity(0))
        kept = {(row.stage, row.work): row for row in read_rows(path.read_text("utf-8"))} if path.exists() else {}
        rows = sorted({**kept, **{(row.stage, row.work): row for row in rows}}.values(), key=_place)
        path.write_text(as_csv(rows, cores=cores), encoding="utf-8")
        where = f"farfield {version('farfield')}, {platform.machine()}, {cores} cores, {platform.system()}"
        page = as_page(rows, machine, command="make bench", where=where)
        path.with_suffix(".md").write_text(f"# Benchmarks of {version('farfield')}\n\n{page}", encoding="utf-8")
        terminalreporter.write_line(f"saved as {path.relative_to(HERE.parents[1])}")


@pytest.fixture
def report(request: pytest.FixtureRequest) -> Callable[..., None]:
    """Takes the fields of a Row, prints it and keeps it for the table."""

    config = request.config
    if _MACHINE not in config.stash:
        config.stash[_MACHINE] = measure_machine()
    golden = read_golden(_GOLDEN.read_text(encoding="utf-8")) if _GOLDEN.exists() else {}

    def add(**given: Any) -> None:
        row = finished(Row(**given), config.stash[_MACHINE], golden)
        request.config.stash.setdefault(_ROWS, []).append(row)
        print("\n" + line(row), end="", flush=True)

    return add


@pytest.fixture(scope="session")
def cutout() -> Level:
    return cutout_level()


@pytest.fixture(scope="session")
def coarse_cutout() -> Level:
    """The cut-out with a camera of few pixels, so that all its impostors are baked in seconds."""
    return cutout_level(180)
