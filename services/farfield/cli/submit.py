"""`farfield submit SCENE --url URL`: send a level to a service, start a job, and follow it to its verdict.

The scene's digest is asked for first and the file sent only where it is unknown. The job is created under one
idempotency key, so that a request that is sent again after a lost answer starts no second job. Events are followed with
Last-Event-ID: a service that restarts in between loses none.
"""

import argparse
import hashlib
import json
import os
import secrets
import sys
import time
import urllib.parse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeElapsedColumn

from farfield import errors
from farfield.cli.place import load_settings
from farfield.cli.progress import stage_bars
from farfield.errors import FarfieldError, SceneError, SceneNotAFile, ServiceError, SettingsInvalid
from farfield.settings import to_mapping
from farfield.stages import Stage

CHUNK_BYTES = 1 << 20
TRIES = 5
DONE, FAILED, BAD_USE, BAD_INPUT, NOT_VALID = 0, 1, 2, 3, 4


class Refused(FarfieldError):
    """The service refused a request, or the job failed, with this code."""

    def __init__(self, problem: dict[str, Any]) -> None:
        super().__init__(str(problem.get("detail") or problem.get("message") or "no reason was given"))
        self._code, self.advice = str(problem.get("code", "Refused")), str(problem.get("advice", ""))

    @property
    def code(self) -> str:
        return self._code


