"""What a worker, the reconciler and the launcher read from the environment."""

import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from farfield.memory import HEADROOM, memory_bytes
from farfield.store.artifacts import CACHE_BYTES
from farfield.webhooks import Network, networks

THE_PIPELINE = "farfield_workers.table:PIPELINE"


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerSettings:
    """Addresses and limits of one worker process."""

    database_url: str
    broker_url: str
    artifacts: str | Path  # a folder, or s3://bucket/prefix
    worker: str  # our name in the table `shard`
    pipeline: str  # module:attribute
    lease_s: float
    renew_s: float  # how often a lease is renewed, and how soon a cancel is noticed
    scene_memory_bytes: int  # address space of the process that parses a scene
    scene_seconds: int
    host: str = ""  # whose memory we share with other workers of this name
    memory_bytes: int | None = None  # what all shards on the host together may need; None: not looked at
    cache: Path | None = None  # where copies of remote artifacts lie; None: ~/.cache/farfield
    cache_bytes: int = CACHE_BYTES
    webhook_networks: tuple[Network, ...] = ()  # networks that webhooks may reach although they are not public
    webhook_key: str | None = None  # with which the API has sealed their secrets


def from_environment(environment: Mapping[str, str] = os.environ) -> WorkerSettings:
    """Return the settings that the variables FARFIELD_* give."""
    return WorkerSettings(
        database_url=environment["FARFIELD_DATABASE_URL"],
        broker_url=environment["FARFIELD_BROKER_URL"],
        artifacts=environment["FARFIELD_ARTIFACTS"],
        worker=environment.get("FARFIELD_WORKER", f"{socket.gethostname()}:{os.getpid()}"),
        pipeline=environment.get("FARFIELD_PIPELINE", THE_PIPELINE),
        lease_s=float(environment.get("FARFIELD_LEASE_S", 60)),
        renew_s=float(environment.get("FARFIELD_RENEW_S", 5)),
        scene_memory_bytes=int(environment.get("FARFIELD_SCENE_MEMORY_BYTES", 8 << 30)),
        scene_seconds=int(environment.get("FARFIELD_SCENE_SECONDS", 900)),
        host=environment.get("FARFIELD_MEMORY_HOST", socket.gethostname()),
        memory_bytes=_memory(environment.get("FARFIELD_MEMORY_BYTES", "auto")),
        cache=Path(environment["FARFIELD_CACHE"]) if environment.get("FARFIELD_CACHE") else None,
        cache_bytes=int(environment.get("FARFIELD_CACHE_BYTES", CACHE_BYTES)),
        webhook_networks=networks(environment.get("FARFIELD_WEBHOOK_NETWORKS", "")),
        webhook_key=environment.get("FARFIELD_WEBHOOK_KEY") or None,
    )


def _memory(text: str) -> int | None:
    """Return what "auto" (most of the machine's, or of the container's), "off" or a number of bytes stands for."""
    return int(HEADROOM * memory_bytes()) if text == "auto" else None if text == "off" else int(text)
