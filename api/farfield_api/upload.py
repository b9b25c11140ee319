"""An upload streamed to a temporary file, hashed on the way, then read in a process with limits."""

import asyncio
import hashlib
import json
import os
import re
import signal
import tempfile
from collections.abc import AsyncIterator, Sequence
from contextlib import suppress
from email.message import Message
from pathlib import Path
from typing import Any

from farfield import errors
from farfield.errors import FarfieldError, SceneOverLimit, SceneUnreadable
from fastapi import Request
from python_multipart.multipart import MultipartParser
from starlette.concurrency import run_in_threadpool

from farfield_api.errors import InputRefused, UploadAltered, UploadTooLarge
from farfield_api.settings import ApiSettings

SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl", ".zip")
WRITE_BYTES = 1 << 20
_reading = asyncio.Semaphore(2)  # processes that read at the same time


class Received:
    """What has arrived of a file: its path, digest, size and the name it was sent under."""

    def __init__(self, path: Path) -> None:
        self.path, self.n_bytes, self.name = path, 0, ""
        self.hash = hashlib.sha256()

    @property
    def digest(self) -> str:
        return self.hash.hexdigest()


async def receive(request: Request, folder: Path, limit: int) -> Received:
    """Write the body (raw, or the file of a form) into a new file of `folder`. Raises UploadTooLarge, UploadAltered.

    The name comes from Content-Disposition: attachment; filename="level.glb", or from the form.
    """
    announced = request.headers.get("content-length", "")
    if announced.isdigit() and int(announced) > limit + (1 << 16):  # a form is a little larger than its file
        raise UploadTooLarge(limit)
    handle, name = tempfile.mkstemp(dir=folder, prefix="upload-")
    received = Received(Path(name))
    received.name = _filename(request.headers.get("content-disposition", ""))
    try:
        with os.fdopen(handle, "wb") as file:
            pending = bytearray()
            async for chunk in _file_of(request, received):
                received.n_bytes += len(chunk)
                if received.n_bytes > limit:
                    raise UploadTooLarge(limit)
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
    return received


def suffix_of(received: Received) -> str:
    """Return the ending that says the format: of the name, or by the first bytes. Raises SceneUnreadable."""
    suffix = Path(received.name).suffix.lower()
    if suffix in SUFFIXES:
        return suffix
    with received.path.open("rb") as file:
        head = file.read(16)
    for magic, found in ((b"glTF", ".glb"), (b"PK\x03\x04", ".zip"), (b"ply", ".ply"), (b"solid", ".stl")):
        if head.startswith(magic):
            return found
    raise SceneUnreadable(f"{received.name or 'the upload'} is none of {', '.join(SUFFIXES)}")


async def read_apart(reader: Sequence[str], path: Path, shown: str, settings: ApiSettings) -> dict[str, Any]:
    """Return what the command `reader` says of the file, as JSON. Raises InputRefused with its error's name,
    SceneOverLimit.
    """
    limits = [str(settings.inspect_memory_bytes), str(settings.inspect_seconds)]
    command = [reader[0], "-m", "farfield_api.limited", *limits, *reader, str(path)]
    async with _reading:
        child = await asyncio.create_subprocess_exec(
            *command, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE, start_new_session=True,
        )  # fmt: skip
        try:
            out, err = await asyncio.wait_for(child.communicate(), settings.inspect_seconds)
        except TimeoutError:
            raise SceneOverLimit(f"reading {shown} took more than {settings.inspect_seconds} s") from None
        finally:
            with suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
                await child.wait()
    if child.returncode == 0:
        found = json.loads(out)
        assert isinstance(found, dict)
        return found
    raise _refusal(err.decode(errors="replace"), path, shown)


def _refusal(text: str, path: Path, shown: str) -> FarfieldError:
    lines = [line.replace(str(path), shown).replace(str(path.parent) + "/", "") for line in text.splitlines()]
    for i, line in enumerate(lines):
        match = re.fullmatch(r"(\w+): (.+)", line)
        known = getattr(errors, match[1], None) if match else None
        if match and isinstance(known, type) and issubclass(known, FarfieldError):
            return InputRefused(match[1], match[2], known.advice or "\n".join(lines[i + 1 :]))
    if "MemoryError" in text or not text.strip():
        return SceneOverLimit(f"reading {shown} needs more memory or time than is allowed")
    return SceneUnreadable(f"{shown} cannot be read")


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
    name = name.encode("utf-8", "replace").decode()  # half a surrogate pair can be stored nowhere
    return re.sub(r"[\x00-\x1f\x7f]", "", name.replace("\\", "/").rsplit("/", 1)[-1])[:255]


async def _file_of(request: Request, received: Received) -> AsyncIterator[bytes]:
    kind = Message()
    kind["content-type"] = request.headers.get("content-type", "application/octet-stream")
    if kind.get_content_type() != "multipart/form-data":
        async for chunk in request.stream():
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
    async for chunk in request.stream():
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
