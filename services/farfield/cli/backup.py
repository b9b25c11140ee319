"""`farfield backup DIR`: copy the state of `farfield serve`, also while it works."""

import argparse
import json
import sys
from pathlib import Path

from farfield.cli.stored import size


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("backup", help="copy the state of `farfield serve`, also while it works")
    parser.add_argument("target", type=Path, metavar="DIR", help="folder for the copy; one there is brought up to date")
    parser.add_argument("--data", type=Path, default=Path("data"), metavar="DIR", help="state (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Back up."""
    from farfield.store.backup import backup

    told = backup(args.data, args.target, say=lambda text: print(text, file=sys.stderr))
    print(json.dumps(told) if args.json else f"{told['artifacts']} artifacts, {size(told['bytes'])}, in {args.target}")
    return 0
