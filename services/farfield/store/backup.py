"""Copy the embedded form of the service while it works, and bring a copy back.

Problem  The database and the artifacts change at different moments: a copy of one, then of the other, has rows without blobs.
Method   Blobs never change, so their time does not matter, only their presence. Copy all blobs; then take SQLite's online
         backup, which is the state at one moment; then copy the blobs that it names and are not yet there. A blob
         deleted in between (a job was deleted) is missing now: take the database again. Every blob is hashed on the way.
Again    Into the same folder only what is new is copied; what the new database does not name is removed from it.
Holds    farfield.sqlite, artifacts/, api-key, secret, webhook-key, backup.json (written last: a backup without it is
         not one). It holds levels and keys: keep it as safe as the service.
"""

import json
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

from farfield.errors import ArtifactDamaged, ArtifactMissing, ServiceError
from farfield.store.artifacts import LocalArtifacts, file_digest, sync_folder
from farfield.store.collect import references

DATABASE, ARTIFACTS, MANIFEST = "farfield.sqlite", "artifacts", "backup.json"
PRIVATE = ("api-key", "secret", "webhook-key")
TRIES = 5
Said = Callable[[str], object]


def backup(data: Path, target: Path, *, say: Said = bool) -> dict[str, Any]:
    """Copy the service's folder `data` to `target` and return what the copy holds.

    Raises ServiceError where `data` holds no service, where artifacts that the database names are lost or damaged (the
    copy is complete but for them, and says so), or where jobs are deleted faster than they can be copied.
    """
    if not (data / DATABASE).is_file():
        raise ServiceError(f"{data} holds no {DATABASE}")
    target.mkdir(mode=0o700, parents=True, exist_ok=True)
    (target / MANIFEST).unlink(missing_ok=True)
    source, copy = LocalArtifacts(data / ARTIFACTS), LocalArtifacts(target / ARTIFACTS)
    _copy_blobs(source, copy, (blob.digest for blob in source.blobs()))
    lost: dict[str, str] = {}
    for _ in range(TRIES):
        _copy_database(data / DATABASE, target / DATABASE)
        named = named_digests(target / DATABASE)
        before, lost = lost, _copy_blobs(source, copy, named)
        # What is missing twice, with two databases naming it, was not deleted in between: it is lost.
        if not lost or lost == before:
            break
        say(f"{len(lost)} artifacts were deleted meanwhile: once more")
    for blob in list(copy.blobs()):
        if blob.digest not in named:
            copy.remove(blob.digest)
    for name in PRIVATE:
        if (data / name).is_file():
            write_private(target / name, (data / name).read_bytes())
    shutil.rmtree(copy.temporary)
    told = {
        "version": 1, "revision": _revision(target / DATABASE), "artifacts": len(named) - len(lost),
        "bytes": sum(blob.n_bytes for blob in copy.blobs()), "lost": lost,
    }  # fmt: skip
    write_private(target / MANIFEST, json.dumps(told, indent=1, sort_keys=True).encode())
    if lost:
        raise ServiceError(f"{len(lost)} artifacts are lost or damaged (see {MANIFEST}): run farfield fsck")
    return told


