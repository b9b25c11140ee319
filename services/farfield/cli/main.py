"""The command line: `farfield VERB ...`. Exit codes: 0 done, 2 bad use, 3 bad input, 4 done but not valid.

Each verb is a module of this folder with `add_parser(subparsers)`, which sets `run`, and `run(args) -> exit code`.
They import lazily: `farfield submit` needs neither numba nor OpenGL.
"""

import argparse
import importlib
import os
import sys
from collections.abc import Sequence

from farfield.errors import FarfieldError, SettingsInvalid, StageFailed

VERBS = (
    "place",
    "inspect",
    "layers",
    "calibrate",
    "verify",
    "stability",
    "experiment",
    "report",
    "export",
    "serve",
    "submit",
    "jobs",
    "logs",
    "fetch",
    "cancel",
    "retry",
    "keys",
    "fsck",
    "gc",
    "backup",
    "restore",
    "migrate",
)
DONE, FAILED, BAD_USE, BAD_INPUT, NOT_VALID = 0, 1, 2, 3, 4


def _parser(verbs: Sequence[str]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="farfield", description=__doc__.splitlines()[0] if __doc__ else None)
    subparsers = parser.add_subparsers(dest="verb", required=True, metavar="VERB")
    for verb in verbs:
        importlib.import_module(f"farfield.cli.{verb}").add_parser(subparsers)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb and return its exit code. A FarfieldError is printed as name, message and advice: no traceback."""
    argv = sys.argv[1:] if argv is None else list(argv)
    only = [argv[0]] if argv and argv[0] in VERBS else VERBS
    try:
        args = _parser(only).parse_args(argv)
        return int(args.run(args))
    except FarfieldError as error:
        print(f"{error.code}: {error}", file=sys.stderr)
        if error.advice:
            print(error.advice, file=sys.stderr)
        return (
            FAILED if isinstance(error, StageFailed) else BAD_USE if isinstance(error, SettingsInvalid) else BAD_INPUT
        )
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of our output has gone: nothing left to say
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except OSError as error:  # a full disk, a folder that went away
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return FAILED


if __name__ == "__main__":
    sys.exit(main())
