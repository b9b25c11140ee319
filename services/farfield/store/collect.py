"""Remove the artifacts that nothing refers to, and never one that is in use or about to be.

Problem  A blob is written before the row that refers to it is committed, equal bytes of another job are taken over
         without being written, and a job may be deleted at any moment. A collector that looks, then removes, removes what
         was taken into use in between.
Method   Mark    What no row refers to gets `marked_at`. A blob without a row (its worker died before the commit, or has
                 not yet come to it) gets a row, marked from the start: from here on there is one protocol for both.
         Use     Whoever commits a reference first upserts the artifact's row (`shards.put_artifact`): that clears the
                 mark and holds the row. Then, in the same transaction, it checks that the blob is there.
         Sweep   One artifact a transaction. Hold the row; ask again, in a new statement, whether anything refers to it;
                 delete row and blob; commit. Whoever wants to use it meanwhile waits at the row, and then either finds
                 it used (we stepped back) or finds no blob, and computes or sends it again.
         Grace   A mark is swept only after `grace_s`: the race above costs a recomputation, and so becomes rare.
Crash    Between the blob's removal and the commit: the row stays, marked, without a blob; the next sweep removes it.
         Every order of these steps loses space for a while, none loses a blob that a row refers to.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import sqlalchemy as sa

from farfield.store.artifacts import Artifacts
from farfield.store.engine import insert, now, read, write
from farfield.store.tables import artifact, metadata

GRACE_S = 3600.0
PAGE = 5000


@dataclass(slots=True)
class Collected:
    """What a collection did, or would do: artifacts and their bytes."""

    adopted: int = 0
    marked: int = 0
    removed: int = 0
    removed_bytes: int = 0


def references() -> list[sa.Column[str]]:
    """Return every column that refers to an artifact: what is added to the tables is seen by itself."""
    return [
        column
        for table in metadata.sorted_tables
        for column in table.columns
        if any(key.column is artifact.c.digest for key in column.foreign_keys)
    ]


def unreferenced() -> sa.ColumnElement[bool]:
    """Return the condition that no row refers to an artifact."""
    return sa.and_(*(~sa.exists().where(column == artifact.c.digest) for column in references()))


def adopt(engine: sa.Engine, artifacts: Artifacts) -> int:
    """Give a marked row to every blob that has none; return how many. It lists the whole store."""
    number, page = 0, []
    for blob in artifacts.blobs():
        page.append({"digest": blob.digest, "n_bytes": blob.n_bytes})
        if len(page) == 500:
            number, page = number + _adopt(engine, page), []
    return number + _adopt(engine, page)


def mark(engine: sa.Engine) -> int:
    """Mark what nothing refers to; return how many artifacts that are now and were not before."""
    number = 0
    for digests in _pages(engine):
        with write(engine) as tx:
            fresh = artifact.c.digest.in_(digests) & artifact.c.marked_at.is_(None)
            number += tx.execute(sa.update(artifact).where(fresh, unreferenced()).values(marked_at=now())).rowcount
    return number


def sweep(engine: sa.Engine, artifacts: Artifacts, *, grace_s: float = GRACE_S, limit: int = 1_000_000) -> Collected:
    """Remove up to `limit` artifacts that were marked `grace_s` ago and are still unused, those marked first at first."""
    found = Collected()
    with read(engine) as tx:
        due = sa.select(artifact.c.digest).where(artifact.c.marked_at <= now() - grace_s)
        digests = list(tx.scalars(due.order_by(artifact.c.marked_at, artifact.c.digest).limit(limit)))
    for digest in digests:
        with write(engine) as tx:
            held = tx.execute(
                sa.select(artifact.c.n_bytes)
                .where(artifact.c.digest == digest, artifact.c.marked_at <= now() - grace_s).with_for_update()
            ).one_or_none()  # fmt: skip
            if held is None:  # taken into use, or swept by another
                continue
            removed = tx.execute(sa.delete(artifact).where(artifact.c.digest == digest, unreferenced())).rowcount
            if not removed:
                tx.execute(sa.update(artifact).where(artifact.c.digest == digest).values(marked_at=None))
                continue
            artifacts.remove(digest)
        found.removed += 1
        found.removed_bytes += held.n_bytes
    return found


def collect(engine: sa.Engine, artifacts: Artifacts, *, grace_s: float = GRACE_S) -> Collected:
    """Adopt, mark and sweep, once."""
    adopted, marked = adopt(engine, artifacts), mark(engine)
    found = sweep(engine, artifacts, grace_s=grace_s)
    found.adopted, found.marked = adopted, marked
    return found


def would_collect(engine: sa.Engine, artifacts: Artifacts) -> Collected:
    """Return what a collection without grace would remove now; changes nothing."""
    with read(engine) as tx:
        rows = dict(tx.execute(sa.select(artifact.c.digest, artifact.c.n_bytes).where(unreferenced())).tuples().all())
        known = set(tx.scalars(sa.select(artifact.c.digest)))
    strays = [blob for blob in artifacts.blobs() if blob.digest not in known]
    n_bytes = sum(rows.values()) + sum(blob.n_bytes for blob in strays)
    return Collected(adopted=len(strays), marked=len(rows), removed=len(rows) + len(strays), removed_bytes=n_bytes)


def _adopt(engine: sa.Engine, page: list[dict[str, object]]) -> int:
    if not page:
        return 0
    with read(engine) as tx:
        named = artifact.c.digest.in_([row["digest"] for row in page])
        known = set(tx.scalars(sa.select(artifact.c.digest).where(named)))
    number = 0
    for row in page:
        if row["digest"] not in known:
            values = {**row, "created_at": now(), "marked_at": now()}
            with write(engine) as tx:
                number += tx.execute(insert(tx, artifact).values(values).on_conflict_do_nothing()).rowcount
    return number


def _pages(engine: sa.Engine) -> Iterator[list[str]]:
    """Yield pages of digests that look unused: nobody waits for a look at a million rows."""
    last = ""
    while True:
        with read(engine) as tx:
            after = sa.select(artifact.c.digest).where(artifact.c.digest > last).order_by(artifact.c.digest)
            page = after.limit(PAGE).subquery()
            until = tx.scalar(sa.select(sa.func.max(page.c.digest)))
            if until is None:
                return
            between = (artifact.c.digest > last) & (artifact.c.digest <= until) & artifact.c.marked_at.is_(None)
            found = list(tx.scalars(sa.select(artifact.c.digest).where(between, unreferenced())))
        for start in range(0, len(found), 500):
            yield found[start : start + 500]
        last = until
