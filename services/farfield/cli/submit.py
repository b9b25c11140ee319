"""`farfield submit SCENE --url URL`: send a level to a service, start a job, and follow it to its verdict.

The scene is sent only where its digest is unknown, from where an earlier call was stopped, and the job created under one
idempotency key: a request that is sent again after a lost answer starts no second job.
"""

import argparse
import json
import secrets
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeElapsedColumn, TransferSpeedColumn

from farfield.cli.connect import DONE, NOT_VALID, add_service, call
from farfield.cli.place import load_settings
from farfield.cli.progress import follow
from farfield.client import Client, Refused, file_digest
from farfield.errors import SceneNotAFile
from farfield.settings import to_mapping


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("submit", help="send a level to a service and follow the job")
    parser.add_argument("scene", type=Path, metavar="SCENE", help="glTF, GLB, OBJ, PLY, STL, or a zip of one of these")
    add_service(parser)
    parser.add_argument("--settings", type=Path, metavar="FILE.toml", help="settings (docs/settings.md)")
    parser.add_argument("--budget", help='"16 ms", "300 calls" or "200000 triangles"; wins over the file')
    parser.add_argument(
        "--device", metavar="NAME|FILE.toml", help="a preset, a device of the service, or a profile's file"
    )
    parser.add_argument("--name", help="what to call the job (default: the file's name)")
    parser.add_argument(
        "--priority", choices=("high", "normal", "low"), default="normal", help="before or after other jobs of yours"
    )
    parser.add_argument("--idempotency-key", metavar="K", help="submitted again with the same key it is the same job")
    parser.add_argument("--watch", action="store_true", help="follow the job; exit 0 if its placement is valid, else 4")
    parser.add_argument("--json", action="store_true", help="print the job as JSON and nothing else")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Submit the level; with --watch, exit 0 when the placement is valid, 4 when it is done but not valid."""
    settings = to_mapping(load_settings(args.settings, args.budget, args.device))
    if not args.scene.is_file():
        raise SceneNotAFile(f"{args.scene} is not a file")
    console = Console(stderr=True, quiet=args.json)

    def submit(service: Client) -> int:
        scene = _send_scene(service, args.scene, console)
        key = args.idempotency_key or secrets.token_hex(16)
        job = service.create_job(
            scene, settings, idempotency_key=key, name=args.name or args.scene.name, priority=args.priority
        )
        console.print(f"job {job['id']}", highlight=False)
        if args.watch:
            follow(service.events(job["id"]), console)
            job = service.job(job["id"])
            if job["state"] == "done":
                job["viewer"] = service.login_url(f"/viewer/{job['id']}")
        return _conclude(job, args, console)

    return call(args, submit)


def _conclude(job: dict[str, Any], args: argparse.Namespace, console: Console) -> int:
    if args.json:
        json.dump(job, sys.stdout)
        print()
    if not args.watch:
        console.print(f"page: {args.url.rstrip('/')}/jobs/{job['id']}", highlight=False, soft_wrap=True)
        return DONE
    if job["state"] == "done":
        console.print(f"verdict {job['verdict']}", highlight=False)
        console.print(f"viewer: {job['viewer']}", highlight=False, soft_wrap=True)
        return DONE if job["verdict"] == "valid" else NOT_VALID
    if job["state"] == "failed":
        raise Refused(job["error"] or {})
    console.print(f"the job was {job['state']}", highlight=False)
    return NOT_VALID


def _send_scene(service: Client, path: Path, console: Console) -> str:
    digest = file_digest(path)
    if service.knows_scene(digest):
        console.print("the service knows this scene", highlight=False)
        return digest
    columns = (
        TextColumn("{task.description:12}"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeElapsedColumn(),
    )
    total = path.stat().st_size
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        bar = bars.add_task("upload", total=total)

        def sent(n_bytes: int) -> None:
            bars.advance(bar, n_bytes)
            bars.update(bar, description="reading" if bars.tasks[0].completed >= total else "upload")

        found = service.send_scene(path, digest=digest, sent=sent)
    for warning in found.get("warnings") or ():
        console.print(f"warning: {warning}", highlight=False, markup=False)
    return str(found["digest"])
