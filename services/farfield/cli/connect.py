"""What the verbs that speak to a service share: its address, the key, and the exit code of a refusal."""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path

import httpx

from farfield import errors
from farfield.client import Client, Refused
from farfield.errors import SceneError, SettingsInvalid

DONE, FAILED, BAD_USE, BAD_INPUT, NOT_VALID = 0, 1, 2, 3, 4
_MISUSE = ("SettingsInvalid", "RequestInvalid", "KeyMissing", "KeyUnknown", "ScopeMissing")
_STAGE_FAILED = ("StageFailed", "WorkerDied", "OutOfMemory", "Unexpected", "ServiceError")


def add_service(parser: argparse.ArgumentParser) -> None:
    """Add the options that say which service, and who asks."""
    here = os.environ.get("FARFIELD_URL")
    parser.add_argument(
        "--url", required=here is None, default=here, metavar="URL",
        help="the service, such as http://127.0.0.1:8000 (default: $FARFIELD_URL)",
    )  # fmt: skip
    parser.add_argument(
        "--key-file", type=Path, metavar="F",
        help="file with the API key (default: $FARFIELD_KEY; here also data/api-key)",
    )  # fmt: skip


def call(args: argparse.Namespace, act: Callable[[Client], int]) -> int:
    """Run `act` with a client; a refusal is printed as name, message and advice, and becomes an exit code."""
    here = httpx.URL(args.url).host in ("127.0.0.1", "localhost", "::1")  # which no proxy can reach
    with Client(args.url, api_key(args.key_file, here=here), trust_proxy=not here) as service:
        try:
            return act(service)
        except Refused as refused:
            print(f"{refused.code}: {refused}", file=sys.stderr)
            if refused.advice:
                print(refused.advice, file=sys.stderr)
            return exit_code(refused.code)


def exit_code(code: str) -> int:
    """Return the exit code of a refusal with this name."""
    if code in _MISUSE:
        return BAD_USE
    named = getattr(errors, code, None)
    is_scene = isinstance(named, type) and issubclass(named, SceneError)
    return FAILED if code in _STAGE_FAILED and not is_scene else BAD_INPUT


def api_key(path: Path | None, *, here: bool) -> str:
    """Return the API key. That of the service on this machine is found by itself, and sent to no other machine."""
    given = os.environ.get("FARFIELD_KEY", "")
    if path is None and not given and here and Path("data/api-key").is_file():
        path = Path("data/api-key")
    if path is not None:
        try:
            given = path.read_text(encoding="ascii")
        except (OSError, UnicodeDecodeError) as error:
            raise SettingsInvalid("--key-file", f"{path} cannot be read: {error}") from error
    if not given.strip():
        raise SettingsInvalid("--key-file", "give a file with the API key, or set FARFIELD_KEY")
    return given.strip()
