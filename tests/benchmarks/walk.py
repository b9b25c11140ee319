"""The whole pipeline in this process, shard after shard, and what each stage takes of the processor and of memory.

Seconds are those of the processor, not of the clock: they tell what a stage costs where other processes keep the machine
busy, too. `serial_s` (plan and merge) is what a second worker does not shorten.
"""

import dataclasses
import json
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from farfield.executor import file_digest, map_file, peak_bytes, reset_peak, write_parts
from farfield.pipeline import STEPS
from farfield.settings import Settings, from_mapping
from farfield.stages import Stage
from farfield.steps.model import Inputs


@dataclass(frozen=True, slots=True, kw_only=True)
class Taken:
    """What one stage took; `longest_s` is its longest shard, `peak_bytes` the largest resident set of any of its parts."""

    stage: Stage
    shards: int
    run_s: float
    longest_s: float
    serial_s: float
    artifact_bytes: int
    peak_bytes: int

    @property
    def seconds(self) -> float:
        return self.run_s + self.serial_s

    @property
    def two_workers(self) -> float:
        """How many times as fast two workers are that never wait for a core: longest shard and serial part stay."""
        return self.seconds / (max(self.run_s / 2, self.longest_s) + self.serial_s)


def read_settings(path: Path, **replaced: Any) -> Settings:
    """Return the settings of a TOML file; `replaced` are whole top-level keys."""
    return dataclasses.replace(from_mapping(tomllib.loads(path.read_text(encoding="utf-8"))), **replaced)


def walk(scene_file: Path, settings: Settings, folder: Path, *, until: Stage) -> Iterator[Taken]:
    """Run the stages in order to `until`, their artifacts in `folder`, and yield what each took."""
    artifacts: dict[Stage, Path] = {}
    digests = {Stage.SCENE: file_digest(scene_file)}
    for stage, step in STEPS.items():
        inputs = Inputs(settings, {s: map_file(artifacts[s]) for s in step.inputs}, digests, scene_file)
        reset_peak()
        start = time.process_time()
        shards = [] if step.skip(inputs) else json.loads(json.dumps(step.plan(inputs)))
        planned = time.process_time() - start
        runs, peaks, pieces = [], [peak_bytes()], [folder / f"{stage}-{i}.ffc" for i in range(len(shards))]
        for shard, piece in zip(shards, pieces, strict=True):
            reset_peak()
            start = time.process_time()
            write_parts(step.run(Inputs(settings, inputs.artifacts, digests, scene_file), shard), piece)
            runs.append(time.process_time() - start)
            peaks.append(peak_bytes())
        out = folder / f"{stage}.ffc"
        reset_peak()
        start = time.process_time()
        if step.merge is not None:
            write_parts(step.merge(inputs, [map_file(piece) for piece in pieces]), out)
            for piece in pieces:
                piece.unlink()
        else:
            pieces[0].replace(out)
        artifacts[stage], digests[stage] = out, file_digest(out)
        yield Taken(
            stage=stage, shards=len(shards), run_s=sum(runs), longest_s=max(runs, default=0.0),
            serial_s=planned + time.process_time() - start, artifact_bytes=out.stat().st_size,
            peak_bytes=max(*peaks, peak_bytes()),
        )  # fmt: skip
        if stage == until:
            return
