"""Blobs under their SHA-256: one interface, a folder or an object store behind it; only the URL differs.

Interface  What an object store can do: put, put_file, has, n_bytes, stream, remove, blobs; and two ways to a file, for
           arrays that are mapped: `buffer`, and `local` for as long as a `with` lasts. Equal blobs are stored once.
Safety     A blob is written to a temporary name, synced and renamed (or put by a request that the store checks against
           the digest): whoever sees its name sees all of it, after any crash. A process hashes a file before it maps it
           the first time: what a disk altered is ArtifactDamaged, never an input.
Folder     `LocalArtifacts`, here. `s3.S3Artifacts` keeps copies of what it reads in a bounded folder (`copies`).
"""

import hashlib
import mmap
import os
import re
import shutil
import tempfile
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from farfield.errors import ArtifactDamaged, ArtifactMissing, ServiceError, StoreUnavailable

CHUNK_BYTES = 1 << 20
CHECKPOINT_S = 7 * 86400.0  # age at which the checkpoint of a shard that nobody finished is removed
CACHE_BYTES = 20 << 30


@dataclass(frozen=True, slots=True)
class Blob:
    """One stored blob, as a listing tells it. `stored_at`: seconds since 1970 UTC by the store's clock."""

    digest: str
    n_bytes: int
    stored_at: float


