"""Workers that are processes, at once on one database: nothing is lost, nothing happens twice."""

import subprocess
import sys
from pathlib import Path

import sqlalchemy as sa
from farfield.store import events, shards
from farfield.store.engine import read
from farfield.store.tables import shard, stage

TESTS = Path(__file__).parents[1]
RACERS, JOBS = 3, 3


def test_workers_of_many_processes_lose_nothing_and_advance_once(in_process):
    """Two last shards that commit at once must not each take the other for unfinished, nor both move the job on."""
    calm, message = in_process.submit(skip=False, shards=7)
    in_process.run(message)
    raced = [in_process.submit(skip=False, shards=7, job=number)[0] for number in range(JOBS)]
    command = [sys.executable, str(TESTS / "racing.py"), in_process.settings.database_url]
    racers = [
        subprocess.Popen([*command, str(in_process.settings.artifacts), str(seed)], stderr=subprocess.PIPE, text=True)
        for seed in range(RACERS)
    ]
    told = [racer.communicate(timeout=150)[1] for racer in racers]
    assert [racer.returncode for racer in racers] == [0] * RACERS, told
    with read(in_process.engine) as tx:
        # A deadlock or a locked database would have cost an attempt.
        assert set(tx.scalars(sa.select(shard.c.attempt))) == {1}
        assert len(set(tx.scalars(sa.select(shard.c.worker)))) > 2
        counts = {
            job: sorted(
                tuple(row)
                for row in tx.execute(
                    sa.select(stage.c.name, shard.c.kind, sa.func.count()).join(shard, shard.c.stage_id == stage.c.id)
                    .where(shard.c.job_id == job).group_by(stage.c.name, shard.c.kind)
                )
            )
            for job in (calm, *raced)
        }  # fmt: skip
        assert all(counts[job] == counts[calm] for job in raced)
        for job in raced:
            found = events.after(tx, job, 0, 10_000)
            assert [e["seq"] for e in found] == list(range(1, len(found) + 1))
            moves = [(e["data"]["stage"], e["data"]["state"]) for e in found if e["kind"] == "stage"]
            assert len(moves) == len(set(moves))
            assert found[-1]["data"]["state"] == "done"
        # What these processes took at most, which ran nothing else, is what their shards had stated, or less.
        took = tx.execute(
            sa.select(shard.c.kind, shard.c.need_bytes, shard.c.peak_bytes)
            .where(shard.c.job_id.in_(raced), shard.c.cached.is_(False), shard.c.need_bytes > 0)
        ).all()  # fmt: skip
        assert len(took) > 30 * JOBS
        assert [row for row in took if not 0 < row.peak_bytes <= row.need_bytes] == []
    assert all(in_process.job(job).verdict == "valid" for job in raced)


def test_bytes_past_32_bits_are_counted(in_process):
    """PostgreSQL's INTEGER ends at 2 GiB: drivers that guess a type from one value meet it in production."""
    job_id, message = in_process.submit()
    held = shards.claim(in_process.engine, message.shard_id, worker="large")
    digest = in_process.artifacts.put(b'{"skip": null, "shards": ["all"]}')
    large = 5 << 30
    assert shards.commit(
        in_process.engine, held, digest=digest, n_bytes=large, key=None, seconds=0.0, peak_bytes=large
    ) == "last"  # fmt: skip
    assert in_process.stages(job_id)["scene"]["peak_bytes"] == large
