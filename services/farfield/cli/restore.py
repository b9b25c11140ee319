"""`farfield restore DIR`: bring a backup back into an empty data folder."""

import argparse
import json
import sys
from pathlib import Path


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("restore", help="bring a backup back into an empty data folder")
    parser.add_argument("source", type=Path, metavar="DIR", help="folder written by `farfield backup`")
    parser.add_argument(
        "--data", type=Path, default=Path("data"), metavar="DIR", help="empty folder (default: %(default)s)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Restore."""
    from farfield.store.backup import restore

    told = restore(args.source, args.data, say=lambda text: print(text, file=sys.stderr))
    shown = f"{told['artifacts']} artifacts restored; start with `farfield serve --data {args.data}`"
    print(json.dumps(told) if args.json else shown)
    return 0
