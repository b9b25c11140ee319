"""The report of a job: what was placed, whether it holds, what could not be solved and who is to blame, what it took.

`report.json` is this dict; the page that shows it is the web app's. docs/formats/report.md lists every key. Measured
times and memory live here and nowhere else: the placement itself is the same bytes on every run.
"""

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import numpy as np

from farfield.bake.model import BakedLayers
from farfield.columns import unpack, unpack_files
from farfield.errors import PlacementFileMissing
from farfield.evaluation.detail import levels_summary
from farfield.evaluation.left_out import left_out
from farfield.evaluation.verify import refuted
from farfield.geometry.cells import CellTree, build_cells
from farfield.geometry.intervals import direction_at, edges, split_id
from farfield.placement.model import Bound, Placement
from farfield.rendertime.model import CostModel
from farfield.rendertime.profiles import find_profile
from farfield.scene.model import LOOKS, Scene
from farfield.settings import Settings, to_mapping
from farfield.stages import Stage
from farfield.viewspace.model import ProblemViews
from farfield.visibility.model import summary

WORST_VIEWS, HOPELESS_VIEWS, CULPRITS = 16, 100, 32


class JobInputs(Protocol):
    """What `farfield.steps.model.Inputs` offers: settings, and the artifacts of all stages that ran."""

    @property
    def settings(self) -> Settings: ...

    @property
    def artifacts(self) -> Mapping[Stage, Any]: ...

    def get(self, stage: Stage) -> Any: ...


class StageRun(Protocol):
    """What one stage took."""

    @property
    def name(self) -> str: ...

    @property
    def seconds(self) -> float: ...

    @property
    def peak_bytes(self) -> int: ...

    @property
    def skipped(self) -> str | None: ...

    @property
    def shards(self) -> int: ...

    @property
    def reused(self) -> int: ...


def build_report(inputs: JobInputs, stages: Iterable[StageRun]) -> dict[str, Any]:
    """Return the report of a job whose stages up to `placementdb` have artifacts, as JSON values (no NaN, no infinity).

    Without an artifact of `evaluation` or `proof` (it crashed) a placement stands as `unproven`; so does one that either
    of them refutes.
    """
    settings = inputs.settings
    scene, model, views = inputs.get(Stage.SCENE), inputs.get(Stage.RENDERTIME), inputs.get(Stage.VIEWSPACE)
    placement, baked = inputs.get(Stage.REPAIR), inputs.get(Stage.BAKE)
    cells = build_cells(scene.view_boxes, scene.cell_m)
    manifest = _manifest(inputs.artifacts[Stage.PLACEMENTDB])
    verified = unpack(inputs.artifacts[Stage.EVALUATION])[2] if Stage.EVALUATION in inputs.artifacts else None
    proof = unpack(inputs.artifacts[Stage.PROOF])[2] if Stage.PROOF in inputs.artifacts else None
    ran: list[dict[str, Any]] = [
        {"name": str(s.name), "seconds": round(s.seconds, 3), "peak_bytes": s.peak_bytes, "skipped": s.skipped,
         "shards": s.shards, "reused": s.reused}
        for s in stages
    ]  # fmt: skip
    report: dict[str, Any] = {
        "format": "farfield report", "version": 1,
        "verdict": _verdict(manifest["verdict"], verified, proof), "stopped": placement.stopped,
        "budget": settings.budget, "budget_amount": model.budget, "unit": model.unit, "per_frame": model.per_frame,
        "smallest_budget": _smallest(model, views, placement), "device": _device(settings, model),
        **{key: manifest["counts"][key] for key in ("objects", "triangles", "cells", "problem_views", "hopeless_views",
                                                    "impostors", "layers", "chunks", "pages")},
        "candidates": len(inputs.get(Stage.CANDIDATES).cluster),
        **{key: manifest[key] for key in ("bytes", "file_bytes", "video_bytes", "camera", "quality", "bounds",
                                          "view_space")},
        **_bound(inputs.get(Stage.BOUND)),
        "base": _base(settings, placement),
        "detail": levels_summary(scene, inputs.get(Stage.DETAIL), model, cells),
        "visibility": summary(inputs.get(Stage.VISIBILITY), n_objects=scene.n_objects),
        "stages": ran, "seconds": round(math.fsum(s["seconds"] for s in ran), 3),
        "peak_bytes": max((s["peak_bytes"] for s in ran), default=0),
        "seed": settings.seed, "settings": to_mapping(settings),
        "worst_geometry_cost": int(max(views.cost.max(initial=0), views.worst_nonproblem)) + model.per_frame,
        "worst_cost_bound": int(max(placement.view_cost.max(initial=0), views.worst_nonproblem)) + model.per_frame,
        "worst_views": _worst_views(scene, cells, model, views, placement, settings),
        "hopeless": _hopeless(scene, cells, model, views, placement, settings),
        "culprits": _culprits(scene, placement),
        "curve": _curve(placement),
        "verified": verified, "proof": proof,
        "warnings": list(scene.warnings), "dropped_triangles": scene.dropped_triangles,
        "not_baked": list(baked.skipped), "looks": _looks(scene), "software": manifest["provenance"]["software"],
        "inputs": manifest["provenance"]["inputs"],
        "textures": len(scene.texture_byte) - 1, "single_layer_impostors": _single_layer(baked),
    }  # fmt: skip
    return {**report, "left_out": left_out(report)}