def add_parser(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the verb."""
    parser = subparsers.add_parser("submit", help="send a level to a service and follow the job")
    parser.add_argument("scene", type=Path, metavar="SCENE", help="glTF, GLB, OBJ, PLY, STL, or a zip of one of these")
    parser.add_argument("--url", required=True, metavar="URL", help="the service, such as http://127.0.0.1:8000")
    parser.add_argument(
        "--key-file",
        type=Path,
        metavar="F",
        help="file with the API key (default: $FARFIELD_KEY; here also data/api-key)",
    )
    parser.add_argument("--settings", type=Path, metavar="FILE.toml", help="settings (docs/settings.md)")
    parser.add_argument("--budget", help='"16 ms", "300 calls" or "200000 triangles"; wins over the file')
    parser.add_argument("--name", help="what to call the job (default: the file's name)")
    parser.add_argument("--idempotency-key", metavar="K", help="submitted again with the same key it is the same job")
    parser.add_argument("--watch", action="store_true", help="follow the job; exit 0 if its placement is valid, else 4")
    parser.add_argument("--json", action="store_true", help="print the job as JSON and nothing else")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Submit the level; with --watch, exit 0 when the placement is valid, 4 when it is done but not valid."""
    settings = to_mapping(load_settings(args.settings, args.budget))
    if not args.scene.is_file():
        raise SceneNotAFile(f"{args.scene} is not a file")
    here = httpx.URL(args.url).host in ("127.0.0.1", "localhost", "::1")  # which no proxy can reach
    key = _key(args.key_file, here=here)
    console = Console(stderr=True, quiet=args.json)
    headers = {"authorization": f"Bearer {key}"}
    timeout = httpx.Timeout(30.0, read=900.0)
    with httpx.Client(base_url=args.url.rstrip("/"), headers=headers, timeout=timeout, trust_env=not here) as client:
        try:
            digest = _send_scene(client, args.scene, console)
            wanted = {"scene": digest, "settings": settings, "name": args.name or args.scene.name}
            once = {"idempotency-key": args.idempotency_key or secrets.token_hex(16)}
            job = _ask(client, "POST", "/v1/jobs", json=wanted, headers=once).json()
            console.print(f"job {job['id']}", highlight=False)
            if args.watch:
                _watch(client, job["id"], console)
                job = _ask(client, "GET", f"/v1/jobs/{job['id']}").json()
                if job["state"] == "done":
                    link = {"to": f"/viewer/{job['id']}"}
                    job["viewer"] = _ask(client, "POST", "/v1/logins", json=link).json()["url"]
            return _conclude(job, args, console)
        except Refused as refused:
            print(f"{refused.code}: {refused}", file=sys.stderr)
            if refused.advice:
                print(refused.advice, file=sys.stderr)
            return _exit_code(refused.code)
        except httpx.TransportError as error:
            raise ServiceError(f"{args.url} does not answer: {error}") from error


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


def _exit_code(code: str) -> int:
    named = getattr(errors, code, None)
    if code in ("SettingsInvalid", "RequestInvalid", "KeyMissing", "KeyUnknown", "ScopeMissing"):
        return BAD_USE
    stage_failed = code in ("StageFailed", "WorkerDied", "OutOfMemory", "Unexpected")
    is_scene = isinstance(named, type) and issubclass(named, SceneError)
    return FAILED if stage_failed and not is_scene else BAD_INPUT


def _key(path: Path | None, *, here: bool) -> str:
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


def _ask(client: httpx.Client, method: str, path: str, **more: Any) -> httpx.Response:
    """Return the answer; ask again where the connection fails. Raises Refused."""
    for attempt in range(TRIES):
        try:
            answer = client.request(method, path, **more)
        except httpx.TransportError:
            if attempt == TRIES - 1:
                raise
            time.sleep(0.5 * 2**attempt)
            continue
        if answer.status_code not in (502, 503, 504) or attempt == TRIES - 1:
            return _checked(answer)
        time.sleep(0.5 * 2**attempt)
    raise AssertionError("unreachable")


def _checked(answer: httpx.Response) -> httpx.Response:
    if answer.is_success:
        return answer
    try:
        problem = answer.json()
    except ValueError:
        problem = {"code": "ServiceError", "detail": f"the service answered {answer.status_code}"}
    raise Refused(problem if isinstance(problem, dict) else {})


def _send_scene(client: httpx.Client, path: Path, console: Console) -> str:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    known = client.head(f"/v1/scenes/{digest}")
    if known.is_success:
        console.print("the service knows this scene", highlight=False)
        return digest
    if known.status_code != 404:
        _checked(client.get(f"/v1/scenes/{digest}"))  # HEAD has no body that says why
    size = path.stat().st_size
    quoted = urllib.parse.quote(path.name)
    headers = {
        "content-disposition": f"attachment; filename*=UTF-8''{quoted}",
        "content-type": "application/octet-stream",
        "content-length": str(size),
    }
    columns = (TextColumn("{task.description:12}"), BarColumn(), DownloadColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        bar = bars.add_task("upload", total=size)

        def content() -> Iterator[bytes]:
            with path.open("rb") as file:
                while chunk := file.read(CHUNK_BYTES):
                    yield chunk
                    bars.advance(bar, len(chunk))

        found = _checked(client.post("/v1/scenes", content=content(), headers=headers)).json()
    for warning in found.get("warnings") or ():
        console.print(f"warning: {warning}", highlight=False, markup=False)
    return str(found["digest"])


def _watch(client: httpx.Client, job_id: str, console: Console) -> None:
    """Show the job's events until its last one."""
    with stage_bars(console, disable=not console.is_terminal) as bars:
        tasks = {str(s): bars.add_task(s, total=None, start=False, note="") for s in Stage}
        for kind, data in _events(client, job_id):
            task = tasks.get(data.get("stage", ""))
            if kind == "stage" and task is not None:
                if data["state"] == "planning":
                    bars.start_task(task)
                elif data["state"] in ("running", "merging") and "shards" in data:
                    bars.update(task, total=max(data["shards"], 1))
                elif data["state"] in ("done", "skipped", "failed"):
                    if not console.is_terminal:  # bars would only show at the end of a build's log
                        reason = f": {data['skipped']}" if data.get("skipped") else ""
                        console.out(f"{data['stage']} {data['state']}{reason}", highlight=False)
                    bars.update(task, total=1, completed=1)
                    bars.stop_task(task)
                if data.get("skipped"):
                    bars.update(task, note=f"skipped: {data['skipped']}")
            elif kind == "shard" and task is not None and data["kind"] == "run" and data["state"] == "done":
                bars.advance(task)


def _events(client: httpx.Client, job_id: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield (kind, data) of every event once, in order, across lost connections. Raises Refused."""
    last, failures = "0", 0
    while True:
        try:
            headers = {"last-event-id": last, "accept": "text/event-stream"}
            timeout = httpx.Timeout(30.0, read=60.0)  # the service says something every 15 s
            with client.stream("GET", f"/v1/jobs/{job_id}/events", headers=headers, timeout=timeout) as stream:
                if stream.status_code == 204:
                    return
                if not stream.is_success:
                    stream.read()
                    _checked(stream)
                fields: dict[str, str] = {}
                for line in stream.iter_lines():
                    failures = 0
                    if line:
                        name, _, value = line.partition(":")
                        fields[name] = value.removeprefix(" ")
                        continue
                    if "data" in fields:
                        last = fields.get("id", last)
                        yield fields.get("event", "message"), json.loads(fields["data"])
                    fields = {}
        except httpx.TransportError:
            failures += 1
            if failures >= TRIES:
                raise
            time.sleep(0.5 * 2**failures)
