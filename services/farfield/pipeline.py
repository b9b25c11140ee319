"""The table of contents: every stage once, in order.

A stage is a pure function of content-addressed inputs, cut into shards. Whoever runs the pipeline (the spawned
processes of `farfield place`, the Celery workers of the service) walks `STEPS` and knows nothing else about any stage:

    skip    a reason why this scene does not need the stage, or None; asked first. A skipped stage plans no shards,
            and `merge` of nothing is its (empty) artifact, so that later stages need no special case
    plan    the shards, as JSON values that name content and place, never a worker or how many there are
    run     one shard -> the parts of its artifact (a file of farfield.columns)
    merge   the shards' artifacts in plan order -> the parts of the stage's artifact; None: that of the one shard

All four see the same `Inputs`: the settings and the artifacts of the stages named in `inputs`, as buffers. They are
functions of `farfield.steps`, in the order of the stages.
Stages import lazily, so that a process pays only for the stages it runs (the API never imports this module).
"""

from dataclasses import fields

from farfield.memory import Need
from farfield.settings import PlacementSettings, Settings
from farfield.stages import Queue, Stage
from farfield.steps import impostors, level, result
from farfield.steps.model import Step, one

_S, _H, _D, _R, _V = Stage.SCENE, Stage.HIERARCHY, Stage.DETAIL, Stage.RENDERTIME, Stage.VISIBILITY
_VIEW, _C, _P, _B = Stage.VIEWSPACE, Stage.CANDIDATES, Stage.PLACEMENT, Stage.BAKE
_CAMERA, _QUALITY = "camera", "quality"
_CHOOSING = tuple(f"placement.{f.name}" for f in fields(PlacementSettings) if f.name not in ("time_limit_s", "bound"))

STEPS: dict[Stage, Step] = {
    step.stage: step
    for step in (
        Step(stage=Stage.SCENE, need=Need(base_mib=600, factors={"file": 12.0}, most_mib=8192),
             version=4, queue=Queue.CPU, inputs=(), plan=one, run=level.scene,
             reads=("scene", "view_space.boxes", "view_space.cell_m", "bake.flatten")),
        Step(stage=Stage.HIERARCHY, version=1, queue=Queue.CPU, inputs=(_S,), plan=one, run=level.hierarchy, reads=()),
        Step(stage=Stage.DETAIL, version=1, queue=Queue.CPU, inputs=(_S,), skip=level.detail_skip, plan=level.detail_plan,
             run=level.detail, merge=level.detail_merge, reads=("detail", _CAMERA, _QUALITY),
             asks=("budget", "device", "device_profile")),
        Step(stage=Stage.RENDERTIME, version=2, queue=Queue.CPU, inputs=(_S, _D), plan=one, run=level.rendertime,
             reads=("budget", "device", "device_profile", _CAMERA)),
        Step(stage=Stage.VISIBILITY, need=Need(base_mib=1000, other=2.5),
             version=4, queue=Queue.CPU, inputs=(_S,), skip=level.visibility_skip,
             plan=level.visibility_plan, run=level.visibility, merge=level.visibility_merge,
             reads=("visibility.missed_ppm", "visibility.rays", "seed"), asks=("visibility.mode",)),
        Step(stage=Stage.VIEWSPACE, version=1, queue=Queue.CPU, inputs=(_S, _H, _R, _V), plan=level.viewspace_plan,
             run=level.viewspace, merge=level.viewspace_merge, reads=(_CAMERA, "view_space.interval_deg")),
        Step(stage=Stage.CANDIDATES, version=2, queue=Queue.CPU, inputs=(_S, _H, _R, _VIEW), skip=level.no_problem,
             plan=impostors.candidates_plan, run=impostors.candidates, merge=impostors.candidates_merge,
             reads=(_CAMERA, _QUALITY, "view_space.interval_deg", "placement.candidates", "placement.far_m",
                    "placement.view_cells", "placement.density", "placement.base")),
        Step(stage=Stage.PLACEMENT, version=7, queue=Queue.OPTIMIZER, inputs=(_S, _H, _R, _VIEW, _C),
             plan=impostors.placement_plan, run=impostors.placement, merge=impostors.placement_merge,
             reads=(_CAMERA, _QUALITY, *_CHOOSING),
             timed=lambda settings: settings.placement.time_limit_s is not None),
        Step(stage=Stage.BAKE, need=Need(base_mib=1500),
             version=8, queue=Queue.GL, inputs=(_S, _H, _R, _P), skip=impostors.nothing_to_bake,
             plan=impostors.bake_plan, run=impostors.bake, merge=impostors.bake_merge,
             reads=(_CAMERA, _QUALITY, "placement.candidates", "placement.far_m")),
        Step(stage=Stage.REPAIR, need=Need(base_mib=900),
             version=4, queue=Queue.OPTIMIZER, inputs=(_H, _R, _S, _VIEW, _C, _P, _B), plan=one,
             run=impostors.repair, reads=("placement",)),
        Step(stage=Stage.BOUND, need=Need(base_mib=1200),
             version=4, queue=Queue.OPTIMIZER, inputs=(_H, _VIEW, _C, _P), skip=impostors.bound_skip, plan=one,
             run=impostors.bound, merge=impostors.bound_merge, reads=("placement.bound",),
             asks=("placement.candidates", "placement.base")),
        Step(stage=Stage.PLACEMENTDB, need=Need(base_mib=1300),
             version=8, queue=Queue.CPU, inputs=(_S, _H, _D, _R, _V, _VIEW, Stage.REPAIR, _B),
             plan=one, run=result.placementdb, reads=tuple(f.name for f in fields(Settings))),  # its manifest states them all
        Step(stage=Stage.EVALUATION, need=Need(base_mib=1200),
             version=2, queue=Queue.CPU, inputs=(Stage.PLACEMENTDB,), plan=result.evaluation_plan,
             run=result.evaluation, merge=result.evaluation_merge, reads=("seed",)),
        Step(stage=Stage.PROOF, need=Need(base_mib=1500),
             version=1, queue=Queue.GL, inputs=(Stage.PLACEMENTDB,), skip=result.proof_skip,
             plan=result.proof_plan, run=result.proof, merge=result.proof_merge, reads=("seed",), asks=("proof",)),
    )
}  # fmt: skip
