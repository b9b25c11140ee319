"""Many short shards as one: claimed, renewed, committed and handed back in one transaction each.

Problem  A shard's own rows cost four transactions: of 10^5 shards that take a few milliseconds each, that is most of the work.
Method   Who claims a shard of a large stage takes the next ones of it along (`shards.claim_group`), computes them in turn and
         commits them together. Each keeps its own claim number, so each has its own fence, and each result its own row.
         Where not all are ours any more, they are committed one by one, and each tells for itself.
         Only what was never tried goes along: after a death every shard that was held is tried alone, so a shard that kills
         its workers takes no attempts of its neighbours but one.
Memory   They run one after the other, so only the first has a host, and counts: for its memory and as one that runs (`fair`).
Cost     Processor time a shard, two workers, toy stage: docs/scheduling.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import sqlalchemy as sa

from farfield.store import shards
from farfield.store.artifacts import Artifacts
from farfield.store.engine import now, read, write
from farfield.store.shards import Claim
from farfield.store.tables import shard


@dataclass(frozen=True, slots=True, kw_only=True)
class Done:
    """A shard of a group whose result is stored; `key`, `seconds` and the like as for `shards.commit`."""

    held: Claim
    digest: str
    n_bytes: int
    key: str | None
    seconds: float
    peak_bytes: int
    cached: bool


def renew(engine: sa.Engine, group: Sequence[Claim], *, lease_s: float) -> bool:
    """Prolong the leases. False: not all are ours any more, stop working on them."""
    if len(group) == 1:
        return shards.renew(engine, group[0], lease_s=lease_s)
    with write(engine) as tx:
        shards.lock_job(tx, group[0].job_id)
        rows = [{**shards.ours(held), "job": held.job_id, "lease": lease_s} for held in group]
        return tx.execute(shards.RENEW, rows).rowcount == len(rows)


def known_results(engine: sa.Engine, tenant_id: str | None, keys: Sequence[str | None]) -> dict[str, sa.Row]:
    """Return `shards.known_result` of those of the keys that have one."""
    with read(engine) as tx:
        asked = {"keys": [key for key in keys if key is not None], "tenant": tenant_id}
        return {row.key: row for row in tx.execute(_KNOWN, asked)}


def commit(engine: sa.Engine, artifacts: Artifacts, done: Sequence[Done]) -> tuple[str, list[Done]]:
    """Write the results of shards of one stage; return (as `shards.commit` says it for the last one, those that were written).

    A result whose blob is gone, or that is ours no more, is not written. Those of which only the blob is gone are the
    caller's to hand back.
    """
    there = [one for one in done if artifacts.has(one.digest)]
    if not there:
        return "lost", []
    outcome = _together(engine, artifacts, there)
    if outcome is not None:
        return outcome, there
    written, last = [], "lost"
    for one in there:
        told = _alone(engine, artifacts, one)
        if told != "lost":
            written.append(one)
            last = told if last != "last" else last
    return last, written


def give_back(engine: sa.Engine, group: Sequence[Claim]) -> int:
    """Make ready again what is still ours and was not computed; no attempt of it. Return how many."""
    if not group:
        return 0
    with write(engine) as tx:
        shards.lock_job(tx, group[0].job_id)
        return tx.execute(_GIVE_BACK, [shards.ours(held) for held in group]).rowcount


class _NotOurs(Exception):
    """Some were taken over. Rolls the transaction back."""


class _Gone(Exception):
    """The same bytes were another job's, which was deleted meanwhile. Rolls the transaction back."""


def _together(engine: sa.Engine, artifacts: Artifacts, done: Sequence[Done]) -> str | None:
    """Commit all, or nothing and return None."""
    first = done[0].held
    try:
        with write(engine) as tx:
            at = tx.execute(shards.LOCKED, {"job": first.job_id}).one_or_none()
            if at is None or at.state != "running":
                return None
            # In order of the digests: else two jobs with the same results could wait for each other.
            blobs = sorted({(one.digest, one.n_bytes) for one in done})
            tx.execute(shards.PUT[tx.dialect.name], [{"new_digest": d, "new_bytes": n} for d, n in blobs])
            if not all(artifacts.has(one.digest) for one in done):
                raise _Gone
            facts = [
                {**shards.ours(one.held), "new_digest": one.digest, "new_key": one.key, "took": one.seconds,
                 "peak": one.peak_bytes, "was_cached": one.cached}
                for one in done
            ]  # fmt: skip
            if tx.execute(shards.COMMIT, facts).rowcount != len(facts):
                raise _NotOurs
            return shards.counted(tx, first, len(done), max(one.peak_bytes for one in done))
    except (_NotOurs, _Gone):
        return None


def _alone(engine: sa.Engine, artifacts: Artifacts, one: Done) -> str:
    def there() -> None:
        if not artifacts.has(one.digest):
            raise _Gone

    try:
        return shards.commit(
            engine, one.held, digest=one.digest, n_bytes=one.n_bytes, key=one.key, seconds=one.seconds,
            peak_bytes=one.peak_bytes, cached=one.cached, check=there,
        )  # fmt: skip
    except _Gone:
        return "lost"


_KNOWN = sa.select(shard.c.key, shard.c.artifact_digest, shard.c.seconds, shard.c.peak_bytes).where(
    shard.c.key.in_(sa.bindparam("keys", expanding=True)), shard.c.tenant_id == sa.bindparam("tenant"),
    shard.c.state == "done", shard.c.artifact_digest.is_not(None),
)  # fmt: skip
_GIVE_BACK = (
    sa.update(shard).where(shards.OURS)
    .values(state="ready", attempt=shard.c.attempt - 1, lease_until=None, ready_at=now(), host=None)
)  # fmt: skip
