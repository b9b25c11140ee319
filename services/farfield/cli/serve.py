"""`farfield serve`: the whole service on this machine. The work is the launcher's, in `farfield_workers.serve`.

The launcher is a program of its own, because this package may not import the shells above it.
"""

import argparse
import importlib.util
import json
import os
import re
import sys
from pathlib import Path

from farfield.errors import ServiceError, SettingsInvalid


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("serve", help="serve API, pages and workers on this machine")
    parser.add_argument("--host", default="127.0.0.1", metavar="H", help="address to listen on (default: %(default)s)")
    parser.add_argument("--port", type=int, default=8000, metavar="P", help="port; 0: any (default: %(default)s)")
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="worker processes (default: one a core)"
    )
    parser.add_argument("--data", type=Path, default=Path("data"), metavar="DIR", help="state (default: %(default)s)")
    parser.add_argument(
        "--placement", type=Path, action="append", default=[], metavar="DIR",
        help="also show a folder written by `farfield place`, at /viewer/NAME; may be repeated",
    )  # fmt: skip
    parser.add_argument("--allow-remote", action="store_true", help="allow a --host beyond loopback")
    parser.add_argument("--json", action="store_true", help="when it is up, print its addresses as JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Become the launcher."""
    if args.workers < 0:
        raise SettingsInvalid("--workers", "must not be negative")
    if not 0 <= args.port < 65536:
        raise SettingsInvalid("--port", "must be in 0..65535")
    for package in ("farfield_workers", "farfield_api"):
        if importlib.util.find_spec(package) is None:
            raise ServiceError(f"{package} is not installed: install farfield-workers and farfield-api")
    options = {
        "host": args.host, "port": args.port, "workers": args.workers, "data": str(args.data.absolute()),
        "placements": named_placements(args.placement), "allow_remote": args.allow_remote, "json": args.json,
    }  # fmt: skip
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", "farfield_workers.serve", json.dumps(options)])


def named_placements(folders: list[Path]) -> dict[str, str]:
    """Return {name in the address: absolute folder}; equal names get a number. Raises SettingsInvalid."""
    found: dict[str, str] = {}
    for folder in folders:
        if not (folder / "placement" / "manifest.json").is_file():
            raise SettingsInvalid("--placement", f"{folder} holds no placement/manifest.json")
        stem = re.sub(r"[^A-Za-z0-9._-]+", "-", folder.resolve().name).strip("-.") or "placement"
        name, number = stem, 2
        while name in found:
            name, number = f"{stem}-{number}", number + 1
        found[name] = str(folder.resolve())
    return found
