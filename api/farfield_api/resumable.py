"""The bytes of uploads that resume: appended under a lock, synced before they are told, whole ones made scenes.

File    `folder/ID`. Only its first `received` bytes count; they are synced before the row says so, every SYNC_BYTES and at
        the end of a request. What a kill or a power cut leaves beyond them is written over.
Lock    An advisory lock on the file: one writer, whatever the number of processes. A request that comes while another one
        of this process still waits for bytes takes its place: the other one's line is most likely dead.
Whole   The last byte starts the reading, which ends in the row as a scene or as a refusal. Killed meanwhile, it starts
        again with the next request, which has no bytes to bring.
Hosts   Where several hosts serve one database without sharing the folder, a host that has not the bytes says so by 409 and
        starts again at 0: slower, never wrong.
"""

import asyncio
import fcntl
import hashlib
import logging
import os
import shutil
import time
from base64 import b64decode
from binascii import Error as NotBase64
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from farfield.errors import FarfieldError, SceneNotFound, UploadNotFound
from farfield.store import quotas, scenes, uploads
from farfield.store.engine import read
from fastapi import Request
from starlette.concurrency import run_in_threadpool

from farfield_api.accept import Arrived, accept
from farfield_api.body import Body
from farfield_api.errors import (
    InputRefused,
    StoreFull,
    UploadAltered,
    UploadBusy,
    UploadChecksumWrong,
    UploadCut,
    UploadHeaderInvalid,
    UploadOffsetWrong,
    UploadStalled,
    UploadTooLarge,
    status_of,
)
from farfield_api.state import State

log = logging.getLogger(__name__)

WRITE_BYTES, SYNC_BYTES = 1 << 20, 32 << 20
SPARE_BYTES = 64 << 20  # room that an upload leaves to others
TAKEOVER_S, POLL_S = 5.0, 0.05
CHECKSUMS = ("sha1", "sha256")
LEFT_S = 86400.0  # age at which a temporary file has no owner
_writing: dict[str, Body] = {}


def folder_of(service: State) -> Path:
    """Return the folder of the files, and make it."""
    folder = service.settings.uploads or service.artifacts.temporary.parent / "uploads"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder


def need_room(service: State, n_bytes: int) -> None:
    """Raise StoreFull where a file of so many bytes would not fit."""
    if shutil.disk_usage(folder_of(service)).free < n_bytes + SPARE_BYTES:
        raise StoreFull


def need_quota(service: State, tenant_id: str, n_bytes: int, digest: str | None) -> None:
    """Raise QuotaExceeded where the tenant may not store so much: before the bytes come, not after.

    digest  a scene that the tenant has is no more of it
    """
    if digest is not None:
        with suppress(SceneNotFound):
            scenes.get(service.engine, tenant_id, digest)
            return
    with read(service.engine) as tx:
        quotas.check_bytes(tx, tenant_id, service.settings.quota, n_bytes)


async def append(request: Request, service: State, row: sa.Row[Any], offset: int) -> sa.Row[Any]:
    """Add the body to the upload and return its row; with the last byte it becomes a scene, or is refused.

    Raises UploadOffsetWrong, UploadTooLarge, UploadBusy, UploadStalled, UploadCut, UploadChecksumWrong, StoreFull; of a
    whole file InputRefused and UploadAltered, which are written down.
    """
    checksum = _checksum(request.headers.get("upload-checksum"))
    path = folder_of(service) / row.id
    tenant_id = row.tenant_id
    async with _held(row.id, path) as handle:
        row = await run_in_threadpool(uploads.get, service.engine, tenant_id, row.id)
        if row.scene_digest is not None or row.refusal is not None:
            path.unlink(missing_ok=True)
            ended(row)
            return row
        received = row.received
        if os.fstat(handle).st_size < received:
            await run_in_threadpool(_advance, service, row.id, received, 0)
            received = 0
        if offset != received:
            raise UploadOffsetWrong(offset, received)
        announced = request.headers.get("content-length", "")
        if announced.isdigit() and int(announced) > row.n_bytes - offset:
            raise UploadTooLarge(row.n_bytes)
        body = Body(request, service.settings.stall_s)
        received = await _write(body, service, row, handle, offset, checksum)
        if received == row.n_bytes:
            try:
                await _finish(service, row, path)
            except FileNotFoundError:
                if path.exists():
                    raise
                raise UploadNotFound(row.id) from None  # given up meanwhile, before it was read
    return await run_in_threadpool(uploads.get, service.engine, tenant_id, row.id)


def ended(row: sa.Row[Any]) -> None:
    """Raise what an upload that was refused was refused with."""
    if row.refusal is not None:
        raise InputRefused(row.refusal["code"], row.refusal["detail"], row.refusal["advice"])


def forget(service: State, upload_id: str) -> None:
    """Remove an upload with its bytes. Whoever still writes finds no row, and stops."""
    uploads.remove(service.engine, upload_id)
    (folder_of(service) / upload_id).unlink(missing_ok=True)
    if (body := _writing.get(upload_id)) is not None:
        body.interrupt()


