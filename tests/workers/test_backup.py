"""A copy taken while jobs run is one moment of the service; what is brought back goes on to the same bytes."""

import json
import threading
from dataclasses import replace

import pytest
import sqlalchemy as sa
from farfield.cli.main import main
from farfield.errors import ServiceError
from farfield.store import collect, fsck, jobs
from farfield.store.artifacts import LocalArtifacts
from farfield.store.backup import backup, restore
from farfield.store.engine import open_engine, read
from farfield.store.progress import standing_still
from farfield.store.tables import shard
from farfield_workers.work import advance


@pytest.fixture
def data(in_process):
    """The folder of the service, with its private files."""
    folder = in_process.artifacts.root.parent
    for name in ("api-key", "secret"):
        (folder / name).write_text(f"the {name}")
    return folder


def _brought_back(bench, folder):
    """Return the same bench over the restored folder."""
    return replace(bench, engine=open_engine(f"sqlite:///{folder / 'farfield.sqlite'}"),
                   artifacts=LocalArtifacts(folder / "artifacts"))  # fmt: skip


def _go_on(bench):
    for job_id in standing_still(bench.engine):  # copied between a commit and the step after it: the reconciler's case
        advance(bench.engine, bench.artifacts, bench.pipeline, bench.settings, job_id)
    bench.go_on()


