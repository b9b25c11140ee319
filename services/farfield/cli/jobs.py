"""`farfield jobs --url URL`: the jobs of a service, newest first."""

import argparse
import itertools
import json

from rich.console import Console
from rich.table import Table

from farfield.cli.connect import DONE, add_service, call
from farfield.client import Client


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("jobs", help="list the jobs of a service")
    add_service(parser)
    parser.add_argument("--state", choices=("queued", "running", "done", "failed", "cancelled"))
    parser.add_argument("--scene", metavar="DIGEST", help="only those of this scene")
    parser.add_argument("--verdict", choices=("valid", "infeasible", "unproven"))
    parser.add_argument("--name", metavar="TEXT", help="only those with this in their name")
    parser.add_argument("--limit", type=int, default=50, metavar="N", help="at most so many (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print one JSON document and nothing else")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """List them; exit 0."""

    def show(service: Client) -> int:
        found = list(
            itertools.islice(
                service.jobs(state=args.state, scene=args.scene, verdict=args.verdict, name=args.name),
                max(args.limit, 0),
            )
        )
        if args.json:
            print(json.dumps({"jobs": found}))
            return DONE
        table = Table(box=None, padding=(0, 2, 0, 0))
        for name in ("job", "state", "verdict", "budget", "progress", "created", "name"):
            table.add_column(name, no_wrap=name != "name")
        for job in found:
            at = f"{job['progress']:.0%}" + (f" {job['stage']}" if job["stage"] else "")
            row = (
                job["id"],
                job["state"],
                job["verdict"] or "",
                job["budget"],
                at,
                job["created_at"][:16],
                job["name"],
            )
            table.add_row(*map(str, row))
        Console(highlight=False, markup=False).print(table)
        return DONE

    return call(args, show)
