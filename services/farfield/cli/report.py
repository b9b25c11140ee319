"""`farfield report DIR`: the report of a finished placement, for people."""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from farfield.errors import ColumnsAltered, ColumnsTooNew, PlacementFileMissing

_VERDICT = {
    "valid": ("green", "every view of the view space meets the budget"),
    "infeasible": ("yellow", "some views cannot meet the budget; all others do"),
    "unproven": ("red", "it is not proved that every view meets the budget"),
}
BAR = 24  # characters


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("report", help="show the report of a finished placement")
    parser.add_argument("folder", type=Path, metavar="DIR", help="what `farfield place --out DIR` wrote")
    parser.add_argument("--json", action="store_true", help="print report.json and nothing else")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Show the report; exit 0."""
    report = read_report(args.folder / "report.json")
    if args.json:
        json.dump(report, sys.stdout)
        print()
        return 0
    out = Console()
    try:
        with out.capture() as shown:
            show_report(report, out)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise ColumnsAltered("report.json", f"a key is missing or has no such value ({error})") from error
    out.out(shown.get(), end="", highlight=False)
    return 0


def read_report(path: Path) -> dict[str, Any]:
    """Return the report in a file. Raises PlacementFileMissing, ColumnsTooNew, ColumnsAltered."""
    try:
        report = json.loads(path.read_bytes())
    except OSError as error:
        raise PlacementFileMissing(str(path)) from error
    except (ValueError, RecursionError) as error:
        raise ColumnsAltered(path.name, "it is not JSON") from error
    if not isinstance(report, dict) or report.get("format") != "farfield report":
        raise ColumnsAltered(path.name, "it is no report of farfield")
    if (version := report.get("version")) != 1:
        if type(version) is not int:
            raise ColumnsAltered(path.name, f"its version is {version!r}")
        raise ColumnsTooNew(path.name, version, 1)
    return report


def show_report(report: Mapping[str, Any], console: Console | None = None) -> None:
    """Print the report: verdict, figures, stages, hopeless views."""
    out = console or Console()
    colour, meaning = _VERDICT[report["verdict"]]
    out.print(f"[bold {colour}]{report['verdict']}[/]  {meaning} ({report['budget']})", highlight=False)
    if report["stopped"]:
        out.print("stopped by its time limit: more time could save memory", highlight=False)
    if base := report.get("base"):
        text = f"placed on {base['manifest_sha256'][:16]}: {base['impostors_kept']:,} of its impostors stand"
        out.print(f"{text}, {base['impostors_built']:,} were built", highlight=False)
    out.print(_figures(report))
    out.print(_stages(report["stages"]))
    if len(report["curve"]) > 1:
        out.print(_curve(report))
    if report["hopeless"]:
        out.print(_hopeless(report))
    if report.get("left_out"):
        out.print(_left_out(report["left_out"]))
    for warning in [*report["warnings"], *report["not_baked"], *map(_look, report.get("looks", ()))]:
        out.print(f"note: {warning}", markup=False, highlight=False)


def _left_out(rows: Sequence[Mapping[str, Any]]) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), title="not needed", title_justify="left")
    for column in ("what", "why", "saved, about"):
        table.add_column(column)
    for row in rows:
        seconds = sorted(set(row["seconds"] or ()))
        saved = " to ".join(f"{s:,.0f}" for s in seconds) + " s" if seconds else "-"
        table.add_row(escape(row["need"]), escape(row["why"]), saved)
    return table


def _look(row: Mapping[str, Any]) -> str:
    kept, baked = row["geometry"], row["flattened"]
    return f"{row['objects']:,} objects are {row['look']}: {kept:,} stay geometry, {baked:,} are baked as they stand"


def cost_text(report: Mapping[str, Any], cost: int) -> str:
    """Return a cost in the budget's unit, for people."""
    return f"{cost / 1e6:,.2f} ms" if report["unit"] == "ns" else f"{cost:,} {report['unit']}"


