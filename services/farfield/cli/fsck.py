"""`farfield fsck`: check every blob, reference, numbering and state of the service. Exit codes: 0 clean, 4 something is wrong."""

import argparse
import json
import sys
from dataclasses import asdict

from farfield.cli.stored import add_stored, opened, size


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("fsck", help="check the service's database and artifacts; --repair mends")
    add_stored(parser)
    parser.add_argument("--repair", action="store_true", help="put damaged blobs aside, let jobs compute what is lost")
    parser.add_argument("--fast", action="store_true", help="compare sizes only: do not read every blob")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Check, and mend if asked to."""
    from farfield.store import fsck, repair

    looked = [0, 0]

    def seen(n_bytes: int) -> None:
        looked[0], looked[1] = looked[0] + 1, looked[1] + n_bytes
        if sys.stderr.isatty():
            print(f"\r{looked[0]} blobs, {size(looked[1])}", end="", file=sys.stderr, flush=True)

    with opened(args) as (engine, artifacts):
        found = fsck.check(engine, artifacts, hashes=not args.fast, seen=seen)
        if sys.stderr.isatty():
            print("\r\x1b[K", end="", file=sys.stderr)
        wrong = [finding for finding in found if not finding.note]
        mended: list[str] = []
        left = wrong
        if args.repair and found:
            mended, left = repair.repair(engine, artifacts, found)
    if args.json:
        told = {"blobs": looked[0], "bytes": looked[1], "found": [asdict(f) for f in found], "mended": mended,
                "left": [asdict(f) for f in left]}  # fmt: skip
        print(json.dumps(told))
        return 4 if left else 0
    for finding in found:
        print(f"{'note' if finding.note else 'WRONG'} {finding.kind} {finding.of}: {finding.text}")
    for text in mended:
        print(f"mended {text}")
    print(f"{looked[0]} blobs, {size(looked[1])}: {len(wrong) or 'nothing'} wrong" + (
        f", {len(left) or 'nothing'} still is" if args.repair else ""
    ))  # fmt: skip
    if left and not args.repair:
        print("`farfield fsck --repair` mends what can be mended")
    return 4 if left else 0
