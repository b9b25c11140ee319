"""The launcher behind `farfield serve`: database, key, broker, API, workers and reconciler on one machine, one command.

State lives in DATA: farfield.sqlite, artifacts/, api-key, secret, webhook-key, log/. Only the URLs differ from a fleet, where an
orchestrator starts each of these processes. The launcher owns the listening socket, so that an API that dies and
comes back refuses nobody. Workers are started with `-P solo`: a baker's OpenGL context must not exist in a parent.
"""

import argparse
import fcntl
import ipaddress
import json
import os
import secrets
import shutil
import signal
import socket
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa
from farfield.errors import FarfieldError, ServiceError
from farfield.executor import THREADS
from farfield.store import progress, tenants, workers
from farfield.store.artifacts import LocalArtifacts
from farfield.store.backup import write_private
from farfield.store.engine import open_engine
from farfield.store.migrate import migrate as upgrade

from farfield_workers.__main__ import QUEUES, new_name, worker_command
from farfield_workers.broker import broker_command, wait_for_broker
from farfield_workers.children import Child, stop_children

ROOT = Path(__file__).resolve().parents[2]
STOP_S = 8.0


@dataclass(frozen=True, slots=True)
class Options:
    """The words after `farfield serve`."""

    host: str
    port: int
    workers: int
    data: Path
    placements: Mapping[str, Path]
    allow_remote: bool
    json: bool


def migrate(engine: sa.Engine, migrations: Path | None = None) -> None:
    """Bring the database to the newest version of the tables."""
    upgrade(engine, migrations or Path(os.environ.get("FARFIELD_MIGRATIONS", ROOT / "migrations")))


def first_key(engine: sa.Engine, path: Path) -> tuple[str, bool]:
    """Return (the key in `path`, whether it was made now). The file is only for its owner (0600)."""
    if path.exists():
        key = path.read_text().strip()
        if tenants.caller_of_key(engine, key) is not None:
            return key, False
    tenant_id = tenants.create_tenant(engine, "default", operator=True)
    key = tenants.create_key(engine, tenant_id, "made on first start", ("read", "submit", "admin"))
    write_private(path, f"{key}\n".encode())
    return key, True


def serve(options: Options) -> int:
    """Run the service until SIGTERM or SIGINT. Raises ServiceError."""
    if not _loopback(options.host) and not options.allow_remote:
        raise ServiceError(
            f"{options.host} is not a loopback address: add --allow-remote, and put TLS in front, to listen there"
        )
    options.data.mkdir(mode=0o700, parents=True, exist_ok=True)  # levels are not for other users of the machine
    log = options.data / "log"
    log.mkdir(parents=True, exist_ok=True)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    children: list[Child] = []
    with (options.data / "lock").open("w") as lock, _listen(options.host, options.port) as listening:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ServiceError(f"another farfield serves {options.data} already") from None
        runtime = _runtime(options.data)
        try:
            database = f"sqlite:///{(options.data / 'farfield.sqlite').resolve()}"
            engine = open_engine(database)
            migrate(engine)
            key, made = first_key(engine, options.data / "api-key")
            workers.end(engine, None)
            progress.release_worker(engine, None)  # we hold the lock: whoever held a lease is dead
            LocalArtifacts(options.data / "artifacts").clear_temporary()
            command, broker = broker_command(runtime)
            environment = {
                **{k: os.environ.get(k, v) for k, v in THREADS.items()},
                "FARFIELD_DATABASE_URL": database,
                "FARFIELD_BROKER_URL": f"redis+socket://{broker}",
                "FARFIELD_ARTIFACTS": str((options.data / "artifacts").resolve()),
                "FARFIELD_SECRET": _secret(options.data / "secret"),
                "FARFIELD_WEBHOOK_KEY": _secret(options.data / "webhook-key"),
                "FARFIELD_WEB": os.environ.get("FARFIELD_WEB", str(ROOT / "webviewer" / "dist")),
                "FARFIELD_PLACEMENTS": json.dumps({n: str(p.resolve()) for n, p in options.placements.items()}),
                "FARFIELD_HOSTS": "*" if options.allow_remote else ",".join(_names(options.host)),
                "FARFIELD_FD": str(listening.fileno()),
                "PYTHONUNBUFFERED": "1",
            }
            children.append(
                Child(
                    name="broker",
                    command=command,
                    environment=dict,
                    log=log / "broker.log",
                )
            )
            children[0].start()
            wait_for_broker(broker)
            children += _python_children(options, engine, environment, log, listening.fileno())
            for child in children[1:]:
                child.start()
            url = _url(options.host, listening.getsockname()[1])
            if _wait_until_ready(url, children, stop):
                _announce(options, engine, url, key, made)
                while not stop.wait(0.2):
                    for child in children:
                        child.look()
        finally:
            # The broker goes last: workers that end their shard still talk to it.
            stop_children(children[1:], seconds=STOP_S)
            if children:
                _hand_back(engine)
            stop_children(children[:1], seconds=2.0)
            shutil.rmtree(runtime, ignore_errors=True)  # the next start clears what a kill leaves here
    return 0


