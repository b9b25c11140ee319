"""Stages 1 to 6: what the level is, what is seen of it, and which views are too slow."""

from collections.abc import Sequence
from typing import Any

from farfield.columns import Parts, dataclass_parts, unpack_dataclass
from farfield.stages import Stage
from farfield.steps.model import Inputs, Shard, cells_of

# 1 scene ------------------------------------------------------------------------------------------------------------


def scene(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.scene.read import read_scene

    assert inputs.scene_file is not None
    return dataclass_parts(read_scene(inputs.scene_file, settings=inputs.settings))


# 2 hierarchy --------------------------------------------------------------------------------------------------------


def hierarchy(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.hierarchy.build import build_hierarchy

    return dataclass_parts(build_hierarchy(inputs.get(Stage.SCENE)))


# 3 detail -----------------------------------------------------------------------------------------------------------


def detail_skip(inputs: Inputs) -> str | None:
    from farfield.detail.worth import reason_to_skip
    from farfield.rendertime.cost import prices

    per_call, per_triangle = prices(inputs.settings)
    return reason_to_skip(
        inputs.get(Stage.SCENE), settings=inputs.settings, per_call=per_call, per_triangle=per_triangle
    )


def detail_plan(inputs: Inputs) -> list[Shard]:
    from farfield.detail.build import plan_shards

    return [[a, b] for a, b in plan_shards(inputs.get(Stage.SCENE))]


def detail(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.detail.build import build_levels

    return dataclass_parts(build_levels(inputs.get(Stage.SCENE), settings=inputs.settings, meshes=(shard[0], shard[1])))


def detail_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.detail.build import merge
    from farfield.detail.model import Levels

    parts = [unpack_dataclass(Levels, a) for a in artifacts]
    return dataclass_parts(merge(parts, inputs.get(Stage.SCENE), settings=inputs.settings))


# 4 rendertime -------------------------------------------------------------------------------------------------------


def rendertime(inputs: Inputs, shard: Shard) -> Parts:
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


def visibility_skip(inputs: Inputs) -> str | None:
    from farfield.visibility.auto import reason_to_skip

    mode = inputs.settings.visibility.mode
    if mode == "auto":
        return reason_to_skip(_seen_share(inputs))
    return "visibility.mode is off: every cell is taken to see every object" if mode == "off" else None


def visibility_plan(inputs: Inputs) -> list[Shard]:
    from farfield.visibility.sample import plan_shards

    mode = inputs.settings.visibility.mode
    share, mode = _seen_share(inputs), "sampled" if mode == "auto" else mode
    return [[mode, share, node] for node in plan_shards(cells_of(inputs))]


def visibility(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.visibility.sample import see

    mode, share, node = shard
    scene = inputs.get(Stage.SCENE)
    return dataclass_parts(see(scene, cells_of(inputs), node, settings=inputs.settings, mode=mode, seen_share=share))


def visibility_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.visibility.merge import merge
    from farfield.visibility.model import Sightings, off

    if not artifacts:
        return dataclass_parts(off())
    parts = [unpack_dataclass(Sightings, a) for a in artifacts]
    return dataclass_parts(merge(inputs.get(Stage.SCENE), cells_of(inputs), parts))


# 6 viewspace --------------------------------------------------------------------------------------------------------


def viewspace_plan(inputs: Inputs) -> list[Shard]:
    from farfield.viewspace.split import plan_subtrees

    return [int(node) for node in plan_subtrees(cells_of(inputs))]


def viewspace(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.viewspace.split import find_problem_views

    views = find_problem_views(
        inputs.get(Stage.SCENE), inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME),
        inputs.get(Stage.VISIBILITY), settings=inputs.settings, node=shard,
    )  # fmt: skip
    return dataclass_parts(views)


def viewspace_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.viewspace.model import ProblemViews
    from farfield.viewspace.split import merge_problem_views

    return dataclass_parts(merge_problem_views([unpack_dataclass(ProblemViews, a) for a in artifacts]))


def no_problem(inputs: Inputs) -> str | None:
    views = inputs.get(Stage.VIEWSPACE)
    return None if len(views.cell) else "every view is within the budget: nothing to replace"