def restore(target: Path, data: Path, *, say: Said = bool) -> dict[str, Any]:
    """Bring the backup in `target` back into `data`, which must be empty or not exist; return what it holds.

    What ran when the copy was taken is ready again, its attempt not counted. Raises ServiceError; `data` then holds no
    database, and may be removed.
    """
    if not (target / MANIFEST).is_file():
        raise ServiceError(f"{target} is no complete backup: it has no {MANIFEST}")
    if data.exists() and any(data.iterdir()):
        raise ServiceError(f"{data} is not empty: restore into a folder that is")
    data.mkdir(mode=0o700, parents=True, exist_ok=True)
    told = json.loads((target / MANIFEST).read_text())
    _check_database(target / DATABASE)
    source, copy = LocalArtifacts(target / ARTIFACTS), LocalArtifacts(data / ARTIFACTS)
    lost = _copy_blobs(source, copy, named_digests(target / DATABASE))
    damaged = {digest: why for digest, why in lost.items() if digest not in told["lost"]}
    if damaged:
        raise ServiceError(f"the backup is damaged: {len(damaged)} artifacts, the first is {min(damaged)}")
    for name in PRIVATE:
        if (target / name).is_file():
            write_private(data / name, (target / name).read_bytes())
    temporary = data / f"{DATABASE}.part"
    _copy_database(target / DATABASE, temporary)
    with closing(sqlite3.connect(temporary, isolation_level=None)) as connection:  # of any version of the tables
        handed = connection.execute(
            "UPDATE shard SET state = 'ready', attempt = attempt - 1, lease_until = NULL WHERE state = 'running'"
        ).rowcount
    _sync(temporary)
    temporary.replace(data / DATABASE)
    sync_folder(data)
    say(f"{handed} shards that ran are ready again")
    return {**told, "handed_back": handed}


def named_digests(database: Path) -> set[str]:
    """Return every digest that a row of the database refers to; it may be of an older version of the tables."""
    found: set[str] = set()
    with closing(sqlite3.connect(f"file:{database.resolve()}?mode=ro", uri=True)) as connection:
        for column in references():
            known = {row[1] for row in connection.execute(f'PRAGMA table_info("{column.table.name}")')}
            if column.name in known:
                rows = connection.execute(f'SELECT DISTINCT "{column.name}" FROM "{column.table.name}"')
                found |= {row[0] for row in rows if row[0] is not None}
    return found


def _copy_blobs(source: LocalArtifacts, copy: LocalArtifacts, digests: Iterator[str] | set[str]) -> dict[str, str]:
    """Copy what is not there yet; return which could not be copied, and why."""
    lost = {}
    for digest in sorted(digests) if isinstance(digests, set) else digests:
        if copy.has(digest):
            continue
        temporary = copy.temporary / digest
        try:
            with source.local(digest) as path:
                shutil.copyfile(path, temporary)
            if file_digest(temporary) != digest:
                raise ArtifactDamaged(digest)
        except ArtifactDamaged:  # which is an ArtifactMissing, too
            lost[digest] = "damaged"
        except (ArtifactMissing, FileNotFoundError):
            lost[digest] = "missing"
        else:
            copy.put_file(temporary, digest)
            continue
        temporary.unlink(missing_ok=True)
    return lost


def _copy_database(source: Path, target: Path) -> None:
    """Take SQLite's online backup: the writers of `source` go on meanwhile."""
    temporary = target.with_name(target.name + ".new")
    for suffix in ("", "-wal", "-shm"):
        temporary.with_name(temporary.name + suffix).unlink(missing_ok=True)
    os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
    with closing(sqlite3.connect(source, timeout=30.0)) as here, closing(sqlite3.connect(temporary)) as there:
        here.backup(there)  # all pages in one step: a snapshot
        there.execute("PRAGMA journal_mode = DELETE")  # one file, without a log beside it
    for suffix in ("-wal", "-shm"):
        target.with_name(target.name + suffix).unlink(missing_ok=True)
    temporary.replace(target)
    _sync(target)


def _check_database(path: Path) -> None:
    with closing(sqlite3.connect(f"file:{path.resolve()}?mode=ro", uri=True)) as connection:
        try:
            said = connection.execute("PRAGMA integrity_check").fetchone()[0]
        except sqlite3.DatabaseError as error:
            said = str(error)
    if said != "ok":
        raise ServiceError(f"the backup's database is damaged: {said}")


def _revision(path: Path) -> str:
    with closing(sqlite3.connect(path)) as connection:
        return str(connection.execute("SELECT version_num FROM alembic_version").fetchone()[0])


def write_private(path: Path, content: bytes) -> None:
    """Write a file that is only for its owner (0600) and that survives a power cut; a reader never sees half of it."""
    temporary = path.with_name(path.name + ".part")
    temporary.unlink(missing_ok=True)
    with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)
    sync_folder(path.parent)


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())
    sync_folder(path.parent)
