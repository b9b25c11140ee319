"""The table of contents: every stage once, in order.

A stage is a pure function of content-addressed inputs, cut into shards. Whoever runs the pipeline (the spawned
processes of `farfield place`, the Celery workers of the service) walks `STEPS` and knows nothing else about any stage:

    skip    a reason why this scene does not need the stage, or None; asked first. A skipped stage plans no shards,
            and `merge` of nothing is its (empty) artifact, so that later stages need no special case
    plan    the shards, as JSON values that name content and place, never a worker or how many there are
    run     one shard -> the parts of its artifact (a file of farfield.columns)
    merge   the shards' artifacts in plan order -> the parts of the stage's artifact; None: that of the one shard

All four see the same `Inputs`: the settings and the artifacts of the stages named in `inputs`, as buffers.
Stages import lazily, so that a process pays only for the stages it runs (the API never imports this module).
"""

import hashlib
import importlib
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from farfield.columns import Parts, dataclass_parts, files_parts, pack_parts, unpack, unpack_dataclass, unpack_files
from farfield.memory import Need
from farfield.settings import PlacementSettings, Settings, to_mapping
from farfield.stages import Queue, Stage

if TYPE_CHECKING:
    from farfield.geometry.cells import CellTree
    from farfield.placement.checkpoint import Checkpoint

Shard = Any  # a JSON value
T = TypeVar("T")


@dataclass(frozen=True)
class Inputs:
    """What a stage may see. `scene_file` is there for the stage `scene` only."""

    settings: Settings
    artifacts: Mapping[Stage, Any]  # buffers
    digests: Mapping[
        Stage, str
    ]  # SHA-256 (hex) of each artifact, and of the scene file under Stage.SCENE before it ran
    scene_file: Path | None = None
    checkpoint: Path | None = None  # a file that outlives a killed run and is named by the shard's key, if there is one

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


def _one(inputs: Inputs) -> list[Shard]:
    return ONE


# 1 scene ------------------------------------------------------------------------------------------------------------


