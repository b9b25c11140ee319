"""Compute an artifact anew that the store has lost or damaged.

A stage is a pure function: the rows say which shard made the bytes, from which inputs; computed again they have the same
digest, whoever needs them. So no row changes: whoever finds the damage mends it under its own lease, inputs first, and
goes on. What cannot be made again (an upload, a report with its timings, what a clock stopped) is refused by name.
"""

import logging
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import sqlalchemy as sa
from farfield.errors import ArtifactDamaged, ArtifactLost, ArtifactMissing
from farfield.store import shards
from farfield.store.artifacts import Artifacts
from farfield.store.shards import Claim

from farfield_workers.compute import Call, Result
from farfield_workers.lease import patiently

log = logging.getLogger(__name__)

MOST = 100  # artifacts that one shard mends: more is a broken store

Calling = Callable[[Claim, Path, ExitStack], Call]
Computing = Callable[[Call, Path], Result]
T = TypeVar("T")


class Restorer:
    """Does things that read artifacts, and mends what they find missing or damaged."""

    def __init__(self, engine: sa.Engine, artifacts: Artifacts, calling: Calling, computing: Computing) -> None:
        self.engine, self.artifacts, self.calling, self.computing = engine, artifacts, calling, computing
        self._at_work: list[str] = []

    def mending(self, do: Callable[[], T], job_id: str) -> T:
        """Return what `do` returns, done again after each artifact that it lacked. Raises ArtifactLost."""
        for _ in range(MOST):
            try:
                return do()
            except ArtifactMissing as error:
                self.restore(error.digest, job_id, damaged=isinstance(error, ArtifactDamaged))
        raise ArtifactLost("too many artifacts are missing or damaged: the store itself must be broken")

    def restore(self, digest: str, job_id: str, *, damaged: bool) -> None:
        """Put the artifact back into the store. `job_id`: whose rows are asked first."""
        log.error("artifact %s is %s: it is computed again", digest, "damaged" if damaged else "missing")
        made = patiently(lambda: shards.made(self.engine, digest, job_id))
        if damaged:
            self.artifacts.remove(digest)
        if made is None or made.kind == "report" or digest in self._at_work:  # or it would be made of itself
            what = "the report" if made is not None and made.kind == "report" else "the uploaded file"
            raise ArtifactLost(f"{what} {digest} is {'damaged' if damaged else 'missing'} and cannot be computed again")

        def compute() -> None:
            with ExitStack() as until_done:
                folder = Path(
                    until_done.enter_context(TemporaryDirectory(dir=self.artifacts.temporary, prefix="shard-"))
                )
                found = self.computing(self.calling(made, folder, until_done), folder / "artifact")
                if found.digest != digest:
                    raise ArtifactLost(
                        f"artifact {digest} of stage {made.stage} is lost: computed again it has other bytes"
                    )
                self.artifacts.put_file(folder / "artifact", digest)

        self._at_work.append(digest)
        try:
            self.mending(compute, job_id)
        finally:
            self._at_work.pop()
