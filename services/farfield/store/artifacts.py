"""Blobs under their SHA-256, in a folder.

A blob is written to a temporary name, synced and renamed: whoever sees its name sees all of it, after any crash. Equal
blobs are one file. The interface is what an object store can do: put, put_file, has, n_bytes, buffer, remove; `path` is
for who needs a file by name.
"""

import hashlib
import mmap
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from farfield.errors import ArtifactMissing

CHUNK_BYTES = 1 << 20
CHECKPOINT_S = 7 * 86400.0  # age at which the checkpoint of a shard that nobody finished is removed


class LocalArtifacts:
    """The blobs in `root`: `root/ab/abcdef...`; `root/tmp` holds what is being written, `root/checkpoints` what a killed
    shard goes on from."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.temporary = root / "tmp"
        self.temporary.mkdir(parents=True, exist_ok=True)
        self.checkpoints = root / "checkpoints"
        self.checkpoints.mkdir(exist_ok=True)

    def path(self, digest: str) -> Path:
        """Return where the blob lies, or would. Raises ArtifactMissing where `digest` is not a digest."""
        if not re.fullmatch("[0-9a-f]{64}", digest):
            raise ArtifactMissing(digest)
        return self.root / digest[:2] / digest

    def has(self, digest: str) -> bool:
        return self.path(digest).is_file()

    def n_bytes(self, digest: str) -> int:
        """Return the blob's size. Raises ArtifactMissing."""
        try:
            return self.path(digest).stat().st_size
        except FileNotFoundError:
            raise ArtifactMissing(digest) from None

    def put(self, data: Any) -> str:
        """Store a bytes-like object and return its SHA-256 (64 hexadecimal digits)."""
        view = memoryview(data).cast("B")
        digest = hashlib.sha256(view).hexdigest()
        if not self.has(digest):
            handle, name = tempfile.mkstemp(dir=self.temporary)
            with os.fdopen(handle, "wb") as file:
                file.write(view)
            self._settle(Path(name), digest)
        return digest

    def put_file(self, path: Path, digest: str | None = None) -> str:
        """Move `path`, a file in `temporary`, into the store; `digest` where the caller has hashed it already."""
        if digest is None:
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
        if self.has(digest):
            path.unlink()
        else:
            self._settle(path, digest)
        return digest

    def buffer(self, digest: str) -> Any:
        """Return the blob as a read-only memory map (bytes where it is empty). Raises ArtifactMissing."""
        if not self.n_bytes(digest):
            return b""
        with self.path(digest).open("rb") as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)

    def remove(self, digest: str) -> None:
        self.path(digest).unlink(missing_ok=True)

    def clear_temporary(self) -> None:
        """Remove what killed processes left half-written, and old checkpoints. Only for who knows that nobody writes."""
        shutil.rmtree(self.temporary)
        self.temporary.mkdir()
        for file in self.checkpoints.iterdir():
            if time.time() - file.stat().st_mtime > CHECKPOINT_S:
                file.unlink(missing_ok=True)

    def digests(self) -> Iterator[str]:
        """Yield the name of every blob, in order."""
        for folder in sorted(self.root.glob("[0-9a-f][0-9a-f]")):
            yield from sorted(file.name for file in folder.iterdir())

    def _settle(self, temporary: Path, digest: str) -> None:
        target = self.path(digest)
        target.parent.mkdir(exist_ok=True)
        temporary.chmod(0o644)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.rename(target)
        sync_folder(target.parent)


def sync_folder(folder: Path) -> None:
    """Make the names in `folder` survive a power cut."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
