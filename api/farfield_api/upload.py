"""A whole file in one request: streamed to a temporary file, hashed on the way."""

import hashlib
import os
import re
import tempfile
from collections.abc import AsyncIterator, Callable
from email.message import Message
from pathlib import Path
from typing import Any

from fastapi import Request
from python_multipart.multipart import MultipartParser
from starlette.concurrency import run_in_threadpool

from farfield_api.accept import Arrived
from farfield_api.body import Body
from farfield_api.errors import UploadAltered, UploadTooLarge

WRITE_BYTES = 1 << 20
FORM_BYTES = 1 << 16  # by which a form may be larger than its file


class Received:
    """What has arrived of a file: its path, digest, size and the name it was sent under."""

    def __init__(self, path: Path) -> None:
        self.path, self.n_bytes, self.name = path, 0, ""
        self.hash = hashlib.sha256()

    def arrived(self) -> Arrived:
        return Arrived(path=self.path, name=self.name, n_bytes=self.n_bytes, digest=self.hash.hexdigest())


async def receive(
    request: Request, folder: Path, *, limit: int, stall_s: float, room: Callable[[int], int | None] = lambda n: None
) -> Arrived:
    """Write the body (raw, or the file of a form) into a new file of `folder`, which is the caller's to remove.

    room  returns how many bytes may come, None for any number, and raises where so many have already come or are announced
    Raises UploadTooLarge, UploadAltered, UploadStalled, UploadCut; nothing is left then.

    The name comes from Content-Disposition: attachment; filename="level.glb", or from the form.
    """
    announced = request.headers.get("content-length", "")
    least = max(int(announced) - FORM_BYTES, 0) if announced.isdigit() else 0
    if least > limit:
        raise UploadTooLarge(limit)
    most = await run_in_threadpool(room, least)
    handle, name = tempfile.mkstemp(dir=folder, prefix="upload-")
    received = Received(Path(name))
    received.name = _filename(request.headers.get("content-disposition", ""))
    try:
        with os.fdopen(handle, "wb") as file:
            pending = bytearray()
            async for chunk in _file_of(request, Body(request, stall_s), received):
                received.n_bytes += len(chunk)
                if received.n_bytes > limit:
                    raise UploadTooLarge(limit)
                if most is not None and received.n_bytes > most:
                    most = await run_in_threadpool(room, received.n_bytes)
                pending += chunk
                if len(pending) >= WRITE_BYTES:
                    await run_in_threadpool(_write, file, received, bytes(pending))
                    pending.clear()
            await run_in_threadpool(_write, file, received, bytes(pending))
        if not received.n_bytes:
            raise UploadAltered("the upload is empty")
    except BaseException:
        received.path.unlink(missing_ok=True)
        raise
    return received.arrived()


def _write(file: Any, received: Received, data: bytes) -> None:
    received.hash.update(data)
    file.write(data)


def _filename(disposition: str) -> str:
    message = Message()
    message["content-disposition"] = disposition or "attachment"
    try:
        name = message.get_filename() or ""
    except UnicodeError:  # the charset that it names is not one for text
        name = ""
    return plain_name(name)


def plain_name(name: str) -> str:
    """Return a file name without folders, control characters and what no text can hold."""
    name = name.encode("utf-8", "replace").decode()  # half a surrogate pair can be stored nowhere
    return re.sub(r"[\x00-\x1f\x7f]", "", name.replace("\\", "/").rsplit("/", 1)[-1])[:255]


async def _file_of(request: Request, body: Body, received: Received) -> AsyncIterator[bytes]:
    kind = Message()
    kind["content-type"] = request.headers.get("content-type", "application/octet-stream")
    if kind.get_content_type() != "multipart/form-data":
        async for chunk in body.pieces():
            yield chunk
        return
    boundary = kind.get_param("boundary")
    if not isinstance(boundary, str):
        raise UploadAltered("the form has no boundary")
    part = _FilePart(received)
    try:
        parser = MultipartParser(boundary.encode("latin-1", "replace"), part.callbacks())  # type: ignore[arg-type]
    except ValueError as error:
        raise UploadAltered("the form's boundary is too long") from error
    async for chunk in body.pieces():
        try:
            parser.write(chunk)
        except ValueError as error:
            raise UploadAltered("the form is damaged") from error
        if part.data:
            yield bytes(part.data)
            part.data.clear()
    if not part.complete:
        raise UploadAltered("the form is incomplete, or has no file")


class _FilePart:
    """The first part of a form that has a file name."""

    def __init__(self, received: Received) -> None:
        self.received, self.data = received, bytearray()
        self.inside = self.seen = self.complete = False
        self._field, self._value = bytearray(), bytearray()

    def callbacks(self) -> dict[str, Any]:
        return {
            "on_header_field": lambda data, start, end: self._field.extend(data[start:end]),
            "on_header_value": lambda data, start, end: self._value.extend(data[start:end]),
            "on_header_end": self._header,
            "on_part_data": self._content,
            "on_part_end": self._end,
        }

    def _header(self) -> None:
        if bytes(self._field).lower() == b"content-disposition" and not self.seen:
            name = _filename(self._value.decode("utf-8", "replace"))
            if name:
                self.received.name, self.inside, self.seen = name, True, True
        self._field.clear()
        self._value.clear()

    def _content(self, data: bytes, start: int, end: int) -> None:
        if self.inside:
            self.data += data[start:end]

    def _end(self) -> None:
        self.complete = self.complete or self.inside
        self.inside = False
