"""`farfield fetch JOB --out DIR --url URL`: the placement of a job as files, as `farfield place` would have written them."""

import argparse
import json
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from farfield.cli.connect import DONE, add_service, call
from farfield.client import Client


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("fetch", help="fetch the placement of a job")
    parser.add_argument("job", metavar="JOB")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="writes DIR/placement, DIR/scene.glb, DIR/report.json"
    )
    add_service(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON document and nothing else")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Fetch what is not there yet; exit 0."""
    console = Console(stderr=True, quiet=args.json)

    def fetch(service: Client) -> int:
        columns = (TextColumn("{task.description:12}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
            bar = bars.add_task("files", total=None)
            fetched = service.fetch(
                args.job, args.out, sent=lambda n: bars.advance(bar, n), found=lambda n: bars.update(bar, total=n)
            )
        if args.json:
            print(json.dumps({"job": args.job, "folder": str(args.out), "fetched": fetched}))
        console.print(f"{fetched} files fetched to {args.out}", highlight=False, markup=False, soft_wrap=True)
        return DONE

    return call(args, fetch)
