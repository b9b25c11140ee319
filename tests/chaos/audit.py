"""What must be true of a job that has ended, whatever happened on the way: read from its rows, events and blobs."""

import hashlib
from collections import Counter
from typing import Any

import sqlalchemy as sa
from chaos.cluster import Cluster
from farfield.stages import Stage
from farfield.store import events, jobs
from farfield.store.engine import read
from farfield.store.tables import shard, stage

ORDER = ("planning", "running", "merging", "reporting", "done")


def audit(cluster: Cluster, job_id: str, expected: dict[str, str]) -> list[dict[str, Any]]:
    """Assert that the job is done, every stage advanced once, no effect is doubled, and the bytes are the expected ones.

    Returns its events. `expected`: the digest of each stage's artifact.
    """
    row = jobs.get(cluster.engine, cluster.tenant_id, job_id)
    with read(cluster.engine) as tx:
        found = events.after(tx, job_id, 0, 100_000)
        stages = tx.execute(sa.select(stage).where(stage.c.job_id == job_id).order_by(stage.c.ordinal)).all()
        shards = tx.execute(sa.select(shard).where(shard.c.job_id == job_id)).all()
    assert (row.state, row.verdict) == ("done", "valid"), (row.state, row.verdict, row.error)
    assert [e["seq"] for e in found] == list(range(1, row.event_seq + 1)), "event numbers have gaps"

    moves = Counter((e["data"]["stage"], e["data"]["state"]) for e in found if e["kind"] == "stage")
    assert set(moves.values()) == {1}, f"stages moved twice: {[m for m, n in moves.items() if n > 1]}"
    ends = Counter(e["data"]["state"] for e in found if e["kind"] == "job")
    assert ends == {"queued": 1, "running": 1, "done": 1}
    done = Counter(
        (e["data"]["stage"], e["data"]["kind"], e["data"]["ordinal"])
        for e in found if e["kind"] == "shard" and e["data"]["state"] == "done"
    )  # fmt: skip
    assert set(done.values()) == {1}, f"shards ended twice: {[s for s, n in done.items() if n > 1]}"
    assert set(done) == {(s.name, h.kind, h.ordinal) for s in stages for h in shards if h.stage_id == s.id}
    assert {h.state for h in shards} == {"done"}
    over = [
        (h.kind, h.need_bytes >> 20, h.peak_bytes >> 20) for h in shards if h.need_bytes and h.peak_bytes > h.need_bytes
    ]
    assert not over, f"shards took more memory than they had stated: {over}"

    for s in stages:
        mine = [h for h in shards if h.stage_id == s.id and h.kind == "run"]
        assert s.state in ("done", "skipped") and s.n_shards == s.n_done == len(mine), s.name
    made = {s.name: s.artifact_digest for s in stages}
    differing = [name for name in map(str, Stage) if made[name] != expected[name]]
    assert not differing, f"bytes differ from the first of these on: {differing}"
    final = made[str(Stage.PLACEMENTDB)]
    with (cluster.artifacts / final[:2] / final).open("rb") as file:
        assert hashlib.file_digest(file, "sha256").hexdigest() == final
    return found
