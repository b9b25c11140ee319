"""`farfield gc`: remove the artifacts that nothing refers to. Safe while the service works."""

import argparse
import json
from dataclasses import asdict

from farfield.cli.stored import add_stored, opened, size


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("gc", help="remove artifacts that nothing refers to (the service does it, too)")
    add_stored(parser)
    parser.add_argument("--dry-run", action="store_true", help="say what would be removed, and remove nothing")
    parser.add_argument(
        "--grace-s", type=float, default=3600.0, metavar="S",
        help="remove only what was found unused so long ago (default: %(default).0f)",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Collect once."""
    from farfield.store import collect

    with opened(args) as (engine, artifacts):
        if args.dry_run:
            found = collect.would_collect(engine, artifacts)
        else:
            found = collect.collect(engine, artifacts, grace_s=max(0.0, args.grace_s))
    if args.json:
        print(json.dumps({**asdict(found), "dry_run": args.dry_run}))
        return 0
    verb = "would be removed" if args.dry_run else "removed"
    print(f"{found.removed} artifacts {verb}, {size(found.removed_bytes)}")
    if not args.dry_run and found.marked + found.adopted:
        print(f"{found.marked + found.adopted} more are unused: removed when that is still so in {args.grace_s:.0f} s")
    return 0
