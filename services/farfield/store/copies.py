"""Local copies of remote blobs: a folder of bounded size that any number of processes share.

Problem  Stages map their inputs, so a worker needs files; a fleet's blobs are larger than a worker's disk.
Method   `root/ab/abcdef...`, as a store's own folder. Whoever uses a copy holds a shared lock on the open file (a memory
         map keeps it), which the kernel drops with the process, however that ends. To make room the copy that was used
         longest ago goes first; one that is locked stays. What is being fetched counts with its whole size from the
         start, and one process fetches a blob while the others wait for it.
Errs     towards too many bytes: where everything is in use, a shard gets its input and the bound is passed.
"""

import contextlib
import fcntl
import logging
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from farfield.errors import ArtifactDamaged
from farfield.store.artifacts import Proof, checked

log = logging.getLogger(__name__)

Fetch = Callable[[str, Any], None]  # digest, file to write the blob to; raises unless the bytes have the digest


class Copies:
    """Copies of blobs in `root`, of at most `max_bytes` together. `size` and `fetch` ask the store."""

    def __init__(self, root: Path, max_bytes: int, *, size: Callable[[str], int], fetch: Fetch) -> None:
        self.root, self.max_bytes, self._size, self._fetch = root, max_bytes, size, fetch
        for folder in (root / "tmp", root / "locks"):
            folder.mkdir(parents=True, exist_ok=True)
        self._proof = Proof()

    def path(self, digest: str) -> Path:
        """Return where a copy would lie. Raises ArtifactMissing where `digest` is not a digest."""
        return self.root / checked(digest)[:2] / digest

    def find(self, digest: str) -> Any:
        """Return the open, locked copy, or None where there is none. A damaged one is removed."""
        while True:
            try:
                file = self.path(digest).open("rb")
            except FileNotFoundError:
                return None
            fcntl.flock(file, fcntl.LOCK_SH)
            if not os.fstat(file.fileno()).st_nlink:  # removed between the open and the lock
                file.close()
                continue
            try:
                self._proof.prove(file, digest)
            except ArtifactDamaged:
                log.warning("the local copy of %s was damaged: it is fetched again", digest)
                self.drop(digest)
                return None
            status = os.fstat(file.fileno())
            os.utime(file.fileno(), ns=(time.time_ns(), status.st_mtime_ns))
            return file

    def open(self, digest: str) -> Any:
        """Return the open, locked copy, fetched where it is missing. Raises what `fetch` raises."""
        while True:
            file = self.find(digest)
            if file is not None:
                return file
            with self._alone(digest[:2]):
                if not self.path(digest).exists():
                    self._bring(digest)

    def adopt(self, path: Path, digest: str) -> None:
        """Take over a file that has these bytes: what was just written is read next."""
        n_bytes = path.stat().st_size
        if n_bytes > self.max_bytes:
            path.unlink()
            return
        with self._alone("room"):
            self._make_room(n_bytes)
            self._settle(path, digest)

    def drop(self, digest: str) -> None:
        self.path(digest).unlink(missing_ok=True)

    def n_bytes(self) -> int:
        """Return the size of all copies together, those being fetched with their whole size."""
        return sum(size for _, size, _ in self._all())

    def _bring(self, digest: str) -> None:
        n_bytes = self._size(digest)
        with self._alone("room"):
            self._make_room(n_bytes)
            file = tempfile.NamedTemporaryFile(dir=self.root / "tmp", prefix="fetch-", delete=False)  # noqa: SIM115
            fcntl.flock(file, fcntl.LOCK_SH)
            file.truncate(n_bytes)
        with file:
            try:
                self._fetch(digest, file)
                file.flush()
                self._settle(Path(file.name), digest)
            except BaseException:
                Path(file.name).unlink(missing_ok=True)
                raise

    def _make_room(self, n_bytes: int) -> None:
        """Remove the copies used longest ago until `n_bytes` more fit. Leaves those in use."""
        found = sorted(self._all())
        total = sum(size for _, size, _ in found)
        for _, size, path in found:
            if total + n_bytes <= self.max_bytes:
                return
            total -= size if _remove_unused(path) else 0
        if total + n_bytes > self.max_bytes:
            log.warning("the local copies in use leave no room: %d bytes of %d", total + n_bytes, self.max_bytes)

    def _settle(self, path: Path, digest: str) -> None:
        target = self.path(digest)
        target.parent.mkdir(exist_ok=True)
        path.chmod(0o644)
        path.rename(target)  # not synced: a copy that a power cut spoils is found damaged, and fetched again

    def _all(self) -> Iterator[tuple[int, int, Path]]:
        """Yield (last use in ns, bytes, path) of every copy and of what is being fetched."""
        for pattern in ("[0-9a-f][0-9a-f]/*", "tmp/fetch-*"):
            for path in self.root.glob(pattern):
                with contextlib.suppress(FileNotFoundError):
                    status = path.stat()
                    yield status.st_atime_ns, status.st_size, path

    @contextmanager
    def _alone(self, name: str) -> Iterator[None]:
        with (self.root / "locks" / name).open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield


def _remove_unused(path: Path) -> bool:
    """Remove the file unless someone holds a lock on it; say whether it is gone."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()
    except (BlockingIOError, FileNotFoundError):  # in use; or it has arrived, and has its own name now
        return False
    return True
