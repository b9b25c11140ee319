"""The pipeline in this process: stage after stage, shard after shard, artifacts as bytes. For levels of a few objects."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from farfield.pipeline import STEPS
from farfield.settings import Settings
from farfield.stages import Stage
from farfield.steps.model import Inputs


@dataclass
class Run:
    """What every stage made, up to the last one that was asked for."""

    settings: Settings
    artifacts: dict[Stage, bytes] = field(default_factory=dict)
    skipped: dict[Stage, str] = field(default_factory=dict)

    def inputs(self, scene_file: Path | None = None) -> Inputs:
        """Return what the next stage sees."""
        digests = {stage: hashlib.sha256(content).hexdigest() for stage, content in self.artifacts.items()}
        return Inputs(self.settings, dict(self.artifacts), digests, scene_file)

    def get(self, stage: Stage) -> Any:
        """Return the decoded artifact of a stage."""
        return self.inputs().get(stage)


def run(
    scene_file: Path,
    settings: Settings,
    *,
    until: Stage = Stage.PLACEMENT,
    order: Callable[[list[Any]], list[Any]] = list,
    one_shard: bool = False,
) -> Run:
    """Run the stages up to `until`; the shards of each in the order that `order` gives them. Raises what stages raise.

    one_shard  do not cut the candidates: where their shards are cut shapes which of them are kept
    """
    done = Run(settings)
    for stage in Stage:
        step = STEPS[stage]
        inputs = done.inputs(scene_file)
        reason = step.skip(inputs)
        if reason:
            done.skipped[stage] = reason
        shards = [] if reason else json.loads(json.dumps(step.plan(inputs)))
        if one_shard and stage == Stage.CANDIDATES and shards:
            shards = [[shards[0][0], shards[-1][1]]]
        ran = {json.dumps(s): b"".join(map(bytes, step.run(inputs, s))) for s in order(shards)}
        pieces = [ran[json.dumps(s)] for s in shards]
        done.artifacts[stage] = (
            b"".join(map(bytes, step.merge(inputs, pieces))) if step.merge is not None else pieces[0]
        )
        if stage == until:
            break
    return done
