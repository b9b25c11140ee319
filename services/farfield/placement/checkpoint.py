"""The optimiser's checkpoint: the choices so far, in a file that a killed run's successor goes on from.

Problem  A worker may be killed after minutes of choosing. The next must end with the same bytes, and sooner.
Method   The file holds the candidates in the order chosen and how many candidates there are. It is replaced whole, so a
         reader sees an old one or a new one, never half of one. Whoever runs the step names the file by everything that
         shapes the result (its shard's key): then any checkpoint in it is a beginning of the one possible sequence,
         whoever wrote it. One that cannot be read, does not match its digest, or is of another count of candidates, is none.
"""

import contextlib
import hashlib
import os
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from farfield.columns import pack, unpack
from farfield.errors import FarfieldError

SECONDS_BETWEEN_WRITES = 3.0


@dataclass(slots=True)
class Checkpoint:
    """Where the choices are kept. `read` before `write`: a file is of as many candidates as were read for."""

    path: Path
    seconds: float = SECONDS_BETWEEN_WRITES  # between writes, at least
    resumed: int = 0  # choices that `read` found
    _candidates: int = 0
    _written: float = field(default_factory=time.monotonic)

    def read(self, n_candidates: int) -> np.ndarray:
        """Return the choices (G,) i32 of an earlier run over as many candidates; none where there is no such file."""
        self._candidates = n_candidates
        none = np.zeros(0, np.int32)
        try:
            kind, columns, meta = unpack(self.path.read_bytes(), where="checkpoint")
        except (OSError, FarfieldError):
            return none
        step = columns.get("step", none)
        if kind != "choices" or meta != self._meta(step):
            return none
        self.resumed = len(step)
        return step

    def write(self, step: np.ndarray, *, at_once: bool = False) -> None:
        """Keep the choices (G,) i32, unless that was done a moment ago. A full disk costs the checkpoint, not the job."""
        if not at_once and time.monotonic() - self._written < self.seconds:
            return
        with contextlib.suppress(OSError):
            temporary = self.path.with_name(f"{self.path.name}.{os.getpid()}.part")
            temporary.write_bytes(pack("choices", {"step": step}, self._meta(step)))
            temporary.replace(self.path)
        self._written = time.monotonic()

    def _meta(self, step: np.ndarray) -> dict[str, object]:
        return {"candidates": self._candidates, "digest": hashlib.sha256(step.tobytes()).hexdigest()}
