"""`python -m farfield_api`: serve on the socket FARFIELD_FD (the launcher's), or on FARFIELD_HOST and FARFIELD_PORT.

On SIGTERM it takes no new connection, ends its event streams (their clients go on elsewhere, from the last number they saw),
finishes what it is answering, and exits.
"""

import os
import socket
from types import FrameType

import uvicorn
from farfield import logs
from fastapi import FastAPI

from farfield_api.app import make_app
from farfield_api.settings import from_environment

STOP_S = 3  # to finish answers; an upload that takes longer is resumed


class Server(uvicorn.Server):
    """Tells the streams that the end has come: uvicorn waits for them."""

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        super().__init__(config)
        self.app = app

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        super().handle_exit(sig, frame)
        self.app.state.farfield.poller.close()


def main() -> None:
    logs.configure("api")
    given = os.environ.get("FARFIELD_FD")
    app = make_app(from_environment())
    config = uvicorn.Config(
        app,
        host=os.environ.get("FARFIELD_HOST", "127.0.0.1"),
        port=int(os.environ.get("FARFIELD_PORT", "8000")),
        timeout_graceful_shutdown=STOP_S,
        server_header=False,
        access_log=False,  # ours has the route and the tenant, and no query string
        log_config=None,
    )
    # Not uvicorn's `fd`, which takes every socket for a Unix one: asyncio then leaves Nagle's algorithm on, and each
    # answer in two pieces waits 40 ms for the client's acknowledgement of the first.
    Server(config, app).run(sockets=[socket.socket(fileno=int(given))] if given else None)


if __name__ == "__main__":
    main()
