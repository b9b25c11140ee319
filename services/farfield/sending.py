"""Send a file so that nothing is sent twice: what a service has of it is asked first, and after every failure.

tus 1.0.0. Uploads are found by the file's digest, so that a process that was killed, or another machine, goes on where the
last one stopped, and keeps no note of it. Pieces of PIECE_BYTES: what proxies hold back until it is whole is soon on its way.
"""

import time
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol

import httpx

from farfield.errors import ServiceError

PIECE_BYTES, CHUNK_BYTES = 64 << 20, 1 << 20
TRIES, PAUSE_S = 8, 0.5  # failures one after another without a new byte
BUSY = 423  # read by another request: minutes, for a large level
AGAIN = (404, 408, 409, BUSY, 502, 503, 504)
TUS = {"tus-resumable": "1.0.0"}


class Service(Protocol):
    """What of a client this needs: requests that are answered or raise, and answers that are JSON or a refusal."""

    def request(self, method: str, path: str, **more: Any) -> httpx.Response:
        """Return the answer; ask again where the connection fails. Raises ServiceError."""

    def once(self, method: str, path: str, **more: Any) -> httpx.Response:
        """Return the answer. Raises httpx.TransportError."""

    def read(self, answer: httpx.Response) -> dict[str, Any]:
        """Return the JSON of an answer. Raises Refused."""

    def refuse(self, problem: Mapping[str, Any]) -> Exception:
        """Return a refusal to raise."""


def send_file(service: Service, path: Path, *, digest: str, sent: Callable[[int], object]) -> None:
    """Send what the service has not yet of the file, and return once it is a scene. Raises Refused, ServiceError.

    digest  SHA-256 of the file
    sent    told the bytes of each piece that went or was there; negative where the service has fewer than were sent
    """
    n_bytes, told, most, failures = path.stat().st_size, 0, 0, 0
    where = _found(service, digest, n_bytes) or _started(service, path.name, digest, n_bytes)
    while True:
        try:
            answer = service.request("GET", where)
        except ServiceError:  # it has waited a while: a service that restarts takes longer, now and then
            failures += 1
            if failures >= TRIES:
                raise
            continue
        if answer.status_code == 404 and failures < TRIES:  # expired, or ended by somebody
            failures += 1
            where = _started(service, path.name, digest, n_bytes)
            continue
        state = service.read(answer)
        if state["problem"] is not None:
            raise service.refuse(state["problem"])
        at = n_bytes if state["state"] == "done" else state["received"]
        if at != told:
            sent(at - told)
        told, failures, most = at, 0 if at > most else failures, max(at, most)
        if state["state"] == "done":
            return
        size = min(PIECE_BYTES, n_bytes - at)
        headers = {
            **TUS, "content-type": "application/offset+octet-stream", "content-length": str(size),
            "upload-offset": str(at),
        }  # fmt: skip

        def content(at: int = at, size: int = size) -> Iterator[bytes]:
            nonlocal told
            for chunk in _chunks(path, at, size):
                yield chunk
                told += len(chunk)
                sent(len(chunk))

        try:
            answer = service.once("PATCH", where, headers=headers, content=content())
        except httpx.TransportError as error:
            failures += 1
            if failures >= TRIES:
                raise ServiceError(f"{path.name} could not be sent: {error}") from error
        else:
            if answer.is_success:
                continue
            failures += 1
            if answer.status_code not in AGAIN or (failures >= TRIES and answer.status_code != BUSY):
                service.read(answer)
        time.sleep(min(PAUSE_S * 2 ** (failures - 1), 10.0))


def _found(service: Service, digest: str, n_bytes: int) -> str | None:
    """Return the address of the upload of this file that has come farthest."""
    listed = service.read(service.request("GET", "/v1/uploads", params={"sha256": digest}))["uploads"]
    open_ones = [u for u in listed if u["state"] in ("open", "reading") and u["bytes"] == n_bytes]
    return str(open_ones[0]["links"]["self"]) if open_ones else None


def _started(service: Service, name: str, digest: str, n_bytes: int) -> str:
    told = ",".join(f"{k} {b64encode(v.encode()).decode()}" for k, v in (("filename", name), ("sha256", digest)))
    headers = {**TUS, "upload-length": str(n_bytes), "upload-metadata": told}
    answer = service.request("POST", "/v1/uploads", headers=headers)
    if not answer.is_success:
        service.read(answer)
    return httpx.URL(answer.headers["location"]).path


def _chunks(path: Path, at: int, n_bytes: int) -> Iterator[bytes]:
    with path.open("rb") as file:
        file.seek(at)
        while n_bytes and (chunk := file.read(min(CHUNK_BYTES, n_bytes))):
            n_bytes -= len(chunk)
            yield chunk
