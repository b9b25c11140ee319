"""What the API reads from the environment."""

import json
import os
import secrets
import shlex
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

INSPECT = (sys.executable, "-m", "farfield.cli.main", "inspect", "--json")
CALIBRATE = (sys.executable, "-m", "farfield.cli.main", "calibrate", "--json")


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiSettings:
    """Addresses and limits of one API process."""

    database_url: str
    broker_url: str
    artifacts: Path
    secret: str  # signs sessions; the same for all API processes of a service
    web: Path  # the built pages
    placements: Mapping[str, Path] = field(default_factory=dict)  # name -> a folder written by `farfield place`
    hosts: tuple[str, ...] = ("*",)  # names under which we answer; guards a loopback service against DNS rebinding
    max_scene_bytes: int = 4 << 30
    inspect_memory_bytes: int = 8 << 30
    inspect_seconds: int = 300
    inspect_command: tuple[str, ...] = INSPECT  # prints what it reads of the file named last, as JSON
    calibrate_command: tuple[str, ...] = CALIBRATE  # prints the profile of the samples in the file named last, as JSON
    session_s: int = 12 * 3600
    poll_s: float = 0.25  # how often the streams look for new events


def from_environment(environment: Mapping[str, str] = os.environ) -> ApiSettings:
    """Return the settings that the variables FARFIELD_* give."""
    web = environment.get("FARFIELD_WEB", str(Path(__file__).resolve().parents[2] / "webviewer" / "dist"))
    named = json.loads(environment.get("FARFIELD_PLACEMENTS", "{}"))
    return ApiSettings(
        database_url=environment["FARFIELD_DATABASE_URL"],
        broker_url=environment["FARFIELD_BROKER_URL"],
        artifacts=Path(environment["FARFIELD_ARTIFACTS"]),
        secret=environment.get("FARFIELD_SECRET") or secrets.token_hex(32),
        web=Path(web),
        placements={name: Path(folder) for name, folder in named.items()},
        hosts=tuple(environment.get("FARFIELD_HOSTS", "*").split(",")),
        max_scene_bytes=int(environment.get("FARFIELD_MAX_SCENE_BYTES", 4 << 30)),
        inspect_memory_bytes=int(environment.get("FARFIELD_SCENE_MEMORY_BYTES", 8 << 30)),
        inspect_command=tuple(shlex.split(environment.get("FARFIELD_INSPECT", ""))) or INSPECT,
        calibrate_command=tuple(shlex.split(environment.get("FARFIELD_CALIBRATE", ""))) or CALIBRATE,
        inspect_seconds=int(environment.get("FARFIELD_INSPECT_SECONDS", 300)),
    )