def _python_children(
    options: Options, engine: sa.Engine, environment: Mapping[str, str], log: Path, listening: int
) -> list[Child]:
    python = sys.executable
    api = Child(name="api", command=[python, "-m", "farfield_api"], environment=lambda: environment,
                log=log / "api.log", keep_open=(listening,))  # fmt: skip
    reconciler = Child(name="reconciler", command=[python, "-m", "farfield_workers.reconciler"],
                       environment=lambda: environment, log=log / "reconciler.log")  # fmt: skip
    found = [api, reconciler]
    for slot in range(1, options.workers + 1):

        def named(slot: int = slot) -> Mapping[str, str]:
            return {**environment, "FARFIELD_WORKER": new_name(str(slot))}

        found.append(
            Child(
                name=f"worker {slot}",
                command=worker_command(QUEUES, name=f"slot{slot}"),
                environment=named,
                log=log / f"worker-{slot}.log",
                died=lambda given: _release(engine, given["FARFIELD_WORKER"]),
            )
        )
    return found


def _release(engine: sa.Engine, worker: str) -> None:
    try:
        progress.release_worker(engine, worker)
        workers.end(engine, worker)
    except sa.exc.OperationalError as error:  # its leases then lapse by themselves
        print(f"farfield: the leases of {worker} could not be released: {error}", file=sys.stderr)


def _hand_back(engine: sa.Engine) -> None:
    try:
        progress.hand_back(engine)
        workers.end(engine, None)
    except sa.exc.OperationalError as error:  # the next start then counts them as attempts that died
        print(f"farfield: what ran could not be handed back: {error}", file=sys.stderr)


def _announce(options: Options, engine: sa.Engine, url: str, key: str, made: bool) -> None:
    caller = tenants.caller_of_key(engine, key)
    assert caller is not None

    def link(target: str) -> str:
        return f"{url}/open#login={tenants.create_login(engine, caller.key_id)}&to={target}"

    viewers = {name: link(f"/viewer/{name}") for name in options.placements}
    if options.json:
        told = {"url": url, "key_file": str(options.data / "api-key"), "jobs": link("/jobs"), "viewers": viewers}
        print(json.dumps(told), flush=True)
        return
    print(f"farfield: {url}", flush=True)
    if made:
        print(f"key: {key}\n     (shown once; also in {options.data / 'api-key'}, readable by you alone)", flush=True)
    print(f"jobs: {link('/jobs')}", flush=True)
    for viewer in viewers.values():
        print(f"viewer: {viewer}", flush=True)
    print("stop with Ctrl-C", flush=True)


def _wait_until_ready(url: str, children: list[Child], stop: threading.Event, *, seconds: float = 60.0) -> bool:
    """Return True once the API answers, False when asked to stop. Raises ServiceError."""
    end = time.monotonic() + seconds
    direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))  # a proxy cannot reach our loopback
    while time.monotonic() < end and not stop.wait(0.1):
        dead = [c for c in children if c.process is not None and c.process.poll() is not None]
        if dead:
            raise ServiceError(f"{dead[0].name} ended at its start; see {dead[0].log}")
        try:
            with direct.open(f"{url}/readyz", timeout=5.0):
                return True
        except (urllib.error.URLError, OSError):
            continue
    if stop.is_set():
        return False
    raise ServiceError(f"the API did not answer within {seconds:.0f} s; see {children[1].log}")


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((host, port))
    except OSError as error:
        listening.close()
        raise ServiceError(f"cannot listen on {host}:{port}: {error.strerror}; choose another --port") from None
    listening.listen(512)
    return listening


def _url(host: str, port: int) -> str:
    shown = "127.0.0.1" if host == "0.0.0.0" else "[::1]" if host == "::" else f"[{host}]" if ":" in host else host
    return f"http://{shown}:{port}"


def _names(host: str) -> tuple[str, ...]:
    """Return the Host headers that a service on loopback answers to."""
    return ("127.0.0.1", "localhost", "[::1]", "::1", f"[{host}]" if ":" in host else host)


def _loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _runtime(data: Path) -> Path:
    """Return a new folder for the broker's socket, whose path may be at most 107 bytes long."""
    folder = data / "run"
    if len(os.fsencode(folder)) > 90:
        return Path(tempfile.mkdtemp(prefix="farfield-"))
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(mode=0o700)
    return folder


def _secret(path: Path) -> str:
    """Return the secret in this file, made on the first start: what signs sessions, what seals the secrets of webhooks."""
    if not path.exists():
        write_private(path, secrets.token_hex(32).encode())
    return path.read_text().strip()


def main() -> int:
    parser = argparse.ArgumentParser(prog="farfield serve")
    parser.add_argument("options")
    given = json.loads(parser.parse_args().options)
    given["data"] = Path(given["data"])
    given["placements"] = {name: Path(path) for name, path in given["placements"].items()}
    try:
        return serve(Options(**given))
    except FarfieldError as error:
        print(f"{error.code}: {error}", file=sys.stderr)
        return 3


if __name__ == "__main__":
    sys.exit(main())
