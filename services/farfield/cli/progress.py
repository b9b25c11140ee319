"""The progress table of `place` and `submit`: a line a stage, readable at 80 columns."""

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Column


def stage_bars(console: Console, *, disable: bool = False) -> Progress:
    """Return the table; tasks have a field `note`, which gives way where the line is too long."""
    return Progress(
        TextColumn("{task.description}", table_column=Column(width=12, no_wrap=True)),
        BarColumn(bar_width=20),
        MofNCompleteColumn(table_column=Column(min_width=7, no_wrap=True)),
        TimeElapsedColumn(table_column=Column(width=7, no_wrap=True)),
        TextColumn(
            "{task.fields[note]}", markup=False, table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis")
        ),
        console=console,
        expand=True,
        disable=disable,
    )
