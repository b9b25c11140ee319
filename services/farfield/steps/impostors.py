"""Stages 7 to 9: which impostors could be built, which are, and what they show and weigh."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from farfield.columns import Parts, dataclass_parts, unpack_dataclass
from farfield.errors import BaseUnfit
from farfield.stages import Stage
from farfield.steps.model import ONE, Inputs, Shard, cells_of

if TYPE_CHECKING:
    from farfield.candidates.model import Candidates
    from farfield.placement.checkpoint import Checkpoint
    from farfield.placement.choose import Progress
    from farfield.placement.live import Live
    from farfield.placement.model import Placement
    from farfield.placementdb.base import BaseFiles


# 7 candidates -------------------------------------------------------------------------------------------------------


def _with_maps(inputs: Inputs) -> bool:
    return inputs.settings.placement.candidates == "environment"


def candidates_plan(inputs: Inputs) -> list[Shard]:
    if inputs.tell is not None:
        _live(inputs).map()
    if inputs.settings.placement.base is not None:
        return ONE
    if _with_maps(inputs):
        from farfield.candidates.environment import plan_shards as cells_shards

        return [[a, b] for a, b in cells_shards(inputs.get(Stage.VIEWSPACE))]
    from farfield.candidates.generate import plan_shards

    return [[int(a), int(b)] for a, b in plan_shards(inputs.get(Stage.HIERARCHY))]


def candidates(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.candidates.environment import generate_maps
    from farfield.candidates.generate import generate

    if shard == ONE[0]:
        return dataclass_parts(_on_base(inputs))
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


def _on_base(inputs: Inputs) -> "Candidates":
    """Return what the base offers, and candidates for the problem views that it leaves above the budget."""
    from farfield.candidates.generate import generate, joined, plan_shards
    from farfield.placement.antichain import subtree_end
    from farfield.placement.base import keep, lacking, with_fresh
    from farfield.placement.greedy import candidates_refit
    from farfield.scene.identity import object_digests
    from farfield.viewspace.model import take

    scene, hierarchy, model = inputs.get(Stage.SCENE), inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME)
    views, cells = inputs.get(Stage.VIEWSPACE), cells_of(inputs)
    kept = keep(
        open_base(inputs).read(), scene, object_digests(scene), hierarchy, cells, views,
        refit=candidates_refit(model, inputs.settings),
    )  # fmt: skip
    short = lacking(kept, need=views.cost - model.target, end=subtree_end(hierarchy.start, hierarchy.stop))
    if not len(short):
        return kept
    given = scene, hierarchy, model, cells, take(views, short)
    fresh = joined([generate(*given, settings=inputs.settings, nodes=nodes) for nodes in plan_shards(hierarchy)])
    return with_fresh(kept, replace(fresh, view=short[fresh.view].astype(np.int32)))


def open_base(inputs: Inputs) -> "BaseFiles":
    """Return the base that the settings name. Raises BaseUnfit where it is not at hand, or another."""
    from farfield.placementdb.base import open_base

    wanted = inputs.settings.placement.base
    if inputs.base is None:
        raise BaseUnfit("its files are not here; `farfield place --from DIR` brings them")
    base = open_base(inputs.base, inputs.settings)
    if base.sha256 != wanted:
        raise BaseUnfit(f"{inputs.base} holds placement {base.sha256[:16]}, not {str(wanted)[:16]}")
    return base


def candidates_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.candidates.environment import merge
    from farfield.candidates.generate import merged_parts
    from farfield.candidates.model import Candidates

    if _with_maps(inputs) and artifacts:
        return dataclass_parts(merge([unpack_dataclass(Candidates, a) for a in artifacts]))
    return merged_parts([unpack_dataclass(Candidates, a) for a in artifacts])


# 8 placement --------------------------------------------------------------------------------------------------------


def placement_plan(inputs: Inputs) -> list[Shard]:
    from farfield.placement.regions import plan_regions

    regions = []
    if inputs.settings.placement.regions > 1 and not _with_maps(inputs) and inputs.settings.placement.base is None:
        regions = plan_regions(cells_of(inputs), inputs.get(Stage.VIEWSPACE), inputs.settings.placement.regions)
    return [[a, b] for a, b in regions] if len(regions) > 1 else ONE


def placement(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.placement.greedy import cells_alone
    from farfield.placement.regions import choose_in_region

    if shard == ONE[0]:
        return _place(inputs, [])
    hierarchy, model, views = inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME), inputs.get(Stage.VIEWSPACE)
    chosen = choose_in_region(
        hierarchy, model, views, inputs.get(Stage.CANDIDATES), settings=inputs.settings, region=(shard[0], shard[1]),
        alone=cells_alone(hierarchy, model, cells_of(inputs), views, inputs.settings), checkpoint=_checkpoint(inputs),
        progress=_progress(inputs, (shard[0], shard[1])),
    )  # fmt: skip
    return dataclass_parts(chosen)


def placement_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
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
        checkpoint=checkpoint, progress=_progress(inputs),
    )  # fmt: skip
    return dataclass_parts(placement)


def _live(inputs: Inputs, cells: tuple[int, int] | None = None) -> "Live":
    """Return what tells of the problem views of the cells [a, b), or of all. `inputs.tell` is there."""
    from farfield.placement.live import Live

    views, scene = inputs.get(Stage.VIEWSPACE), inputs.get(Stage.SCENE)
    first, last = (0, len(views.cell)) if cells is None else (int(v) for v in np.searchsorted(views.cell, cells))
    assert inputs.tell is not None
    return Live(
        inputs.tell, cells_of(inputs), views, inputs.get(Stage.RENDERTIME), origin=scene.origin_m,
        views_of=slice(first, last),
    )  # fmt: skip


def _progress(inputs: Inputs, cells: tuple[int, int] | None = None) -> "Progress | None":
    if inputs.tell is None:
        return None
    found = _live(inputs, cells)
    found.map()
    return found.progress


def _checkpoint(inputs: Inputs) -> "Checkpoint | None":
    from farfield.placement.checkpoint import Checkpoint

    return Checkpoint(inputs.checkpoint) if inputs.checkpoint is not None else None


# 9 bake -------------------------------------------------------------------------------------------------------------


def nothing_chosen(inputs: Inputs) -> str | None:
    return None if len(inputs.get(Stage.PLACEMENT).cluster) else "no impostor was chosen"


def nothing_to_bake(inputs: Inputs) -> str | None:
    return nothing_chosen(inputs) or (None if len(_to_bake(inputs).cluster) else "the base has baked every impostor")


def _to_bake(inputs: Inputs) -> "Placement":
    from farfield.placement.model import only_fresh

    return only_fresh(inputs.get(Stage.PLACEMENT))


def bake_plan(inputs: Inputs) -> list[Shard]:
    from farfield.bake.bake import plan_batches

    return [[int(a), int(b)] for a, b in plan_batches(_to_bake(inputs))]


def bake(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.bake.bake import bake_batch

    baked = bake_batch(
        inputs.get(Stage.SCENE), inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME), _to_bake(inputs),
        settings=inputs.settings, impostors=(shard[0], shard[1]), renderer="auto",
    )  # fmt: skip
    return dataclass_parts(baked)


def bake_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.bake.bake import merge_parts
    from farfield.bake.model import BakedLayers

    return merge_parts([unpack_dataclass(BakedLayers, a) for a in artifacts])


def repair(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.placement.repair import repair

    baked = inputs.get(Stage.BAKE)
    mended = repair(
        inputs.get(Stage.PLACEMENT), inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME), cells_of(inputs),
        inputs.get(Stage.VIEWSPACE), inputs.get(Stage.CANDIDATES), measured_bytes=baked.bytes, measured_cost=baked.cost,
        layers=np.diff(baked.layer_row).astype(np.int32),
    )  # fmt: skip
    return dataclass_parts(mended)


def bound_skip(inputs: Inputs) -> str | None:
    off = "placement.bound is off" if inputs.settings.placement.bound == "off" else None
    whole = "environment maps are placed whole: nothing was chosen" if _with_maps(inputs) else None
    if inputs.settings.placement.base is not None:
        whole = "there are no candidates for what the base keeps: a bound would speak of the others only"
    return off or whole or nothing_chosen(inputs)


def bound(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.placement.bound import bound_of

    found = bound_of(
        inputs.get(Stage.PLACEMENT), inputs.get(Stage.HIERARCHY), inputs.get(Stage.VIEWSPACE),
        inputs.get(Stage.CANDIDATES), method=inputs.settings.placement.bound,
    )  # fmt: skip
    return dataclass_parts(found)


def bound_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.placement.model import Bound

    none = Bound(method="none", lower_bytes=0, placed_bytes=0, choices=0)
    return dataclass_parts(unpack_dataclass(Bound, artifacts[0]) if artifacts else none)