def test_a_backup_while_jobs_run_is_consistent_and_its_jobs_go_on_to_the_same_bytes(in_process, data, tmp_path):
    running = [in_process.submit(seconds=0.02, shards=number) for number in (10, 12)]
    workers = [threading.Thread(target=in_process.run, args=(message,)) for _, message in running]
    for worker in workers:
        worker.start()
    copies = []
    while any(worker.is_alive() for worker in workers) or len(copies) < 2:
        copies.append(tmp_path / f"copy-{len(copies)}")
        backup(data, copies[-1])
    for worker in workers:
        worker.join()
    expected = [in_process.results(job_id) for job_id, _ in running]
    undone = 0
    for number, copy in enumerate((copies[0], copies[len(copies) // 2], copies[-1])):
        told = restore(copy, tmp_path / f"restored-{number}")
        there = _brought_back(in_process, tmp_path / f"restored-{number}")
        assert not [f for f in fsck.check(there.engine, there.artifacts) if not f.note]
        assert told["lost"] == {}
        undone += sum(there.job(job_id).state != "done" for job_id, _ in running)
        with read(there.engine) as tx:  # what ran is ready, and no attempt was counted
            assert tx.scalar(sa.select(sa.func.count()).where(shard.c.state == "running")) == 0
            assert (tx.scalar(sa.select(sa.func.max(shard.c.attempt)).where(shard.c.state == "ready")) or 0) == 0
        _go_on(there)
        assert [there.results(job_id) for job_id, _ in running] == expected
        there.engine.dispose()
    assert undone, "no copy was taken while a job ran"
    assert (tmp_path / "restored-0" / "api-key").read_text() == "the api-key"
    assert (tmp_path / "restored-0" / "api-key").stat().st_mode & 0o777 == 0o600
    assert copies[0].stat().st_mode & 0o777 == 0o700


def test_a_second_backup_copies_what_is_new_and_drops_what_is_gone(in_process, data, tmp_path):
    first, message = in_process.submit()
    in_process.run(message)
    copy = tmp_path / "copy"
    backup(data, copy)
    before = {blob.digest: (copy / "artifacts" / blob.digest[:2] / blob.digest).stat().st_ino
              for blob in LocalArtifacts(copy / "artifacts").blobs()}  # fmt: skip
    second, message = in_process.submit(shards=3)
    in_process.run(message)
    jobs.delete(in_process.engine, in_process.tenant_id, first, dry_run=False)
    collect.collect(in_process.engine, in_process.artifacts, grace_s=0.0)
    told = backup(data, copy)
    stored = {blob.digest for blob in in_process.artifacts.blobs()}
    copied = {blob.digest for blob in LocalArtifacts(copy / "artifacts").blobs()}
    assert copied == stored != set(before)
    assert told["artifacts"] == len(stored)
    kept = set(before) & copied
    assert kept
    assert all((copy / "artifacts" / d[:2] / d).stat().st_ino == before[d] for d in kept)
    restore(copy, tmp_path / "restored")
    there = _brought_back(in_process, tmp_path / "restored")
    assert there.job(second).state == "done"
    assert fsck.check(there.engine, there.artifacts) == []


def test_a_job_deleted_between_the_two_copies_is_copied_around(in_process, data, tmp_path, monkeypatch):
    from farfield.store import backup as module

    first, message = in_process.submit()
    in_process.run(message)
    second, message = in_process.submit(shards=3)
    in_process.run(message)
    copy_database, times = module._copy_database, []

    def then_delete(source, target):
        copy_database(source, target)
        if not times:
            jobs.delete(in_process.engine, in_process.tenant_id, second, dry_run=False)
            collect.collect(in_process.engine, in_process.artifacts, grace_s=0.0)
        times.append(target)

    # As if all that the second job stored had come after the first pass.
    monkeypatch.setattr(module, "_copy_database", then_delete)
    monkeypatch.setattr(LocalArtifacts, "blobs", lambda self: iter(()))
    backup(data, tmp_path / "copy")
    monkeypatch.undo()
    assert len(times) >= 2
    restore(tmp_path / "copy", tmp_path / "restored")
    there = _brought_back(in_process, tmp_path / "restored")
    assert there.job(first).state == "done"
    assert not [f for f in fsck.check(there.engine, there.artifacts) if not f.note]


def test_what_is_damaged_is_said_on_both_ways_and_nothing_is_overwritten(in_process, data, tmp_path):
    job_id, message = in_process.submit()
    in_process.run(message)
    digest = in_process.stages(job_id)["bake"]["artifact"]
    path = in_process.artifacts.path(digest)
    whole = path.read_bytes()
    backup(data, tmp_path / "good")
    copied = LocalArtifacts(tmp_path / "good" / "artifacts").path(digest)
    copied.write_bytes(b"x" * len(whole))
    with pytest.raises(ServiceError, match="damaged"):
        restore(tmp_path / "good", tmp_path / "restored")
    assert not (tmp_path / "restored" / "farfield.sqlite").exists()
    path.write_bytes(b"x" * len(whole))
    with pytest.raises(ServiceError, match="fsck"):
        backup(data, tmp_path / "bad")
    assert json.loads((tmp_path / "bad" / "backup.json").read_text())["lost"] == {digest: "damaged"}
    path.write_bytes(whole)
    with pytest.raises(ServiceError, match="not empty"):
        restore(tmp_path / "good", data)
    (tmp_path / "good" / "backup.json").unlink()
    with pytest.raises(ServiceError, match="complete"):
        restore(tmp_path / "good", tmp_path / "other")
    with pytest.raises(ServiceError, match="holds no"):
        backup(tmp_path / "nothing", tmp_path / "other")


def test_the_verbs_say_what_they_did_and_end_with_their_codes(in_process, data, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("FARFIELD_DATABASE_URL", raising=False)
    job_id, message = in_process.submit()
    in_process.run(message)
    assert main(["fsck", "--data", str(data)]) == 0
    assert "nothing wrong" in capsys.readouterr().out
    in_process.artifacts.put(b"a stray blob")
    assert main(["gc", "--dry-run", "--json", "--data", str(data)]) == 0
    assert json.loads(capsys.readouterr().out)["removed"] == 1
    assert main(["gc", "--grace-s", "0", "--data", str(data)]) == 0
    assert "1 artifacts removed" in capsys.readouterr().out
    assert main(["backup", str(tmp_path / "copy"), "--data", str(data)]) == 0
    assert main(["restore", str(tmp_path / "copy"), "--data", str(tmp_path / "new")]) == 0
    report = in_process.job(job_id).report_digest
    in_process.artifacts.path(report).unlink()
    capsys.readouterr()
    assert main(["fsck", "--fast", "--data", str(data)]) == 4
    assert f"WRONG missing {report}" in capsys.readouterr().out
    assert main(["fsck", "--repair", "--json", "--data", str(data)]) == 0
    assert json.loads(capsys.readouterr().out)["left"] == []
    assert main(["fsck", "--data", str(tmp_path / "nothing")]) == 3