def _scene(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.scene.read import read_scene

    assert inputs.scene_file is not None
    return dataclass_parts(read_scene(inputs.scene_file, settings=inputs.settings))


# 2 hierarchy --------------------------------------------------------------------------------------------------------


def _hierarchy(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.hierarchy.build import build_hierarchy

    return dataclass_parts(build_hierarchy(inputs.get(Stage.SCENE)))


# 3 detail -----------------------------------------------------------------------------------------------------------


def _detail_skip(inputs: Inputs) -> str | None:
    from farfield.detail.worth import reason_to_skip
    from farfield.rendertime.cost import prices

    per_call, per_triangle = prices(inputs.settings)
    return reason_to_skip(
        inputs.get(Stage.SCENE), settings=inputs.settings, per_call=per_call, per_triangle=per_triangle
    )


def _detail_plan(inputs: Inputs) -> list[Shard]:
    from farfield.detail.build import plan_shards

    return [[a, b] for a, b in plan_shards(inputs.get(Stage.SCENE))]


def _detail(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.detail.build import build_levels

    return dataclass_parts(build_levels(inputs.get(Stage.SCENE), settings=inputs.settings, meshes=(shard[0], shard[1])))


def _detail_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.detail.build import merge
    from farfield.detail.model import Levels

    parts = [unpack_dataclass(Levels, a) for a in artifacts]
    return dataclass_parts(merge(parts, inputs.get(Stage.SCENE), settings=inputs.settings))


# 4 rendertime -------------------------------------------------------------------------------------------------------


def _rendertime(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.rendertime.cost import build_cost_model

    scene, levels = inputs.get(Stage.SCENE), inputs.get(Stage.DETAIL)
    return dataclass_parts(build_cost_model(scene, levels, settings=inputs.settings))


# 5 visibility -------------------------------------------------------------------------------------------------------


def _seen_share(inputs: Inputs) -> float | None:
    from farfield.visibility.auto import seen_share

    if inputs.settings.visibility.mode != "auto":
        return None
    scene, digest = inputs.get(Stage.SCENE), inputs.digests[Stage.SCENE]
    return seen_share(scene, cells_of(inputs), seed=inputs.settings.seed, digest=digest)


def _visibility_skip(inputs: Inputs) -> str | None:
    from farfield.visibility.auto import reason_to_skip

    mode = inputs.settings.visibility.mode
    if mode == "auto":
        return reason_to_skip(_seen_share(inputs))
    return "visibility.mode is off: every cell is taken to see every object" if mode == "off" else None


def _visibility_plan(inputs: Inputs) -> list[Shard]:
    from farfield.visibility.sample import plan_shards

    mode = inputs.settings.visibility.mode
    share, mode = _seen_share(inputs), "sampled" if mode == "auto" else mode
    return [[mode, share, node] for node in plan_shards(cells_of(inputs))]


def _visibility(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.visibility.sample import see

    mode, share, node = shard
    scene = inputs.get(Stage.SCENE)
    return dataclass_parts(see(scene, cells_of(inputs), node, settings=inputs.settings, mode=mode, seen_share=share))


def _visibility_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.visibility.merge import merge
    from farfield.visibility.model import Sightings, off

    if not artifacts:
        return dataclass_parts(off())
    parts = [unpack_dataclass(Sightings, a) for a in artifacts]
    return dataclass_parts(merge(inputs.get(Stage.SCENE), cells_of(inputs), parts))


# 6 viewspace --------------------------------------------------------------------------------------------------------


def _viewspace_plan(inputs: Inputs) -> list[Shard]:
    from farfield.viewspace.split import plan_subtrees

    return [int(node) for node in plan_subtrees(cells_of(inputs))]


def _viewspace(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.viewspace.split import find_problem_views

    views = find_problem_views(
        inputs.get(Stage.SCENE), inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME),
        inputs.get(Stage.VISIBILITY), settings=inputs.settings, node=shard,
    )  # fmt: skip
    return dataclass_parts(views)


def _viewspace_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.viewspace.model import ProblemViews
    from farfield.viewspace.split import merge_problem_views

    return dataclass_parts(merge_problem_views([unpack_dataclass(ProblemViews, a) for a in artifacts]))


def _no_problem(inputs: Inputs) -> str | None:
    views = inputs.get(Stage.VIEWSPACE)
    return None if len(views.cell) else "every view is within the budget: nothing to replace"


# 7 candidates -------------------------------------------------------------------------------------------------------


def _with_maps(inputs: Inputs) -> bool:
    return inputs.settings.placement.candidates == "environment"


def _candidates_plan(inputs: Inputs) -> list[Shard]:
    if _with_maps(inputs):
        from farfield.candidates.environment import plan_shards as cells_shards

        return [[a, b] for a, b in cells_shards(inputs.get(Stage.VIEWSPACE))]
    from farfield.candidates.generate import plan_shards

    return [[int(a), int(b)] for a, b in plan_shards(inputs.get(Stage.HIERARCHY))]


def _candidates(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.candidates.environment import generate_maps
    from farfield.candidates.generate import generate

    if _with_maps(inputs):
        maps = generate_maps(
            inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME), cells_of(inputs), inputs.get(Stage.VIEWSPACE),
            settings=inputs.settings, leaves=(shard[0], shard[1]),
        )  # fmt: skip
        return dataclass_parts(maps)
    found = generate(
        inputs.get(Stage.SCENE), inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME), cells_of(inputs),
        inputs.get(Stage.VIEWSPACE), settings=inputs.settings, nodes=(shard[0], shard[1]),
    )  # fmt: skip
    return dataclass_parts(found)


def _candidates_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.candidates.environment import merge
    from farfield.candidates.generate import merged_parts
    from farfield.candidates.model import Candidates

    if _with_maps(inputs) and artifacts:
        return dataclass_parts(merge([unpack_dataclass(Candidates, a) for a in artifacts]))
    return merged_parts([unpack_dataclass(Candidates, a) for a in artifacts])


# 8 placement --------------------------------------------------------------------------------------------------------


def _placement_plan(inputs: Inputs) -> list[Shard]:
    from farfield.placement.regions import plan_regions

    regions = []
    if inputs.settings.placement.regions > 1 and not _with_maps(inputs):
        regions = plan_regions(cells_of(inputs), inputs.get(Stage.VIEWSPACE), inputs.settings.placement.regions)
    return [[a, b] for a, b in regions] if len(regions) > 1 else ONE


def _placement(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.placement.greedy import cells_alone
    from farfield.placement.regions import choose_in_region

    if shard == ONE[0]:
        return _place(inputs, [])
    hierarchy, model, views = inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME), inputs.get(Stage.VIEWSPACE)
    chosen = choose_in_region(
        hierarchy, model, views, inputs.get(Stage.CANDIDATES), settings=inputs.settings, region=(shard[0], shard[1]),
        alone=cells_alone(hierarchy, model, cells_of(inputs), views, inputs.settings), checkpoint=_checkpoint(inputs),
    )  # fmt: skip
    return dataclass_parts(chosen)


def _placement_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    return [memoryview(artifacts[0])] if len(artifacts) == 1 else _place(inputs, artifacts)


def _place(inputs: Inputs, regions: Sequence[Any]) -> Parts:
    from farfield.placement.greedy import place
    from farfield.placement.model import RegionChoice

    choices = [unpack_dataclass(RegionChoice, a) for a in regions]
    # What regions chose that a clock stopped is not in the key that names the checkpoint.
    checkpoint = None if any(choice.stopped for choice in choices) else _checkpoint(inputs)
    placement = place(
        inputs.get(Stage.SCENE), inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME), cells_of(inputs),
        inputs.get(Stage.VIEWSPACE), inputs.get(Stage.CANDIDATES), settings=inputs.settings, regions=choices,
        checkpoint=checkpoint,
    )  # fmt: skip
    return dataclass_parts(placement)


def _checkpoint(inputs: Inputs) -> "Checkpoint | None":
    from farfield.placement.checkpoint import Checkpoint

    return Checkpoint(inputs.checkpoint) if inputs.checkpoint is not None else None


# 9 bake -------------------------------------------------------------------------------------------------------------


def _nothing_chosen(inputs: Inputs) -> str | None:
    return None if len(inputs.get(Stage.PLACEMENT).cluster) else "no impostor was chosen"


def _bake_plan(inputs: Inputs) -> list[Shard]:
    from farfield.bake.bake import plan_batches

    return [[int(a), int(b)] for a, b in plan_batches(inputs.get(Stage.PLACEMENT))]


def _bake(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.bake.bake import bake_batch

    baked = bake_batch(
        inputs.get(Stage.SCENE), inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME), inputs.get(Stage.PLACEMENT),
        settings=inputs.settings, impostors=(shard[0], shard[1]), renderer="auto",
    )  # fmt: skip
    return dataclass_parts(baked)


def _bake_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.bake.bake import merge
    from farfield.bake.model import BakedLayers

    return dataclass_parts(merge([unpack_dataclass(BakedLayers, a) for a in artifacts]))


def _repair(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.placement.repair import repair

    baked = inputs.get(Stage.BAKE)
    mended = repair(
        inputs.get(Stage.PLACEMENT), inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME), cells_of(inputs),
        inputs.get(Stage.VIEWSPACE), inputs.get(Stage.CANDIDATES), measured_bytes=baked.bytes, measured_cost=baked.cost,
        layers=np.diff(baked.layer_row).astype(np.int32),
    )  # fmt: skip
    return dataclass_parts(mended)


def _bound_skip(inputs: Inputs) -> str | None:
    off = "placement.bound is off" if inputs.settings.placement.bound == "off" else None
    whole = "environment maps are placed whole: nothing was chosen" if _with_maps(inputs) else None
    return off or whole or _nothing_chosen(inputs)


def _bound(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.placement.bound import bound_of

    found = bound_of(
        inputs.get(Stage.PLACEMENT), inputs.get(Stage.HIERARCHY), inputs.get(Stage.VIEWSPACE),
        inputs.get(Stage.CANDIDATES), method=inputs.settings.placement.bound,
    )  # fmt: skip
    return dataclass_parts(found)


def _bound_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.placement.model import Bound

    none = Bound(method="none", lower_bytes=0, placed_bytes=0, choices=0)
    return dataclass_parts(unpack_dataclass(Bound, artifacts[0]) if artifacts else none)


# 10 placementdb -----------------------------------------------------------------------------------------------------


def _placementdb(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.placementdb.write import build_files
    from farfield.scene.write import write_glb

    scene = inputs.get(Stage.SCENE)
    glb = write_glb(scene, inputs.get(Stage.DETAIL).of_meshes())
    digests = {str(stage): inputs.digests[stage] for stage in (Stage.SCENE, Stage.HIERARCHY, Stage.BAKE, Stage.REPAIR)}
    digests["scene.glb"] = hashlib.sha256(glb).hexdigest()
    files = build_files(
        scene, inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME), cells_of(inputs),
        inputs.get(Stage.VISIBILITY), inputs.get(Stage.VIEWSPACE), inputs.get(Stage.REPAIR), inputs.get(Stage.BAKE),
        settings=inputs.settings, digests=digests,
    )  # fmt: skip
    return files_parts({"scene.glb": glb, **{f"placement/{name}": content for name, content in files.items()}})


# 11 evaluation ------------------------------------------------------------------------------------------------------

VIEWS_A_SHARD, SHARDS = 500, 4


def _evaluation_plan(inputs: Inputs) -> list[Shard]:
    return [[inputs.settings.seed + i, VIEWS_A_SHARD] for i in range(SHARDS)]


def _evaluation(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.evaluation.verify import verify

    with tempfile.TemporaryDirectory(prefix="farfield-") as folder:
        write_files(inputs.artifacts[Stage.PLACEMENTDB], Path(folder))
        return pack_parts("verified", {}, verify(Path(folder), views=shard[1], seed=shard[0]))


def _evaluation_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.evaluation.verify import merge_found

    return pack_parts("verified", {}, merge_found([unpack(a)[2] for a in artifacts]))


# 12 proof -----------------------------------------------------------------------------------------------------------

PAIRS_A_SHARD = 80


def _proof_skip(inputs: Inputs) -> str | None:
    if inputs.settings.proof.mode == "off":
        return "proof.mode is off"
    return None if _shown_impostors(inputs) else "no impostor is shown anywhere"


def _shown_impostors(inputs: Inputs) -> int:
    for name, content in unpack_files(inputs.artifacts[Stage.PLACEMENTDB], where="artifact of stage placementdb"):
        if name.startswith("placement/index-"):
            return int((unpack(content)[1]["impostor_chunk"] >= 0).sum())
    return 0


def _proof_plan(inputs: Inputs) -> list[Shard]:
    proof = inputs.settings.proof
    each = proof.views if proof.mode == "all" else 0
    pairs = _shown_impostors(inputs) * each if each else proof.pairs
    return [[first, min(PAIRS_A_SHARD, pairs - first), each] for first in range(0, pairs, PAIRS_A_SHARD)]


def _proof(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.evaluation.proof.prove import prove_apart

    first, count, each = shard
    with tempfile.TemporaryDirectory(prefix="farfield-") as folder:
        write_files(inputs.artifacts[Stage.PLACEMENTDB], Path(folder))
        return pack_parts("proof", {}, prove_apart(Path(folder), first, count, seed=inputs.settings.seed, each=each))


def _proof_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.evaluation.proof.merge import merge_proofs

    found = [unpack(a)[2] for a in artifacts]
    return pack_parts("proof", {}, merge_proofs(found, confidence=inputs.settings.proof.confidence))


def write_files(buffer: Any, folder: Path) -> None:
    """Write the files of a stage `placementdb` artifact below `folder`: scene.glb and placement/..."""
    for name, content in unpack_files(buffer, where="artifact of stage placementdb"):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


_S, _H, _D, _R, _V = Stage.SCENE, Stage.HIERARCHY, Stage.DETAIL, Stage.RENDERTIME, Stage.VISIBILITY
_VIEW, _C, _P, _B = Stage.VIEWSPACE, Stage.CANDIDATES, Stage.PLACEMENT, Stage.BAKE
_CAMERA, _QUALITY = "camera", "quality"
_CHOOSING = tuple(f"placement.{f.name}" for f in fields(PlacementSettings) if f.name not in ("time_limit_s", "bound"))

STEPS: dict[Stage, Step] = {
    step.stage: step
    for step in (
        Step(stage=Stage.SCENE, need=Need(base_mib=600, factors={"file": 12.0}, most_mib=8192),
             version=4, queue=Queue.CPU, inputs=(), plan=_one, run=_scene,
             reads=("scene", "view_space.boxes", "view_space.cell_m", "bake.flatten")),
        Step(stage=Stage.HIERARCHY, version=1, queue=Queue.CPU, inputs=(_S,), plan=_one, run=_hierarchy, reads=()),
        Step(stage=Stage.DETAIL, version=1, queue=Queue.CPU, inputs=(_S,), skip=_detail_skip, plan=_detail_plan,
             run=_detail, merge=_detail_merge, reads=("detail", _CAMERA, _QUALITY),
             asks=("budget", "device", "device_profile")),
        Step(stage=Stage.RENDERTIME, version=2, queue=Queue.CPU, inputs=(_S, _D), plan=_one, run=_rendertime,
             reads=("budget", "device", "device_profile", _CAMERA)),
        Step(stage=Stage.VISIBILITY, need=Need(base_mib=1000, other=2.5),
             version=4, queue=Queue.CPU, inputs=(_S,), skip=_visibility_skip,
             plan=_visibility_plan, run=_visibility, merge=_visibility_merge,
             reads=("visibility.missed_ppm", "visibility.rays", "seed"), asks=("visibility.mode",)),
        Step(stage=Stage.VIEWSPACE, version=1, queue=Queue.CPU, inputs=(_S, _H, _R, _V), plan=_viewspace_plan,
             run=_viewspace, merge=_viewspace_merge, reads=(_CAMERA, "view_space.interval_deg")),
        Step(stage=Stage.CANDIDATES, version=2, queue=Queue.CPU, inputs=(_S, _H, _R, _VIEW), skip=_no_problem,
             plan=_candidates_plan, run=_candidates, merge=_candidates_merge,
             reads=(_CAMERA, _QUALITY, "view_space.interval_deg", "placement.candidates", "placement.far_m",
                    "placement.view_cells")),
        Step(stage=Stage.PLACEMENT, version=7, queue=Queue.OPTIMIZER, inputs=(_S, _H, _R, _VIEW, _C),
             plan=_placement_plan, run=_placement, merge=_placement_merge, reads=(_CAMERA, _QUALITY, *_CHOOSING),
             timed=lambda settings: settings.placement.time_limit_s is not None),
        Step(stage=Stage.BAKE, need=Need(base_mib=1500),
             version=6, queue=Queue.GL, inputs=(_S, _H, _R, _P), skip=_nothing_chosen,
             plan=_bake_plan, run=_bake, merge=_bake_merge,
             reads=(_CAMERA, _QUALITY, "placement.candidates", "placement.far_m")),
        Step(stage=Stage.REPAIR, need=Need(base_mib=900),
             version=4, queue=Queue.OPTIMIZER, inputs=(_H, _R, _S, _VIEW, _C, _P, _B), plan=_one,
             run=_repair, reads=("placement",)),
        Step(stage=Stage.BOUND, need=Need(base_mib=1200),
             version=4, queue=Queue.OPTIMIZER, inputs=(_H, _VIEW, _C, _P), skip=_bound_skip, plan=_one,
             run=_bound, merge=_bound_merge, reads=("placement.bound",), asks=("placement.candidates",)),
        Step(stage=Stage.PLACEMENTDB, need=Need(base_mib=1300),
             version=5, queue=Queue.CPU, inputs=(_S, _H, _D, _R, _V, _VIEW, Stage.REPAIR, _B),
             plan=_one, run=_placementdb, reads=tuple(f.name for f in fields(Settings))),  # its manifest states them all
        Step(stage=Stage.EVALUATION, need=Need(base_mib=1200),
             version=1, queue=Queue.CPU, inputs=(Stage.PLACEMENTDB,), plan=_evaluation_plan,
             run=_evaluation, merge=_evaluation_merge, reads=("seed",)),
        Step(stage=Stage.PROOF, need=Need(base_mib=1500),
             version=1, queue=Queue.GL, inputs=(Stage.PLACEMENTDB,), skip=_proof_skip,
             plan=_proof_plan, run=_proof, merge=_proof_merge, reads=("seed",), asks=("proof",)),
    )
}  # fmt: skip