def _figures(report: Mapping[str, Any]) -> Table:
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    rows = [
        ("scene", f"{report['objects']:,} objects, {report['triangles']:,} triangles"),
        ("view space", f"{report['cells']:,} cells, {report['problem_views']:,} problem views, "
                       f"{report['hopeless_views']:,} hopeless"),
        ("impostors", f"{report['impostors']:,} of {report['candidates']:,} candidates, {report['layers']:,} layers"),
        ("memory", f"{_size(report['bytes'])} of texels, {_size(report['file_bytes'])} in files, "
                   f"{_size(report['video_bytes'])} of video memory"),
        ("fullest view", f"{cost_text(report, report['worst_geometry_cost'])} as geometry, "
                         f"{cost_text(report, report['worst_cost_bound'])} as placed"),
    ]  # fmt: skip
    if bound := report.get("bound"):
        gap = "" if bound["gap"] is None else f", {100 * bound['gap']:.0f} % more"
        rows.insert(4, ("proven bound", f"{_size(report['lower_bound_bytes'])} as estimated before the bake, where "
                                        f"{_size(bound['estimated_bytes'])} are placed{gap}"))  # fmt: skip
    if detail := report.get("detail"):
        spared = f"spare {100 * detail['spared']:.0f} % of the triangles, {_size(detail['bytes'])} of indices"
        rows.insert(2, ("detail", f"{detail['levels']:,} coarser levels for {detail['objects']:,} objects {spared}"))
    if (seen := report.get("visibility")) and seen["mode"] != "off":
        rows.insert(2, ("visibility", _visibility(seen)))
    if report.get("device"):
        rows.append(("device", _device(report["device"])))
    if report["hopeless_views"]:
        rows.append(("would be valid", f"with a budget of {report['smallest_budget']['text']}"))
    proof = report.get("proof")
    if proof and proof["pairs"]:
        rows.append(("proved", f"{proof['pairs']} pictures with impostors against geometry, {proof['failed']} failed: "
                               f"{proof['crack_px']} crack pixels, displaced by at most "
                               f"{proof['worst_displacement_px']:.3f} px, FLIP {proof['flip']:.3f}"))  # fmt: skip
    found = report["verified"]
    if found:
        worst = f"worst {found['worst_ratio']:.3f} of it"
        rows.append(("verified", f"{found['views']:,} random views, {found['over_budget']} over budget, {worst}"))
        if held := found.get("resident"):  # reports of before have none
            worst, median, everything = (_size(held[key]) for key in ("bytes", "median_bytes", "all_bytes"))
            at_once = (
                f"at most {worst} at once, in cell {held['cell']}; {median} in the median cell, {everything} in all"
            )
            rows.append(("memory", at_once))
    for row in rows:
        table.add_row(*row)
    return table


def _visibility(seen: Mapping[str, Any]) -> str:
    missed = "no camera point to test it from"
    if seen["missed_ppm_upper"] is not None:
        missed = f"at most {seen['missed_ppm_upper']:.0f} missed pixels a million (95 %)"
    if seen["p99_ppm"] is not None:
        missed += f", {seen['p99_ppm']:.0f} in the worst view of 100"
    closed = f", {seen['closed_cells']:,} cells closed" if seen["closed_cells"] else ""
    hides = "".join(f"; {reason}" for reason in seen.get("occluders") or ())
    return f"{seen['mode']}: a cell sees {seen['mean_objects']:,.0f} objects, {missed}{closed}{hides}"


def _device(device: Mapping[str, Any]) -> str:
    fit = device["fit"]
    if fit is None:
        return f"{device['name']}, a preset that was not measured"
    return (
        f"{device['name']}, fitted to {fit['samples']:,} frames: {fit['under_share']:.1%} took longer than predicted "
        f"(at worst {fit['worst_ms']:.2f} ms), the mean is {fit['mean_ms']:.2f} ms above"
    )


def _stages(stages: list[dict[str, Any]]) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0))
    table.add_column("stage")
    for name in ("seconds", "memory"):
        table.add_column(name, justify="right")
    table.add_column("")
    longest = max((s["seconds"] for s in stages), default=0) or 1
    for s in stages:
        note = f"[dim]skipped: {escape(s['skipped'])}[/]" if s["skipped"] else "█" * round(BAR * s["seconds"] / longest)
        if s.get("reused"):
            note += f" [dim]{s['reused']} of {s['shards']} shards reused[/]"
        table.add_row(s["name"], f"{s['seconds']:.1f}", _size(s["peak_bytes"]), note)
    return table


def _curve(report: Mapping[str, Any]) -> Table:
    table = Table(
        title="memory over budget, as estimated before the bake", title_justify="left", box=None, padding=(0, 2, 0, 0)
    )
    for name in ("budget", "memory", "views over it"):
        table.add_column(name, justify="right")
    table.add_column("")
    largest = max(point["bytes"] for point in report["curve"]) or 1
    for point in report["curve"]:
        over = f"{point['views_over']:,}" if point["views_over"] else "-"
        bar = "█" * round(BAR * point["bytes"] / largest)
        table.add_row(cost_text(report, point["budget"]), _size(point["bytes"]), over, bar)
    return table


def _hopeless(report: Mapping[str, Any]) -> Table:
    table = Table(title="hopeless views, worst first", title_justify="left", box=None, padding=(0, 2, 0, 0))
    for name in ("view from", "along", "best", "to blame"):
        table.add_column(name)
    for view in report["hopeless"][:10]:
        blamed = ", ".join(str(o["name"]) or f"object {o['id']}" for o in view["culprits"][:3])
        at, along = (
            " ".join(f"{x:.{digits}f}" for x in view[key]) for key, digits in (("position", 1), ("direction", 2))
        )
        table.add_row(at, along, cost_text(report, view["best"]), blamed)
    return table


def _size(n: int) -> str:
    size, unit = float(n), "B"
    for bigger in ("kB", "MB", "GB", "TB"):
        if size < 1000:
            break
        size, unit = size / 1000, bigger
    return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"
