"""The collector removes what nothing refers to, and nothing else, whoever races with it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import sqlalchemy as sa
from farfield.store import collect, fsck, jobs, retention, scenes, shards
from farfield.store.artifacts import LocalArtifacts
from farfield.store.engine import open_engine, read, write
from farfield.store.retention import Retention
from farfield.store.tables import artifact, event, job, metadata
from farfield_workers.upkeep import drop_leftovers

TESTS = Path(__file__).parents[1]


def _stored(bench):
    return {blob.digest for blob in bench.artifacts.blobs()}


def _referenced(bench):
    with read(bench.engine) as tx:
        columns = collect.references()
        return {d for c in columns for d in tx.scalars(sa.select(c).where(c.is_not(None)))}


def test_every_column_that_names_an_artifact_counts_as_a_reference():
    named = {(t.name, c.name) for t in metadata.tables.values() for c in t.columns if c.name.endswith("_digest")}
    found = {(c.table.name, c.name) for c in collect.references()}
    # The others are digests of requests and secrets, or of a scene, which has a row of its own.
    others = {(t, c) for t, c in named - found}
    assert {c for _, c in others} <= {
        "request_digest",
        "secret_digest",
        "token_digest",
        "scene_digest",
        "session_digest",
    }
    assert ("scene", "digest") in found


def test_a_collection_removes_what_a_deleted_job_alone_needed_and_says_before_what(in_process):
    kept, message = in_process.submit(shards=3)
    in_process.run(message)
    gone, message = in_process.submit(budget="300 calls", shards=4)
    in_process.run(message)
    stray = in_process.artifacts.put(b"its worker died before the commit")
    jobs.delete(in_process.engine, in_process.tenant_id, gone, dry_run=False)
    would = collect.would_collect(in_process.engine, in_process.artifacts)
    before = _stored(in_process)
    done = collect.collect(in_process.engine, in_process.artifacts, grace_s=0.0)
    assert (done.removed, done.removed_bytes) == (would.removed, would.removed_bytes)
    assert done.removed > 2
    assert stray not in _stored(in_process)
    assert _stored(in_process) == _referenced(in_process) < before
    assert in_process.job(kept).state == "done"
    assert not fsck.check(in_process.engine, in_process.artifacts)


def test_nothing_is_removed_within_the_grace_and_use_ends_the_mark(in_process):
    digest = in_process.artifacts.put(b"shared")
    collect.adopt(in_process.engine, in_process.artifacts)
    assert collect.sweep(in_process.engine, in_process.artifacts, grace_s=3600.0).removed == 0
    with write(in_process.engine) as tx:
        shards.put_artifact(tx, digest, 6)
        assert tx.scalar(sa.select(artifact.c.marked_at).where(artifact.c.digest == digest)) is None
    # Not marked any more: it needs another mark, and another grace.
    assert collect.sweep(in_process.engine, in_process.artifacts, grace_s=0.0).removed == 0
    assert in_process.artifacts.has(digest)


def test_a_result_that_is_collected_between_its_storing_and_its_commit_is_computed_again(in_process, monkeypatch):
    job_id, message = in_process.submit(shards=2)
    swept, commit = [], shards.commit

    def collected_first(engine, held, **result):
        if held.stage == "viewspace" and held.kind == "run" and not swept:
            assert collect.collect(engine, in_process.artifacts, grace_s=0.0).removed >= 1
            assert not in_process.artifacts.has(result["digest"])
            swept.append(result["digest"])
        return commit(engine, held, **result)

    monkeypatch.setattr(shards, "commit", collected_first)
    in_process.run(message)
    assert swept
    assert in_process.job(job_id).state == "done"
    assert in_process.artifacts.has(swept[0])
    assert not fsck.check(in_process.engine, in_process.artifacts)


def _race(url, store, stop):
    def start(act, seed, until):
        command = [sys.executable, str(TESTS / "store_race.py"), act, url, str(store), str(seed), str(until)]
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def end(process):
        out, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        return json.loads(out)

    collectors = [start("collect", seed, stop) for seed in (4, 5)]
    told = [end(user) for user in [start("use", seed, 60) for seed in (1, 2, 3)]]
    stop.touch()
    told += [end(collector) for collector in collectors]
    total = {key: sum(t.get(key, 0) for t in told) for key in ("stored", "found", "refused", "lost", "removed")}
    assert total["lost"] == 0, total
    # It was a race: things were used, and were collected, many times.
    assert (total["stored"], min(total["found"], total["removed"]) >= 5) == (180, True), total
    engine, artifacts = open_engine(url), LocalArtifacts(Path(store))
    assert not [f for f in fsck.check(engine, artifacts) if not f.note]
    collect.collect(engine, artifacts, grace_s=0.0)
    assert not list(artifacts.blobs())
    engine.dispose()


def test_processes_that_use_and_collect_the_same_blobs_lose_none(bench, tmp_path):
    _race(bench.settings.database_url, bench.settings.artifacts, tmp_path / "stop")


def test_the_same_on_postgresql(postgres, postgres_template, tmp_path):
    _race(postgres.new(postgres_template), tmp_path / "artifacts", tmp_path / "stop")


def test_what_killed_processes_left_goes_but_not_the_lock_of_one_that_lives(tmp_path):
    old, young, lock = tmp_path / "shard-old", tmp_path / "young", tmp_path / ".lock"
    old.mkdir()
    for path in (old / "artifact", tmp_path / "upload", young, lock):
        path.write_bytes(b"x")
    for path in (old, tmp_path / "upload", lock):
        os.utime(path, (1.0, 1.0))
    assert drop_leftovers(tmp_path) == 2
    assert set(tmp_path.iterdir()) == {young, lock}


def test_what_is_past_its_time_goes_and_the_end_of_a_stream_stays(in_process):
    job_id, message = in_process.submit()
    in_process.run(message)
    young, message = in_process.submit(budget="300 calls")
    in_process.run(message)
    unused = in_process.artifacts.put(b"a level that nobody placed")
    scenes.add(
        in_process.engine, in_process.tenant_id, digest=unused, name="a", suffix=".glb", n_bytes=26, summary={},
        inspect_digest=unused, inspect_bytes=26,
    )  # fmt: skip
    with write(in_process.engine) as tx:
        tx.execute(sa.update(job).where(job.c.id == job_id).values(finished_at=job.c.finished_at - 3 * 86400))
        tx.execute(sa.update(metadata.tables["scene"]).values(created_at=1.0))
    assert retention.expire(in_process.engine, Retention()) == {"jobs": 0, "events": 0, "scenes": 0}
    done = retention.expire(in_process.engine, Retention(events_days=2, scenes_days=2))
    assert (done["jobs"], done["scenes"]) == (0, 1)
    with read(in_process.engine) as tx:
        left = tx.execute(sa.select(event).where(event.c.job_id == job_id)).all()
    assert [(e.kind, e.data["state"]) for e in left] == [("job", "done")]
    assert not [f for f in fsck.check(in_process.engine, in_process.artifacts) if f.kind == "events"]
    assert retention.expire(in_process.engine, Retention(jobs_days=2))["jobs"] == 1
    assert in_process.job(young).state == "done"
    with pytest.raises(Exception, match=job_id):
        in_process.job(job_id)