class Artifacts(ABC):
    """The blobs, whoever keeps them. `temporary` is a folder on the disk that `local` and `put_file` use."""

    temporary: Path

    @abstractmethod
    def has(self, digest: str) -> bool:
        """Say whether the blob is stored."""

    @abstractmethod
    def n_bytes(self, digest: str) -> int:
        """Return the blob's size. Raises ArtifactMissing."""

    @abstractmethod
    def put(self, data: Any) -> str:
        """Store a bytes-like object and return its SHA-256 (64 hexadecimal digits)."""

    @abstractmethod
    def put_file(self, path: Path, digest: str | None = None) -> str:
        """Move `path`, a file in `temporary`, into the store; `digest` where the caller has hashed it already."""

    @abstractmethod
    def stream(self, digest: str, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        """Yield the bytes [start, stop) of the blob (None: to its end) in pieces of at most CHUNK_BYTES.

        The whole blob is checked against its digest, a part of it is not. Raises ArtifactMissing at the first piece.
        """

    @abstractmethod
    def buffer(self, digest: str) -> Any:
        """Return the blob as a read-only memory map (bytes where it is empty). Raises ArtifactMissing, ArtifactDamaged."""

    @abstractmethod
    def local(self, digest: str) -> AbstractContextManager[Path]:
        """A file with the blob, to be read only, that stays for as long as the `with` lasts. Raises as `buffer` does."""

    @abstractmethod
    def remove(self, digest: str) -> None:
        """Remove the blob, if it is there. Only for who knows that no row names it."""

    @abstractmethod
    def blobs(self) -> Iterator[Blob]:
        """Yield every stored blob, in order of the digests."""

    @abstractmethod
    def checkpoint(self, name: str) -> AbstractContextManager[Path]:
        """A file for what a killed run's successor goes on from: what it writes there any machine finds under `name`."""

    @abstractmethod
    def drop_checkpoint(self, name: str) -> None:
        """Remove the checkpoint: its shard is done."""

    @abstractmethod
    def drop_old_checkpoints(self, seconds: float = CHECKPOINT_S) -> int:
        """Remove the checkpoints that nobody wrote for so long; return how many."""

    @abstractmethod
    def make(self) -> None:
        """Make the folder or the bucket, where there is none."""

    @abstractmethod
    def check(self) -> None:
        """Raise StoreUnavailable where the store does not answer or cannot be written."""

    @abstractmethod
    def clear_temporary(self) -> None:
        """Remove what killed processes left half-written, and old checkpoints. Only for who knows that nobody writes."""


def open_artifacts(url: str | Path, *, cache: Path | None = None, cache_bytes: int = CACHE_BYTES) -> Artifacts:
    """Return the store at `url`: a folder's path, or "s3://bucket/prefix" with local copies in the folder `cache`.

    Raises ServiceError where the URL names neither.
    """
    text = str(url)
    if text.startswith("s3://"):
        from farfield.store.s3 import S3Artifacts

        default = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "farfield"
        return S3Artifacts(text, cache=cache or default, cache_bytes=cache_bytes)
    if "://" in text and not text.startswith("file://"):
        raise ServiceError(f"{text.partition('://')[0]}:// is no artifact store: give a folder, or s3://bucket/prefix")
    return LocalArtifacts(Path(text.removeprefix("file://")))


class LocalArtifacts(Artifacts):
    """The blobs in `root`: `root/ab/abcdef...`; `root/tmp` holds what is being written, `root/checkpoints` what a killed
    shard goes on from."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.temporary = root / "tmp"
        self.temporary.mkdir(parents=True, exist_ok=True)
        self.checkpoints = root / "checkpoints"
        self.checkpoints.mkdir(exist_ok=True)
        self._proof = Proof()

    def path(self, digest: str) -> Path:
        """Return where the blob lies, or would. Raises ArtifactMissing where `digest` is not a digest."""
        return self.root / checked(digest)[:2] / digest

    def has(self, digest: str) -> bool:
        return self.path(digest).is_file()

    def n_bytes(self, digest: str) -> int:
        try:
            return self.path(digest).stat().st_size
        except FileNotFoundError:
            raise ArtifactMissing(digest) from None

    def put(self, data: Any) -> str:
        view = memoryview(data).cast("B")
        digest = hashlib.sha256(view).hexdigest()
        if not self.has(digest):
            handle, name = tempfile.mkstemp(dir=self.temporary)
            with os.fdopen(handle, "wb") as file:
                file.write(view)
            self._settle(Path(name), digest)
        return digest

    def put_file(self, path: Path, digest: str | None = None) -> str:
        if digest is None:
            digest = file_digest(path)
        if self.has(digest):
            path.unlink()
        else:
            self._settle(path, digest)
        return digest

    def stream(self, digest: str, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        with self._open(digest, prove=start == 0 and stop is None) as file:
            yield from pieces(file, start, stop)

    def buffer(self, digest: str) -> Any:
        with self._open(digest, prove=True) as file:
            return mapped(file)

    @contextmanager
    def local(self, digest: str) -> Iterator[Path]:
        self._open(digest, prove=True).close()
        yield self.path(digest)

    def remove(self, digest: str) -> None:
        self.path(digest).unlink(missing_ok=True)

    def blobs(self) -> Iterator[Blob]:
        for folder in sorted(self.root.glob("[0-9a-f][0-9a-f]")):
            for name in sorted(os.listdir(folder)):
                try:
                    status = (folder / name).stat()
                except FileNotFoundError:  # removed meanwhile
                    continue
                yield Blob(name, status.st_size, status.st_mtime)

    @contextmanager
    def checkpoint(self, name: str) -> Iterator[Path]:
        yield self.checkpoints / name

    def drop_checkpoint(self, name: str) -> None:
        (self.checkpoints / name).unlink(missing_ok=True)

    def drop_old_checkpoints(self, seconds: float = CHECKPOINT_S) -> int:
        old = [file for file in self.checkpoints.iterdir() if time.time() - file.stat().st_mtime > seconds]
        for file in old:
            file.unlink(missing_ok=True)
        return len(old)

    def make(self) -> None:
        return  # made when it was opened

    def check(self) -> None:
        try:
            with tempfile.TemporaryFile(dir=self.temporary):
                pass
        except OSError as error:
            raise StoreUnavailable(f"the artifact store cannot be written: {error.strerror}") from error

    def clear_temporary(self) -> None:
        shutil.rmtree(self.temporary)
        self.temporary.mkdir()
        self.drop_old_checkpoints()

    def _open(self, digest: str, *, prove: bool) -> Any:
        try:
            file = self.path(digest).open("rb")
        except FileNotFoundError:
            raise ArtifactMissing(digest) from None
        if prove:
            self._proof.prove(file, digest)
        return file

    def _settle(self, temporary: Path, digest: str) -> None:
        target = self.path(digest)
        target.parent.mkdir(exist_ok=True)
        temporary.chmod(0o644)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.rename(target)
        sync_folder(target.parent)


class Proof:
    """Which files this process has hashed: each once, until it is another file or was written again."""

    def __init__(self) -> None:
        self._proven: dict[str, tuple[int, int, int]] = {}
        self._lock = threading.Lock()

    def prove(self, file: Any, digest: str) -> None:
        """Raise ArtifactDamaged, and close the file, unless it has this SHA-256."""
        status = os.fstat(file.fileno())
        identity = (status.st_ino, status.st_size, status.st_mtime_ns)
        with self._lock:
            if self._proven.get(digest) == identity:
                return
        if hashlib.file_digest(file, "sha256").hexdigest() != digest:
            file.close()
            raise ArtifactDamaged(digest)
        file.seek(0)
        with self._lock:
            if len(self._proven) >= 100_000:
                self._proven.clear()
            self._proven[digest] = identity


def checked(digest: str) -> str:
    """Return `digest`. Raises ArtifactMissing where it is none: no name from outside becomes a path or a key."""
    if not re.fullmatch("[0-9a-f]{64}", digest):
        raise ArtifactMissing(digest)
    return digest


def file_digest(path: Path) -> str:
    """Return the SHA-256 (hex) of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def pieces(file: Any, start: int, stop: int | None) -> Iterator[bytes]:
    """Yield the bytes [start, stop) of an open file, CHUNK_BYTES at a time."""
    file.seek(start)
    left = stop - start if stop is not None else None
    while left is None or left > 0:
        data = file.read(CHUNK_BYTES if left is None else min(CHUNK_BYTES, left))
        if not data:
            return
        left = left - len(data) if left is not None else None
        yield data


def mapped(file: Any) -> Any:
    """Return the open file as a read-only memory map (b"" where it is empty), which holds it open."""
    if not os.fstat(file.fileno()).st_size:
        return b""
    return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def sync_folder(folder: Path) -> None:
    """Make the names in `folder` survive a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
