"""Blobs in a folder and in a bucket: the same promises, whatever breaks."""

import hashlib
import os
import subprocess
import sys
import time
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import botocore.exceptions
import pytest
from farfield.errors import ArtifactDamaged, ArtifactMissing, ServiceError, StoreUnavailable
from farfield.store.artifacts import open_artifacts
from farfield.store.copies import Copies
from hypothesis import given, settings
from hypothesis import strategies as st


def sha(data):
    return hashlib.sha256(data).hexdigest()


def whole(artifacts, digest):
    return b"".join(artifacts.stream(digest))


def other_machine(artifacts, folder):
    """The same bucket seen from a machine that has no copies."""
    return open_artifacts(f"s3://{artifacts.bucket}/{artifacts.prefix}", cache=folder)


def test_a_blob_is_what_was_put(artifacts, tmp_path):
    data = os.urandom(3 << 20)
    digest = artifacts.put(data)
    assert digest == sha(data) == artifacts.put(memoryview(data))
    assert artifacts.has(digest)
    assert artifacts.n_bytes(digest) == len(data)
    assert bytes(artifacts.buffer(digest)) == data == whole(artifacts, digest)
    with artifacts.local(digest) as path:
        assert path.read_bytes() == data
    for start, stop in ((0, 1), (7, 7), (1 << 20, (1 << 20) + 3), (5, None), (len(data) - 1, len(data))):
        assert b"".join(artifacts.stream(digest, start, stop)) == data[start:stop]
    file = artifacts.temporary / "written"
    file.write_bytes(data[:100])
    small = artifacts.put_file(file)
    assert not file.exists()
    assert [(b.digest, b.n_bytes) for b in artifacts.blobs()] == sorted([(digest, len(data)), (small, 100)])
    assert all(abs(b.stored_at - time.time()) < 60 for b in artifacts.blobs())
    artifacts.remove(digest)
    artifacts.remove(digest)
    assert not artifacts.has(digest)
    with pytest.raises(ArtifactMissing):
        artifacts.buffer(digest)
    assert bytes(artifacts.buffer(artifacts.put(b""))) == b""
    artifacts.check()


@pytest.mark.parametrize("name", ["../../etc/passwd", "", "A" * 64, "0" * 63, "0" * 64 + "\n"])
def test_a_name_from_outside_is_never_a_path(artifacts, name):
    for ask in (
        artifacts.has,
        artifacts.n_bytes,
        artifacts.buffer,
        artifacts.remove,
        lambda n: next(artifacts.stream(n)),
    ):
        with pytest.raises(ArtifactMissing):
            ask(name)


def test_what_is_damaged_is_no_input(artifacts, tmp_path):
    data = os.urandom(100_000)
    digest = artifacts.put(data)
    altered = bytes([data[0] ^ 1]) + data[1:]
    if hasattr(artifacts, "bucket"):
        artifacts.client.put_object(Bucket=artifacts.bucket, Key=f"{artifacts.prefix}sha256/{digest}", Body=altered)
        artifacts = other_machine(artifacts, tmp_path / "other")
    else:
        assert bytes(artifacts.buffer(digest)) == data  # a hash that was right once says nothing about what follows
        artifacts.path(digest).write_bytes(altered)
    for ask in (artifacts.buffer, lambda d: artifacts.local(d).__enter__(), lambda d: whole(artifacts, d)):
        with pytest.raises(ArtifactDamaged):
            ask(digest)


def test_many_that_put_and_read_the_same_blob_at_once(artifacts):
    data = os.urandom(6 << 20)  # of two parts
    with ThreadPoolExecutor(6) as pool:
        digests = set(pool.map(lambda _: artifacts.put(data), range(6)))
        assert {hashlib.sha256(b).hexdigest() for b in pool.map(artifacts.buffer, list(digests) * 6)} == digests
    assert [b.digest for b in artifacts.blobs()] == [sha(data)]


def test_checkpoints_are_found_by_the_next_and_gone_when_done(artifacts, tmp_path):
    with artifacts.checkpoint("run-1") as path:
        assert not path.exists()
        path.write_bytes(b"half")
    if hasattr(artifacts, "bucket"):
        artifacts = other_machine(artifacts, tmp_path / "other")
    with artifacts.checkpoint("run-1") as path:
        assert path.read_bytes() == b"half"
    assert artifacts.drop_old_checkpoints(3600.0) == 0
    artifacts.drop_checkpoint("run-1")
    with artifacts.checkpoint("run-1") as path:
        assert not path.exists()
    with artifacts.checkpoint("run-2") as path:
        path.write_bytes(b"x")
    assert artifacts.drop_old_checkpoints(-5.0) == 1


