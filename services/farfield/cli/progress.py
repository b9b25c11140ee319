"""The progress table of `place` and of the verbs that follow a job: a line a stage, readable at 80 columns."""

from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Column

from farfield.stages import Stage


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


def follow(events: Iterable[tuple[str, dict[str, Any]]], console: Console) -> None:
    """Show a job's events, (kind, data) each, until the last one; where there is no terminal, a line a stage."""
    with stage_bars(console, disable=not console.is_terminal) as bars:
        tasks = {str(s): bars.add_task(s, total=None, start=False, note="") for s in Stage}
        for kind, data in events:
            task = tasks.get(data.get("stage", ""))
            if kind == "stage" and task is not None:
                if data["state"] == "planning":
                    bars.start_task(task)
                elif data["state"] in ("running", "merging") and "shards" in data:
                    bars.update(task, total=max(data["shards"], 1), completed=data.get("done"))
                elif data["state"] in ("done", "skipped", "failed"):
                    if not console.is_terminal:  # bars would only show at the end of a build's log
                        reason = f": {data['skipped']}" if data.get("skipped") else ""
                        console.out(f"{data['stage']} {data['state']}{reason}", highlight=False)
                    bars.update(task, total=1, completed=1)
                    bars.stop_task(task)
                if data.get("skipped"):
                    bars.update(task, note=f"skipped: {data['skipped']}")
            elif kind == "shard" and task is not None and data["kind"] == "run" and data["state"] == "done":
                bars.advance(task)