def sweep(service: State) -> int:
    """Remove uploads whose time is over, files that no upload owns, and what killed processes left; return how many."""
    gone = uploads.expired(service.engine)
    for upload_id in gone:
        forget(service, upload_id)
    files = [f for f in folder_of(service).iterdir() if _age_s(f) > 3600.0]
    waiting = uploads.waiting(service.engine, [f.name for f in files])
    left = [f for f in files if f.name not in waiting]
    left += [f for kind in ("upload-", "read-") for f in service.artifacts.temporary.glob(f"{kind}*")
             if _age_s(f) > LEFT_S]  # fmt: skip
    for file in left:
        shutil.rmtree(file, ignore_errors=True) if file.is_dir() else file.unlink(missing_ok=True)
    return len(gone) + len(left)


async def keep_swept(service: State, every_s: float = 3600.0) -> None:
    """Sweep now and for ever; a task of the app."""
    while True:
        try:
            await run_in_threadpool(sweep, service)
        except Exception:  # a database that is away comes back
            log.warning("uploads could not be swept", exc_info=True)
        await asyncio.sleep(every_s)


def _age_s(path: Path) -> float:
    with suppress(FileNotFoundError):
        return time.time() - path.stat().st_mtime
    return 0.0


def _checksum(header: str | None) -> tuple[str, bytes] | None:
    if header is None:
        return None
    kind, _, text = header.strip().partition(" ")
    try:
        digest = b64decode(text.strip(), validate=True)
    except (NotBase64, ValueError):
        digest = b""
    if kind not in CHECKSUMS or len(digest) != hashlib.new(kind, usedforsecurity=False).digest_size:
        raise UploadHeaderInvalid(
            f"Upload-Checksum is one of {', '.join(CHECKSUMS)}, a space, and the digest in base64"
        )
    return kind, digest


@asynccontextmanager
async def _held(upload_id: str, path: Path) -> AsyncIterator[int]:
    """Hold the upload's lock; yields its file, open for reading and writing. Raises UploadBusy."""
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW
    handle = await run_in_threadpool(os.open, path, flags, 0o600)
    try:
        for _ in range(round(TAKEOVER_S / POLL_S)):
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if (body := _writing.get(upload_id)) is not None:
                    body.interrupt()
                await asyncio.sleep(POLL_S)
        else:
            raise UploadBusy
        yield handle
    finally:
        os.close(handle)


async def _write(
    body: Body, service: State, row: sa.Row[Any], handle: int, offset: int, checksum: tuple[str, bytes] | None
) -> int:
    """Write the body at `offset` and return how many bytes of the upload are safe."""
    hashed = hashlib.new(checksum[0], usedforsecurity=False) if checksum is not None else None
    safe, at, pending = offset, offset, bytearray()
    _writing[row.id] = body
    try:
        os.ftruncate(handle, offset)
        async for piece in body.pieces():
            if at + len(pending) + len(piece) > row.n_bytes:
                raise UploadTooLarge(row.n_bytes)
            pending += piece
            if hashed is not None:
                hashed.update(piece)
            if len(pending) >= WRITE_BYTES:
                await run_in_threadpool(_put, handle, bytes(pending), at)
                at += len(pending)
                pending.clear()
            if at - safe >= SYNC_BYTES and hashed is None:
                await run_in_threadpool(_keep, service, row.id, handle, b"", at, safe)
                safe = at
    except (UploadCut, UploadStalled, asyncio.CancelledError):
        # What came before the line broke is kept, but for what a checksum that never came was to prove. Here and not in
        # a thread: a request that is cancelled may wait for nothing.
        if hashed is None:
            _keep(service, row.id, handle, bytes(pending), at, safe)
        raise
    except BaseException:
        with suppress(OSError):
            os.ftruncate(handle, safe)
        raise
    finally:
        del _writing[row.id]
    if checksum is not None and hashed is not None and hashed.digest() != checksum[1]:
        os.ftruncate(handle, safe)
        raise UploadChecksumWrong
    await run_in_threadpool(_keep, service, row.id, handle, bytes(pending), at, safe)
    return at + len(pending)


def _put(handle: int, data: bytes, at: int) -> None:
    view = memoryview(data)
    while view:
        n = os.pwrite(handle, view, at)
        at, view = at + n, view[n:]


def _keep(service: State, upload_id: str, handle: int, data: bytes, at: int, safe: int) -> None:
    _put(handle, data, at)
    if at + len(data) > safe:
        os.fdatasync(handle)
        _advance(service, upload_id, safe, at + len(data))


def _advance(service: State, upload_id: str, old: int, new: int) -> None:
    if not uploads.advance(service.engine, upload_id, old=old, new=new, lifetime_s=service.settings.upload_s):
        raise UploadNotFound(upload_id)


async def _finish(service: State, row: sa.Row[Any], path: Path) -> None:
    """Make the file a scene, or write down why it is none. What may pass (a full disk, a store away) is not written."""
    digest = await run_in_threadpool(_digest, path)
    try:
        if row.digest is not None and digest != row.digest:
            raise UploadAltered(f"the file has SHA-256 {digest}, not the {row.digest} that was announced")
        file = Arrived(path=path, name=row.name, n_bytes=row.n_bytes, digest=digest)
        await accept(service, row.tenant_id, file)
    except FarfieldError as error:
        if status_of(error) == 422:
            refusal = {"status": 422, "code": error.code, "detail": str(error), "advice": error.advice}
            await run_in_threadpool(uploads.finish, service.engine, row.id, refusal=refusal)
            path.unlink(missing_ok=True)
        raise
    await run_in_threadpool(uploads.finish, service.engine, row.id, scene_digest=digest)
    path.unlink(missing_ok=True)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