def _base(settings: Settings, placement: Placement) -> dict[str, Any] | None:
    """Return what the placement was placed on: which one it started from and how much of it stands."""
    if settings.placement.base is None:
        return None
    kept = placement.base >= 0
    return {
        "manifest_sha256": settings.placement.base, "impostors_kept": int(kept.sum()),
        "impostors_built": int((~kept).sum()), "bytes_kept": int(placement.bytes[kept].sum()),
    }  # fmt: skip


def _single_layer(baked: BakedLayers) -> int:
    """Return how many impostors have one layer, in however many pieces."""
    parts = (baked.plane[a:b] for a, b in zip(baked.layer_row[:-1], baked.layer_row[1:], strict=True))
    return sum(len(plane) > 0 and bool((plane == plane[0]).all()) for plane in parts)


def _bound(bound: Bound) -> dict[str, Any]:
    """Return the lower bound and how far the placement is from it. Both are estimates from before the bake: a baked
    impostor weighs less, so measured bytes must not be held against the bound."""
    if bound.method == "none":
        return {"lower_bound_bytes": None, "bound": None}
    gap = bound.placed_bytes / bound.lower_bytes - 1 if bound.lower_bytes else None
    figures = {"method": bound.method, "estimated_bytes": bound.placed_bytes, "gap": gap, "choices": bound.choices}
    return {"lower_bound_bytes": bound.lower_bytes, "bound": figures}


def _verdict(stated: str, verified: Mapping[str, Any] | None, proof: Mapping[str, Any] | None) -> str:
    if verified is None or proof is None or refuted(verified) or proof["failed"]:
        return "unproven"
    return stated


def _manifest(artifact: Any) -> dict[str, Any]:
    for name, content in unpack_files(artifact, where="artifact of stage placementdb"):
        if name == "placement/manifest.json":
            manifest: dict[str, Any] = json.loads(bytes(content))
            return manifest
    raise PlacementFileMissing("placement/manifest.json")


def _device(settings: Settings, model: CostModel) -> dict[str, Any] | None:
    """Return what a budget of time was counted with: the profile, and for a fitted one how it lies over its samples."""
    if model.unit != "ns":
        return None
    return {"name": settings.device, **dataclasses.asdict(find_profile(settings))}


