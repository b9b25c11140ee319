"""Blobs in an S3 bucket, or in anything that speaks its protocol, under `PREFIX/sha256/DIGEST`.

Put      Conditional ("if there is none") and with its SHA-256, which the store checks; parts above PART_BYTES. A put that
         was interrupted leaves nothing under the name.
Read     Whole blobs through a bounded folder of local copies, hashed as they arrive; a connection that breaks is taken
         up where it broke. Ranges straight from the bucket.
Access   Endpoint, region and credentials are boto3's own: AWS_ENDPOINT_URL_S3, AWS_REGION, AWS_ACCESS_KEY_ID..., a file,
         or the role of the machine.
Processes  The folder of copies is shared by the processes of a machine; each writes below a folder of its own in `tmp`,
         locked for as long as it lives, and removes those of dead ones when it starts.
"""

import base64
import contextlib
import fcntl
import hashlib
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import boto3
import botocore.exceptions
from botocore.config import Config

from farfield.errors import ArtifactDamaged, ArtifactMissing, ServiceError, StoreUnavailable
from farfield.store.artifacts import (
    CACHE_BYTES,
    CHECKPOINT_S,
    CHUNK_BYTES,
    Artifacts,
    Blob,
    checked,
    file_digest,
    mapped,
    pieces,
)  # fmt: skip
from farfield.store.copies import Copies

PART_BYTES = 64 << 20  # 10,000 parts are allowed: blobs of up to 640 GB
UPLOAD_EVERY_S = 5.0  # a checkpoint that changed is put again after so long
BREAKS = 5  # of a connection, in a row without a byte between them
_CONFIG = Config(
    connect_timeout=5, read_timeout=30, tcp_keepalive=True, retries={"mode": "standard", "max_attempts": 5},
    # Only what we ask for: not every server that speaks the protocol knows the newer checksums.
    request_checksum_calculation="when_required", response_checksum_validation="when_required",
)  # fmt: skip
_BROKEN = (botocore.exceptions.HTTPClientError, botocore.exceptions.IncompleteReadError)


