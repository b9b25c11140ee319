"""`python -m farfield_api`: serve on the socket FARFIELD_FD (the launcher's), or on FARFIELD_HOST and FARFIELD_PORT."""

import os

import uvicorn

from farfield_api.app import make_app
from farfield_api.settings import from_environment


def main() -> None:
    given = os.environ.get("FARFIELD_FD")
    uvicorn.run(
        make_app(from_environment()),
        fd=int(given) if given else None,
        host=os.environ.get("FARFIELD_HOST", "127.0.0.1"),
        port=int(os.environ.get("FARFIELD_PORT", "8000")),
        timeout_graceful_shutdown=3,  # an open stream of events would block the stop for ever
        server_header=False,
    )


if __name__ == "__main__":
    main()