def _smallest(model: CostModel, views: ProblemViews, placement: Placement) -> dict[str, Any]:
    """Return the least budget that every view can meet, as an amount and as the text of a setting (rounded up)."""
    amount = max(int(placement.smallest_budget), model.per_frame) if len(views.cell) else model.budget
    hundredths = -(-amount // 10_000)
    ms = f"{hundredths // 100}.{hundredths % 100:02}".rstrip("0").rstrip(".")
    text = f"{ms} ms" if model.unit == "ns" else f"{amount} {model.unit}"
    return {"amount": amount, "text": text}


def _where(
    scene: Scene,
    cells: CellTree,
    model: CostModel,
    views: ProblemViews,
    placement: Placement,
    settings: Settings,
    v: int,
) -> dict[str, Any]:
    """Return a problem view as something to look at: the middle of its cell and of its interval."""
    cell, interval = int(views.cell[v]), int(views.interval[v])
    n = round(90 / settings.view_space.interval_deg)
    face, i, j = split_id(interval, n)
    e = edges(n)
    box = cells.cell_box[cell] + scene.origin_m
    return {
        "problem_view": v, "cell": cell, "interval": interval, "box": box.tolist(), "position": box.mean(0).tolist(),
        "direction": direction_at(face, (e[i] + e[i + 1]) / 2, (e[j] + e[j + 1]) / 2).tolist(),
        "geometry_cost": int(views.cost[v]) + model.per_frame,
        "cost_bound": int(placement.view_cost[v]) + model.per_frame,
        "impostors": int(placement.serve_row[v + 1] - placement.serve_row[v]),
    }  # fmt: skip


def _worst_views(
    scene: Scene, cells: CellTree, model: CostModel, views: ProblemViews, placement: Placement, settings: Settings
) -> list[dict[str, Any]]:
    """Return the problem views with the highest bound, hopeless or not, ties by id."""
    order = np.lexsort((np.arange(len(views.cell)), -placement.view_cost))[:WORST_VIEWS]
    return [
        {**_where(scene, cells, model, views, placement, settings, int(v)), "hopeless": bool(placement.hopeless[v])}
        for v in order
    ]


def _hopeless(
    scene: Scene, cells: CellTree, model: CostModel, views: ProblemViews, placement: Placement, settings: Settings
) -> list[dict[str, Any]]:
    """Return the hopeless views, those farthest from the budget first, with the objects to blame."""
    ids = np.flatnonzero(placement.hopeless)
    rank = np.lexsort((ids, -placement.view_best[ids]))[:HOPELESS_VIEWS]
    out = []
    for h in rank:
        v = int(ids[h])
        blamed = placement.culprit[placement.culprit_row[h] : placement.culprit_row[h + 1]]
        where = _where(scene, cells, model, views, placement, settings, v)
        best = int(placement.view_best[v]) + model.per_frame
        out.append({**where, "best": best, "culprits": [_object(scene, int(o)) for o in blamed]})
    return out


def _culprits(scene: Scene, placement: Placement) -> list[dict[str, Any]]:
    """Return the objects blamed most often: how many hopeless views each spoils."""
    n_views = np.bincount(placement.culprit, minlength=scene.n_objects)
    order = np.lexsort((np.arange(len(n_views)), -n_views))[:CULPRITS]
    return [{**_object(scene, int(o)), "hopeless_views": int(n_views[o])} for o in order if n_views[o]]


def _object(scene: Scene, i: int) -> dict[str, Any]:
    return {
        "id": i, "name": scene.object_name[i], "box": (scene.object_box[i] + scene.origin_m).tolist(),
        "triangles": int(scene.object_triangles[i]), "calls": int(scene.object_calls[i]),
    }  # fmt: skip


def _looks(scene: Scene) -> list[dict[str, Any]]:
    """Return what no picture taken beforehand can show: how many objects have it, and how many of them stay geometry."""
    found = []
    for k, name in enumerate(LOOKS):
        has = scene.object_look >> k & 1 == 1
        kept = int((has & np.logical_not(scene.object_replaceable)).sum())
        if has.any():
            found.append(
                {"look": name, "objects": int(has.sum()), "geometry": kept, "flattened": int(has.sum()) - kept}
            )
    return found


def _curve(placement: Placement) -> list[dict[str, int]]:
    """Return what other budgets would need, see `farfield.placement.curve`; the first point is this placement's."""
    columns = zip(placement.curve_budget, placement.curve_bytes, placement.curve_over, strict=True)
    return [{"budget": int(b), "bytes": int(n), "views_over": int(v)} for b, n, v in columns]