class S3Artifacts(Artifacts):
    """The blobs of "s3://bucket/prefix", with copies of at most `cache_bytes` in the folder `cache`."""

    def __init__(self, url: str, *, cache: Path, cache_bytes: int = CACHE_BYTES, part_bytes: int = PART_BYTES) -> None:
        self.bucket, _, prefix = url.removeprefix("s3://").partition("/")
        if not self.bucket:
            raise ServiceError(f"{url} names no bucket: write s3://bucket/prefix")
        self.prefix = f"{prefix.strip('/')}/" if prefix.strip("/") else ""
        self.part_bytes = part_bytes
        self.client: Any = boto3.client("s3", config=_CONFIG)
        self.copies = Copies(cache, cache_bytes, size=self.n_bytes, fetch=self._fetch)
        self.temporary, self._mine = _own_folder(cache / "tmp")

    def has(self, digest: str) -> bool:
        checked(digest)
        try:
            self.n_bytes(digest)
        except ArtifactMissing:
            return False
        return True

    def n_bytes(self, digest: str) -> int:
        with self._asking(digest):
            told = self.client.head_object(Bucket=self.bucket, Key=self._key(digest))
        return int(told["ContentLength"])

    def put(self, data: Any) -> str:
        view = memoryview(data).cast("B")
        digest = hashlib.sha256(view).hexdigest()
        if not self.has(digest):
            with tempfile.NamedTemporaryFile(dir=self.temporary) as file:
                file.write(view)
                file.flush()
                self._send(file, digest)
        return digest

    def put_file(self, path: Path, digest: str | None = None) -> str:
        if digest is None:
            digest = file_digest(path)
        if not self.has(digest):
            with path.open("rb") as file:
                self._send(file, digest)
        self.copies.adopt(path, digest)
        return digest

    def stream(self, digest: str, start: int = 0, stop: int | None = None) -> Iterator[bytes]:
        if start == 0 and stop is None:
            with self.copies.open(digest) as file:
                yield from pieces(file, 0, None)
            return
        copy = self.copies.find(digest)
        if copy is not None:
            with copy:
                yield from pieces(copy, start, stop)
            return
        end = self.n_bytes(digest) if stop is None else stop
        yield from self._range(digest, start, end)

    def buffer(self, digest: str) -> Any:
        with self.copies.open(digest) as file:
            return mapped(file)  # holds the file open, and so its lock

    @contextmanager
    def local(self, digest: str) -> Iterator[Path]:
        with self.copies.open(digest):
            yield self.copies.path(digest)

    def remove(self, digest: str) -> None:
        with self._asking(digest):
            self.client.delete_object(Bucket=self.bucket, Key=self._key(digest))
        self.copies.drop(digest)

    def blobs(self) -> Iterator[Blob]:
        for name, entry in self._listed("sha256/"):
            yield Blob(name, int(entry["Size"]), entry["LastModified"].timestamp())

    @contextmanager
    def checkpoint(self, name: str) -> Iterator[Path]:
        key, path = f"{self.prefix}checkpoints/{name}", self.temporary / f"{threading.get_ident()}-{name}"
        with contextlib.suppress(ArtifactMissing), self._asking(name):
            path.write_bytes(self.client.get_object(Bucket=self.bucket, Key=key)["Body"].read())
        ended, seen = threading.Event(), _stamp(path)

        def keep() -> None:
            nonlocal seen
            last = False
            while not last:
                last = ended.wait(UPLOAD_EVERY_S)  # and once more at the end
                stamp = _stamp(path)
                # A store that does not answer costs the checkpoint, not the shard.
                with contextlib.suppress(StoreUnavailable, FileNotFoundError):
                    if stamp != seen:
                        with self._asking(name):
                            self.client.put_object(Bucket=self.bucket, Key=key, Body=path.read_bytes())
                        seen = stamp

        thread = threading.Thread(target=keep, name="checkpoint", daemon=True)
        thread.start()
        try:
            yield path
        finally:
            ended.set()
            thread.join()
            path.unlink(missing_ok=True)

    def drop_checkpoint(self, name: str) -> None:
        with self._asking(name):
            self.client.delete_object(Bucket=self.bucket, Key=f"{self.prefix}checkpoints/{name}")

    def drop_old_checkpoints(self, seconds: float = CHECKPOINT_S) -> int:
        old = [n for n, e in self._listed("checkpoints/") if time.time() - e["LastModified"].timestamp() > seconds]
        for name in old:
            self.drop_checkpoint(name)
        return len(old)

    def make(self) -> None:
        region = self.client.meta.region_name
        where = {"CreateBucketConfiguration": {"LocationConstraint": region}} if region != "us-east-1" else {}
        with self._asking(""):
            try:
                self.client.create_bucket(Bucket=self.bucket, **where)
            except botocore.exceptions.ClientError as error:
                if error.response.get("Error", {}).get("Code") not in (
                    "BucketAlreadyOwnedByYou",
                    "BucketAlreadyExists",
                ):
                    raise

    def check(self) -> None:
        with self._asking(""):
            self.client.head_bucket(Bucket=self.bucket)

    def clear_temporary(self) -> None:
        _sweep(self.copies.root / "tmp")
        self.drop_old_checkpoints()

    def _key(self, digest: str) -> str:
        return f"{self.prefix}sha256/{checked(digest)}"

    def _listed(self, below: str) -> Iterator[tuple[str, Any]]:
        start = f"{self.prefix}{below}"
        with self._asking(""):
            for page in self.client.get_paginator("list_objects_v2").paginate(Bucket=self.bucket, Prefix=start):
                for entry in page.get("Contents", ()):
                    yield entry["Key"].removeprefix(start), entry

    def _send(self, file: Any, digest: str) -> None:
        """Put the blob unless it has come meanwhile: then the bytes are the same."""
        where = {"Bucket": self.bucket, "Key": self._key(digest)}
        size = os.fstat(file.fileno()).st_size
        with self._asking(digest), _already_there():
            file.seek(0)
            if size <= self.part_bytes:
                self.client.put_object(**where, Body=file, IfNoneMatch="*", ChecksumSHA256=_base64(digest))
                return
            upload = self.client.create_multipart_upload(**where, ChecksumAlgorithm="SHA256")["UploadId"]
            try:
                parts = []
                for number, start in enumerate(range(0, size, self.part_bytes), 1):
                    file.seek(start)
                    body = file.read(self.part_bytes)
                    sum_ = _base64(hashlib.sha256(body).hexdigest())
                    told = self.client.upload_part(
                        **where, UploadId=upload, PartNumber=number, Body=body, ChecksumSHA256=sum_
                    )
                    parts.append({"PartNumber": number, "ETag": told["ETag"], "ChecksumSHA256": sum_})
                self.client.complete_multipart_upload(
                    **where, UploadId=upload, MultipartUpload={"Parts": parts}, IfNoneMatch="*"
                )
            except BaseException:
                with contextlib.suppress(Exception):  # the bucket's rule for incomplete uploads removes what stays
                    self.client.abort_multipart_upload(**where, UploadId=upload)
                raise

    def _fetch(self, digest: str, file: Any) -> None:
        """Write the blob into the file. Raises ArtifactMissing, ArtifactDamaged, StoreUnavailable."""
        found = hashlib.sha256()
        for data in self._range(digest, 0, os.fstat(file.fileno()).st_size):
            found.update(data)
            file.write(data)
        if found.hexdigest() != digest:
            raise ArtifactDamaged(digest)

    def _range(self, digest: str, start: int, stop: int) -> Iterator[bytes]:
        """Yield the bytes [start, stop) from the bucket, over as many connections as it takes."""
        at, broken = start, 0
        while at < stop:
            with self._asking(digest):
                body = self.client.get_object(Bucket=self.bucket, Key=self._key(digest), Range=f"bytes={at}-{stop - 1}")
                try:
                    for data in body["Body"].iter_chunks(CHUNK_BYTES):
                        at, broken = at + len(data), 0
                        yield data
                except _BROKEN:
                    broken += 1
                    if broken > BREAKS:
                        raise
                    continue
            if at < stop:
                raise ArtifactDamaged(digest)

    @contextmanager
    def _asking(self, digest: str) -> Iterator[None]:
        try:
            yield
        except botocore.exceptions.ClientError as error:
            status = error.response.get("ResponseMetadata", {}).get("HTTPStatusCode")
            code = error.response.get("Error", {}).get("Code", status)
            if status == 404 and code != "NoSuchBucket" and digest:
                raise ArtifactMissing(digest) from error
            raise StoreUnavailable(f"the artifact store refuses: {code}") from error
        except botocore.exceptions.BotoCoreError as error:
            raise StoreUnavailable(f"the artifact store does not answer: {type(error).__name__}") from error


@contextmanager
def _already_there() -> Iterator[None]:
    """Take the store's "there is one" (412; 409: it is just being put) for success."""
    try:
        yield
    except botocore.exceptions.ClientError as error:
        if error.response.get("ResponseMetadata", {}).get("HTTPStatusCode") not in (409, 412):
            raise


def _base64(digest: str) -> str:
    return base64.b64encode(bytes.fromhex(digest)).decode()


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    return status.st_ino, status.st_mtime_ns


def _own_folder(parent: Path) -> tuple[Path, Any]:
    """Return (a new folder below `parent`, its lock, which ends with this process); clear up after dead processes."""
    with (parent.parent / "locks" / "folders").open("w") as alone:
        fcntl.flock(alone, fcntl.LOCK_EX)
        _sweep(parent)
        folder = Path(tempfile.mkdtemp(dir=parent, prefix="process-"))
        mine = (folder / ".lock").open("w")
        fcntl.flock(mine, fcntl.LOCK_EX)
    return folder, mine


def _sweep(parent: Path) -> None:
    for lock in parent.glob("process-*/.lock"):
        with contextlib.suppress(OSError), lock.open("r+") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(lock.parent, ignore_errors=True)
