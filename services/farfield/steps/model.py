"""What a stage is to those who walk the pipeline: its step, what it may see, and the key that names what it makes."""

import hashlib
import importlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from farfield.columns import Parts, unpack_dataclass
from farfield.memory import Need
from farfield.settings import Settings, to_mapping
from farfield.stages import Queue, Stage

if TYPE_CHECKING:
    from farfield.geometry.cells import CellTree

Shard = Any  # a JSON value


@dataclass(frozen=True)
class Inputs:
    """What a stage may see. `scene_file` is there for the stage `scene` only."""

    settings: Settings
    artifacts: Mapping[Stage, Any]  # buffers
    digests: Mapping[Stage, str]  # SHA-256 (hex) of each artifact; Stage.SCENE before it ran: of the scene file
    scene_file: Path | None = None
    checkpoint: Path | None = None  # a file that outlives a killed run and is named by the shard's key, if there is one
    tell: Callable[[dict[str, Any]], None] | None = (
        None  # hears how far a long shard is; shapes nothing, may be called often
    )
    base: Path | None = None  # the folder of the job whose placement `placement.base` names

    def get(self, stage: Stage) -> Any:
        """Return the decoded artifact of a stage: its frozen dataclass."""
        return unpack_dataclass(_model(stage), self.artifacts[stage], where=f"artifact of stage {stage}")


@dataclass(frozen=True, kw_only=True)
class Step:
    """One stage: how to ask, cut, run and join it."""

    stage: Stage
    version: int  # bumped when results change
    queue: Queue
    inputs: tuple[Stage, ...]
    reads: tuple[str, ...]  # the settings it depends on, dotted keys (a table's key stands for all of it)
    plan: Callable[[Inputs], list[Shard]]
    run: Callable[[Inputs, Shard], Parts]
    merge: Callable[[Inputs, Sequence[Any]], Parts] | None = None
    skip: Callable[[Inputs], str | None] = field(default=lambda inputs: None)
    asks: tuple[str, ...] = ()  # more settings, that only `skip`, `plan` and `merge` look at
    timed: Callable[[Settings], bool] = field(default=lambda settings: False)  # see `shard_key`
    need: Need = field(default_factory=Need)  # memory of its shards


def shard_key(step: Step, inputs: Inputs, shard: Shard) -> str:
    """Return the digest of everything that shapes the shard's artifact. `shard` is "plan" or "merge" for those two.

    A known key means the work is done. The bake's names no renderer: each records the same tiles, and which it was.
    Where `step.timed`, a clock may end the work early: what a known key names will do, being what there was time for at
    best, but the result must not be kept under its own.
    """
    keys = step.reads + (step.asks if shard in ("plan", "merge") else ())
    read = {key: _setting(inputs.settings, key) for key in keys}
    sources = [Stage.SCENE] if step.stage == Stage.SCENE else list(step.inputs)
    digests = {str(stage): inputs.digests[stage] for stage in sources}
    text = json.dumps([step.stage, step.version, read, digests, shard], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _setting(settings: Settings, key: str) -> Any:
    value: Any = to_mapping(settings)
    for part in key.split("."):
        value = value[part]
    return value


_MODELS = {
    Stage.SCENE: ("scene", "Scene"),
    Stage.HIERARCHY: ("hierarchy", "Hierarchy"),
    Stage.DETAIL: ("detail", "Levels"),
    Stage.RENDERTIME: ("rendertime", "CostModel"),
    Stage.VISIBILITY: ("visibility", "VisibleSets"),
    Stage.VIEWSPACE: ("viewspace", "ProblemViews"),
    Stage.CANDIDATES: ("candidates", "Candidates"),
    Stage.PLACEMENT: ("placement", "Placement"),
    Stage.BAKE: ("bake", "BakedLayers"),
    Stage.REPAIR: ("placement", "Placement"),
    Stage.BOUND: ("placement", "Bound"),
}


def _model(stage: Stage) -> type:
    folder, name = _MODELS[stage]
    return getattr(importlib.import_module(f"farfield.{folder}.model"), name)


def cells_of(inputs: Inputs) -> "CellTree":
    """Return the view-space tree: cheap, a pure function of the scene's view space, so it is no artifact of its own."""
    from farfield.geometry.cells import build_cells

    scene = inputs.get(Stage.SCENE)
    return build_cells(scene.view_boxes, scene.cell_m)


ONE: list[Shard] = ["all"]


def one(inputs: Inputs) -> list[Shard]:
    return ONE
