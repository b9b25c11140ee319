"""What the API reads from the environment."""

import json
import os
import secrets
import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from farfield.store.artifacts import CACHE_BYTES
from farfield.store.quotas import Quota
from farfield.webhooks import Network, networks

MIGRATIONS = Path(os.environ.get("FARFIELD_MIGRATIONS", Path(__file__).resolve().parents[2] / "migrations"))
NO_QUOTA = Quota()
INSPECT = (sys.executable, "-m", "farfield.cli.main", "inspect", "--json")
EXPORT = (sys.executable, "-m", "farfield.cli.main", "export", "gltf", "--json")
CALIBRATE = (sys.executable, "-m", "farfield.cli.main", "calibrate", "--json")


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiSettings:
    """Addresses and limits of one API process."""

    database_url: str
    broker_url: str
    artifacts: str | Path  # a folder, or s3://bucket/prefix
    secret: str  # signs sessions; the same for all API processes of a service
    web: Path  # the built pages
    placements: Mapping[str, Path] = field(default_factory=dict)  # name -> a folder written by `farfield place`
    hosts: tuple[str, ...] = ("*",)  # names under which we answer; guards a loopback service against DNS rebinding
    max_scene_bytes: int = 4 << 30
    uploads: Path | None = None  # where files wait for their other bytes, shared by all API hosts; None: beside `tmp`
    upload_s: float = 3 * 86400.0  # how long one waits for its next bytes
    open_uploads: int = 64  # of a tenant
    stall_s: float = 60.0  # a body that brings hardly a byte for so long is ended
    inspect_memory_bytes: int = 8 << 30
    inspect_seconds: int = 300
    inspect_command: tuple[str, ...] = INSPECT  # prints what it reads of the file named last, as JSON
    export_command: tuple[str, ...] = EXPORT  # writes the placement named last as glTF to --out
    calibrate_command: tuple[str, ...] = CALIBRATE  # prints the profile of the samples in the file named last, as JSON
    session_s: int = 12 * 3600
    rate_read: str = "12000/minute"  # requests of a key that read; empty: no limit
    rate_write: str = "1200/minute"  # ... that change something
    rate_store: str = "memory://"  # where they are counted; a Redis URL where there are several API processes
    quota: Quota = NO_QUOTA  # of tenants that have none of their own
    webhook_networks: tuple[Network, ...] = ()  # networks that webhooks may reach although they are not public
    webhook_key: str | None = None  # seals their secrets in the database; the reconciler's, too
    poll_s: float = 0.25  # how often the streams look for new events
    migrations: Path = MIGRATIONS  # the versions of the tables that this code knows
    metrics_port: int | None = None  # also answer /metrics there without a key; None: only with one
    metrics_host: str = "127.0.0.1"
    cache: Path | None = None  # where copies of remote artifacts lie; None: ~/.cache/farfield
    cache_bytes: int = CACHE_BYTES


def from_environment(environment: Mapping[str, str] = os.environ) -> ApiSettings:
    """Return the settings that the variables FARFIELD_* give."""
    web = environment.get("FARFIELD_WEB", str(Path(__file__).resolve().parents[2] / "webviewer" / "dist"))
    named = json.loads(environment.get("FARFIELD_PLACEMENTS", "{}"))
    quota = {name: int(environment.get(f"FARFIELD_{name.upper()}", 0)) or None
             for name in ("max_bytes", "max_jobs", "max_running")}  # fmt: skip
    return ApiSettings(
        database_url=environment["FARFIELD_DATABASE_URL"],
        broker_url=environment["FARFIELD_BROKER_URL"],
        artifacts=environment["FARFIELD_ARTIFACTS"],
        secret=environment.get("FARFIELD_SECRET") or secrets.token_hex(32),
        web=Path(web),
        placements={name: Path(folder) for name, folder in named.items()},
        hosts=tuple(environment.get("FARFIELD_HOSTS", "*").split(",")),
        max_scene_bytes=int(environment.get("FARFIELD_MAX_SCENE_BYTES", 4 << 30)),
        uploads=Path(environment["FARFIELD_UPLOADS"]) if "FARFIELD_UPLOADS" in environment else None,
        upload_s=float(environment.get("FARFIELD_UPLOAD_SECONDS", 3 * 86400)),
        inspect_memory_bytes=int(environment.get("FARFIELD_SCENE_MEMORY_BYTES", 8 << 30)),
        inspect_command=tuple(shlex.split(environment.get("FARFIELD_INSPECT", ""))) or INSPECT,
        export_command=tuple(shlex.split(environment.get("FARFIELD_EXPORT", ""))) or EXPORT,
        calibrate_command=tuple(shlex.split(environment.get("FARFIELD_CALIBRATE", ""))) or CALIBRATE,
        inspect_seconds=int(environment.get("FARFIELD_INSPECT_SECONDS", 300)),
        metrics_port=int(environment["FARFIELD_METRICS_PORT"]) if environment.get("FARFIELD_METRICS_PORT") else None,
        metrics_host=environment.get("FARFIELD_METRICS_HOST", "127.0.0.1"),
        cache=Path(environment["FARFIELD_CACHE"]) if environment.get("FARFIELD_CACHE") else None,
        rate_read=environment.get("FARFIELD_RATE_READ", "12000/minute"),
        rate_write=environment.get("FARFIELD_RATE_WRITE", "1200/minute"),
        rate_store=environment.get("FARFIELD_RATE_STORE", "memory://"),
        quota=Quota(**quota),
        webhook_networks=networks(environment.get("FARFIELD_WEBHOOK_NETWORKS", "")),
        webhook_key=environment.get("FARFIELD_WEBHOOK_KEY") or None,
        cache_bytes=int(environment.get("FARFIELD_CACHE_BYTES", CACHE_BYTES)),
    )
