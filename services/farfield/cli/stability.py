"""`farfield stability`: where the arithmetic ends. Formulas and predicates against 50 digits, extreme cases, relations."""

import argparse
import json
import sys
from typing import Any

from farfield.errors import SettingsInvalid


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser(
        "stability",
        help="formulas against 50 digits, extreme levels, exact relations",
        description="Needs mpmath. Exit code 4 where something is not as it must be.",
    )
    parser.add_argument(
        "--short", action="store_true", help="fewer inputs and the quick cases: seconds instead of minutes"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="which inputs (default 0)")
    parser.add_argument("--json", action="store_true", help="print one JSON document and nothing else")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Try everything; exit 4 where something does not hold, 2 where mpmath is not installed."""
    if args.seed < 0:
        raise SettingsInvalid("--seed", "must be at least 0")
    try:
        import mpmath  # noqa: F401
    except ImportError:
        print("stability: it computes in 50 digits with mpmath, which is not installed.", file=sys.stderr)
        print("Install it with: pip install 'farfield[compute,exact]'", file=sys.stderr)
        return 2
    from rich.console import Console

    from farfield.stability.report import build_stability

    with Console(stderr=True, quiet=args.json).status("") as status:
        found = build_stability(short=args.short, seed=args.seed, tell=status.update)
    if args.json:
        json.dump(found, sys.stdout)
        print()
    else:
        _show(found)
    return 0 if found["holds"] else 4


def _show(found: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console()

    def table(title: str, *columns: str) -> Table:
        made = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))
        for column in (*columns, ""):
            made.add_column(column, overflow="fold")
        return made

    def verdict(row: dict[str, Any]) -> str:
        return "" if row["holds"] else "[bold red]WRONG[/]"

    rows = table(
        "Formulas: largest relative error over the condition", "formula", "equation", "float64", "float32", "NaN", "at"
    )
    for row in found["formulas"]:
        double, single = row["float64"], row["float32"]
        rows.add_row(
            row["name"], row["equation"], f"{double['error']:.1e}", f"{single['error']:.1e}",
            f"{double['not_a_number']} / {single['not_a_number']}", double["at"], verdict(row),
        )  # fmt: skip
    console.print(rows)
    rows = table("Predicates: largest relative margin decided wrongly", "predicate", "float64", "float32", "forbidden")
    for row in found["predicates"]:
        single = "-" if row["error_single"] is None else f"{row['error_single']:.1e}"
        rows.add_row(row["name"], f"{row['error']:.1e}", single, str(row["forbidden"]), verdict(row))
    console.print(rows)
    rows = table("Extreme cases", "group", "case", "outcome", "s")
    for row in found["cases"]:
        text = row["outcome"] + (f" [red]{row['wrong']}[/]" if row["wrong"] else "")
        rows.add_row(row["group"], row["name"], text, f"{row['seconds']:.1f}", verdict(row))
    console.print(rows)
    rows = table("Relations", "relation", "compared", "differs")
    for row in found["relations"]:
        rows.add_row(row["name"], row["compared"], ", ".join(row["differs"]) or "nothing", verdict(row))
    console.print(rows)
    console.print("Everything holds." if found["holds"] else "Not everything holds.")