def test_a_store_must_be_one_that_we_know(tmp_path):
    for url in ("gs://bucket", "s3://", "s3:///prefix"):
        with pytest.raises(ServiceError):
            open_artifacts(url, cache=tmp_path)


# S3 ---------------------------------------------------------------------------------------------------------------


@pytest.fixture
def remote(bucket, tmp_path):
    store = open_artifacts(bucket, cache=tmp_path / "cache", cache_bytes=1 << 20)
    store.part_bytes = 5 << 20
    return store


def test_an_upload_that_breaks_leaves_nothing(remote, monkeypatch):
    sent, plain = [], remote.client.upload_part

    def upload_part(**words):
        sent.append(words["PartNumber"])
        if len(sent) == 2:
            raise botocore.exceptions.EndpointConnectionError(endpoint_url="http://away")
        return plain(**words)

    monkeypatch.setattr(remote.client, "upload_part", upload_part)
    data = os.urandom(12 << 20)
    with pytest.raises(StoreUnavailable):
        remote.put(data)
    assert not remote.has(sha(data))
    assert "Uploads" not in remote.client.list_multipart_uploads(Bucket=remote.bucket)
    assert remote.put(data) == sha(data)
    assert sent == [1, 2, 1, 2, 3]


def test_a_connection_that_breaks_is_taken_up_where_it_broke(remote, monkeypatch):
    data = os.urandom(3 << 20)
    digest = remote.put(data)
    asked, plain = [], remote.client.get_object

    class Breaking:
        def __init__(self, body):
            self.body = body

        def iter_chunks(self, size):
            yield self.body.read(700_000)
            raise botocore.exceptions.ResponseStreamingError(error="reset")

    def get_object(**words):
        asked.append(words["Range"])
        found = plain(**words)
        return {**found, "Body": Breaking(found["Body"])} if len(asked) < 4 else found

    monkeypatch.setattr(remote.client, "get_object", get_object)
    assert bytes(remote.buffer(digest)) == data
    assert [a.split("-")[0] for a in asked] == ["bytes=0", "bytes=700000", "bytes=1400000", "bytes=2100000"]


def test_a_damaged_copy_is_fetched_again(remote, tmp_path):
    data = os.urandom(50_000)
    digest = remote.put(data)
    assert bytes(remote.buffer(digest)) == data
    remote.copies.path(digest).write_bytes(b"spoilt")
    assert bytes(remote.buffer(digest)) == data
    remote.copies.path(digest).write_bytes(b"spoilt")
    assert b"".join(remote.stream(digest, 5, 90)) == data[5:90]


def test_a_store_that_is_away_is_no_fault_of_a_job(remote, monkeypatch, tmp_path):
    digest = remote.put(b"here")
    away = open_artifacts("s3://no-such-bucket/x", cache=tmp_path / "other")
    for ask in (away.check, lambda: away.put(b"x" * 10), lambda: list(away.blobs())):
        with pytest.raises(StoreUnavailable):
            ask()
    monkeypatch.setenv("AWS_ENDPOINT_URL_S3", "http://127.0.0.1:9")
    monkeypatch.setattr(
        "farfield.store.s3._CONFIG", __import__("botocore.config").config.Config(retries={"max_attempts": 0})
    )
    gone = open_artifacts(f"s3://{remote.bucket}/{remote.prefix}", cache=tmp_path / "third")
    for ask in (gone.check, lambda: gone.has(digest), lambda: gone.buffer(digest), lambda: gone.put(b"y")):
        with pytest.raises(StoreUnavailable) as caught:
            ask()
        assert "127.0.0.1" not in str(caught.value)


def test_a_dead_process_leaves_no_files_behind(remote, tmp_path):
    code = """
import os, sys, time
from pathlib import Path
from farfield.store.artifacts import open_artifacts
store = open_artifacts(sys.argv[1], cache=Path(sys.argv[2]))
(store.temporary / "half").write_bytes(b"x" * 1000)
print(store.temporary, flush=True)
time.sleep(60)
"""
    words = [sys.executable, "-c", code, f"s3://{remote.bucket}/p", str(tmp_path / "cache")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        folder = Path(process.stdout.readline().strip())
        other_machine(remote, tmp_path / "cache")
        assert (folder / "half").exists()  # it lives: its files are its own
        process.kill()
        process.wait()
    other_machine(remote, tmp_path / "cache")
    assert not folder.exists()
    assert remote.temporary.exists()


# Copies -----------------------------------------------------------------------------------------------------------


class Far:
    """A store of made-up blobs that counts what is fetched."""

    def __init__(self, folder, max_bytes, seconds=0.0):
        self.blobs, self.fetched, self.seconds = {}, [], seconds
        self.copies = Copies(folder, max_bytes, size=lambda d: len(self.blobs[d]), fetch=self._fetch)

    def add(self, data):
        self.blobs[sha(data)] = data
        return sha(data)

    def _fetch(self, digest, file):
        self.fetched.append(digest)
        time.sleep(self.seconds)
        file.write(self.blobs[digest])


@settings(max_examples=40)
@given(st.lists(st.integers(0, 7), max_size=30), st.integers(1, 8))
def test_the_copies_are_those_used_last_that_fit(uses, max_blobs):
    """Twin: an ordered dict that forgets its oldest."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        far = Far(Path(folder), max_bytes=max_blobs * 10)
        digests = [far.add(f"blob {i:5}".encode()[:10]) for i in range(8)]
        kept: OrderedDict[str, None] = OrderedDict()
        expected = []
        for i in uses:
            digest = digests[i]
            if digest not in kept:
                expected.append(digest)
                while len(kept) >= max_blobs:
                    kept.popitem(last=False)
            kept[digest] = None
            kept.move_to_end(digest)
            far.copies.open(digest).close()
            assert far.copies.n_bytes() <= max_blobs * 10
        assert far.fetched == expected
        assert {p.name for p in Path(folder).glob("??/*")} == set(kept)


def test_a_copy_in_use_is_never_removed_and_the_newest_unused_one_goes_instead(tmp_path):
    far = Far(tmp_path, max_bytes=30)
    first, second, third, fourth = (far.add(f"blob {i:5}".encode()) for i in range(4))
    held = far.copies.open(first)  # the oldest
    for digest in (second, third, fourth):
        far.copies.open(digest).close()
    assert far.copies.path(first).exists()
    assert not far.copies.path(second).exists()
    held.close()
    far.copies.open(second).close()
    assert not far.copies.path(first).exists()
    assert far.copies.n_bytes() <= 30


def test_a_map_holds_its_copy_and_so_does_another_process_until_it_is_killed(remote, tmp_path):
    kept = remote.put(os.urandom(300_000))
    mapped = remote.buffer(kept)
    code = """
import sys, time
from pathlib import Path
from farfield.store.artifacts import open_artifacts
with open_artifacts(sys.argv[1], cache=Path(sys.argv[2]), cache_bytes=1 << 20).local(sys.argv[3]):
    print("holds", flush=True)
    time.sleep(60)
"""
    theirs = remote.put(os.urandom(300_000))
    words = [sys.executable, "-c", code, f"s3://{remote.bucket}/{remote.prefix}", str(tmp_path / "cache"), theirs]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "holds\n"
        for _ in range(4):
            remote.buffer(remote.put(os.urandom(400_000)))
            assert remote.copies.n_bytes() <= 1 << 20
        assert remote.copies.path(kept).exists()
        assert remote.copies.path(theirs).exists()
        process.kill()
        process.wait()
    del mapped
    for _ in range(3):
        remote.buffer(remote.put(os.urandom(400_000)))
    assert not remote.copies.path(kept).exists()
    assert not remote.copies.path(theirs).exists()
    assert remote.has(kept)


def test_one_fetches_while_the_others_wait(tmp_path):
    far = Far(tmp_path, max_bytes=1000, seconds=0.02)
    digests = [far.add(os.urandom(50)) for _ in range(5)]
    with ThreadPoolExecutor(8) as pool:
        for file in pool.map(far.copies.open, digests * 8):
            file.close()
    assert sorted(far.fetched) == sorted(digests)


def test_readers_and_evictions_at_once_never_meet_a_torn_copy(tmp_path):
    far = Far(tmp_path, max_bytes=120)
    blobs = [os.urandom(50) for _ in range(6)]
    digests = [far.add(b) for b in blobs]

    def read(i):
        with far.copies.open(digests[i % 6]) as file:
            return file.read() == blobs[i % 6]

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(read, range(200)))
