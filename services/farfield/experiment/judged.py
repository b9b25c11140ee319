"""The five curves of error against run time: each runs its sweep, holds it against the truth, and returns its section."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from farfield.experiment.document import Column, Plot, Section, Series, pareto
from farfield.experiment.sweep import Sweep
from farfield.settings import Settings
from farfield.stages import Stage

CAMERAS = 100  # of one problem view
BARE = {
    "candidates": "environment",
    "far_m": 1e9,
    "bound": "off",
}  # nothing lies so far off: problem views, no impostors
TITLES = {"views": "Problem views", "visibility": "Visibility", "placement": "Placement", "image": "Image",
          "frame": "Frame time"}  # fmt: skip
_NAME, _SECONDS = Column(key="name", label="setting"), Column(key="cpu_seconds", label="processor s", digits=2)


def not_tried(curve: str, why: str) -> Section:
    """Return a section that says why there is no curve."""
    return Section(key=curve, title=TITLES[curve], text="", truth="-", samples="none.", missing=why)


def _placing(settings: Settings, **changes: Any) -> Settings:
    return replace(settings, placement=replace(settings.placement, **changes))


def _no_proof(settings: Settings) -> Settings:
    return replace(settings, proof=replace(settings.proof, mode="off"))


def _plot(key: str, title: str, rows: Sequence[dict[str, Any]], errors: dict[str, str], *, y: str, level: float | None = None,
          level_label: str = "", log_y: bool = False) -> Plot:  # fmt: skip
    """Return error over processor seconds; `errors`: row key -> name of its series. Marks the job's own and the Pareto front."""
    series = []
    for key_y, name in errors.items():
        some = [r for r in rows if r.get(key_y) is not None and r.get("cpu_seconds") is not None]
        if not some:
            continue
        xs, ys = tuple(float(r["cpu_seconds"]) for r in some), tuple(float(r[key_y]) for r in some)
        marked = tuple(i for i, r in enumerate(some) if r["mark"] == "current")
        series.append(Series(name=name, x=xs, y=ys, line=False, marked=marked, pareto=pareto(xs, ys),
                             labels=tuple(r["name"] for r in some)))  # fmt: skip
    return Plot(key=key, title=title, x="processor seconds", y=y, series=tuple(series), log_x=True, log_y=log_y, level=level,
                level_label=level_label)  # fmt: skip


def _front(rows: Sequence[dict[str, Any]], error: str) -> str:
    """Return the sentence that names the Pareto-optimal settings."""
    some = [r for r in rows if r.get(error) is not None and r.get("cpu_seconds") is not None]
    best = pareto([r["cpu_seconds"] for r in some], [r[error] for r in some])
    for i in best:
        some[i]["pareto"] = True
    return "Pareto-optimal: " + (", ".join(some[i]["name"] for i in best) or "none") + "."


def views(sweep: Sweep, settings: Settings, count: int) -> Section:
    """Return how far bounds of problem views lie above what cameras see, over cell size and interval."""
    cell_m, interval = settings.view_space.cell_m or 1.0, settings.view_space.interval_deg
    at = [(cell_m * k, interval) for k in (2, 1, 0.5)] + [
        (cell_m, d) for d in (interval * 2, interval / 2) if d in (45, 22.5, 11.25, 5.625)
    ]
    rows = []
    for size, degrees in at:
        name = f"{size:g} m, {degrees:g}°"
        one = _no_proof(_placing(settings, **BARE))
        one = replace(one, view_space=replace(one.view_space, cell_m=size, interval_deg=degrees))
        ran = sweep.run(one, until=Stage.PLACEMENTDB, label=name, skip=(Stage.BOUND,))
        shares = [(count // 4 + (k < count % 4), k) for k in range(4)]
        parts = sweep.measure("farfield.experiment.truths:bounds", ran, [s for s in shares if s[0]], label=name)
        union = sorted(r for p in parts for r in p["union"])
        worst = sorted(r for p in parts for r in p["worst"])
        rows.append({
            "name": name, "cell_m": size, "interval_deg": degrees, "cpu_seconds": ran.cpu_seconds(Stage.VIEWSPACE),
            "problem_views": parts[0]["of_views"], "tried": len(union), "cameras": len(union) * CAMERAS,
            "median": _quantile(union, 0.5), "p95": _quantile(union, 0.95), "least": union[0] if union else None,
            "most": union[-1] if union else None, "worst_median": _quantile(worst, 0.5), "worst_p95": _quantile(worst, 0.95),
            "below_one": sum(r < 1 for r in union),
            "wrongly_flagged": sum(p["wrongly_flagged"] for p in parts) / len(union) if union else None,
            "mark": "current" if (size, degrees) == (cell_m, interval) else "",
        })  # fmt: skip
    columns = (
        _NAME, Column(key="problem_views", label="problem views"), Column(key="tried", label="tried"),
        Column(key="cameras", label="cameras"), Column(key="median", label="over union, median", digits=4),
        Column(key="p95", label="95 %", digits=4), Column(key="least", label="least", digits=4),
        Column(key="most", label="most", digits=4), Column(key="worst_median", label="over worst view, median", digits=3),
        Column(key="worst_p95", label="95 %", digits=3), Column(key="wrongly_flagged", label="wrongly flagged", digits=3),
        Column(key="below_one", label="below 1"), _SECONDS,
    )  # fmt: skip
    return Section(
        key="views", title=TITLES["views"], columns=columns, rows=tuple(rows),
        text="The stated cost of a problem view as geometry, over the cost of all that densely sampled cameras of its cell and "
        "interval draw together, and over the dearest of them. A problem view is wrongly flagged where no camera of it costs "
        "more than the budget. " + _front(rows, "median"),
        truth="cameras with verify's own clipping and sum (evaluation/bound); ratios are too large for few cameras, never too "
        "small. Time is that of the stage viewspace.",
        samples=f"{CAMERAS} cameras in each of the random problem views in column 'tried'.",
        plots=(
            _plot("views-union", "Bound over the union of cameras", rows, {"median": "median", "p95": "95 %"}, y="ratio", level=1,
                  level_label="exact"),
            _plot("views-worst", "Bound over the worst camera", rows, {"worst_median": "median", "worst_p95": "95 %"}, y="ratio",
                  level=1, level_label="exact"),
            _plot("views-flagged", "Problem views that no camera confirms", rows, {"wrongly_flagged": "share"}, y="share"),
        ),
    )  # fmt: skip


def visibility(sweep: Sweep, settings: Settings, pictures: int) -> Section:
    """Return what visible sets lack, over the rays that were cast."""
    from farfield.bake.gl.context import NoContext

    rays = settings.visibility.rays
    sampled = replace(settings, visibility=replace(settings.visibility, mode="sampled"))
    tried = [(f"{n:,} rays a cell", replace(sampled.visibility, rays=n, missed_ppm=1e-3)) for n in
             (max(1000, rays // 64), max(1000, rays // 16), max(1000, rays // 4), rays)]  # fmt: skip
    tried.append((f"until {sampled.visibility.missed_ppm:g} ppm", sampled.visibility))
    runs = []
    for name, how in tried:
        runs.append((name, sweep.run(replace(sampled, visibility=how), until=Stage.VISIBILITY, label=name)))
    off = replace(settings, visibility=replace(settings.visibility, mode="off"))
    level = sweep.run(_no_proof(_placing(off, **BARE)), until=Stage.PLACEMENTDB, label="the level", skip=(Stage.BOUND,))
    sets = [str(ran.artifacts[Stage.VISIBILITY]) for _, ran in runs]
    try:
        [seen] = sweep.measure(
            "farfield.experiment.item_buffers:missed_apart",
            level,
            [(sets, pictures, settings.seed)],
            label="item buffers",
        )
    except NoContext as error:
        return not_tried("visibility", f"there is no OpenGL here: {error}")
    if not seen["views"]:
        return not_tried("visibility", "no viewpoint under the open sky was found in the view space")
    rows = []
    for (name, ran), found in zip(runs, seen["found"], strict=True):
        sets_of = ran.inputs().get(Stage.VISIBILITY)
        rows.append({
            "name": name, "rays": int(sets_of.rays), "cpu_seconds": ran.cpu_seconds(Stage.VISIBILITY), **found,
            "ppm": 1e6 * found["missed_pixels"] / seen["pixels"], "missed_share": found["missed_pairs"] / max(seen["pairs"], 1),
            "stated_ppm": sets_of.missed_ppm_upper, "mark": "current" if name.startswith("until") else "",
        })  # fmt: skip
    columns = (
        _NAME, Column(key="rays", label="rays in all"), Column(key="missed_pairs", label="missed pairs of object and cell"),
        Column(key="missed_share", label="of the pairs seen", digits=5), Column(key="ppm", label="missed pixels, ppm", digits=2),
        Column(key="stated_ppm", label="stated bound, ppm", digits=1), _SECONDS,
    )  # fmt: skip
    return Section(
        key="visibility", title=TITLES["visibility"], columns=columns, rows=tuple(rows),
        text="Objects that a picture shows from a cell and that the cell's visible set lacks, as pixels a million and as "
        "distinct pairs. " + _front(rows, "ppm"),
        truth=f"item buffers of the level's file, rasterised by {seen['renderer']} from fresh random viewpoints "
        "under the open sky.",
        samples=f"{seen['views']} pictures of 512 x 512, {seen['pairs']:,} pairs of object and cell in them.",
        plots=(_plot("visibility", "Missed pixels over time", rows, {"ppm": "missed", "stated_ppm": "stated bound"},
                     y="pixels a million"),
               _plot("visibility-pairs", "Missed pairs over time", rows, {"missed_share": "share of the pairs seen"}, y="share")),
    )  # fmt: skip


def placement(sweep: Sweep, settings: Settings) -> Section:
    """Return memory over the lower bound, over candidate density and time limit."""
    proven = _placing(settings, bound="auto" if settings.placement.bound == "off" else settings.placement.bound)
    own = proven.placement.density
    rows: list[dict[str, Any]] = []
    full_s: float | None = None
    for density in sorted({0.05, 0.2, own, 5.0}):
        name = f"density {density:g}"
        one = _placing(proven, density=density)
        ran = sweep.run(one, until=Stage.BOUND, label=name, skip=(Stage.BAKE, Stage.REPAIR))
        rows.append(_placed(name, ran, density == own))
        if density == own:
            full_s = ran.seconds(Stage.PLACEMENT)
    for share in (0.1, 0.3) if full_s else ():
        limit_s = round(max(0.05, share * (full_s or 0)), 2)
        name = f"limit {limit_s:g} s"
        ran = sweep.run(_placing(proven, time_limit_s=limit_s), until=Stage.BOUND, label=name, apart=f"limit-{limit_s:g}",
                        skip=(Stage.BAKE, Stage.REPAIR))  # fmt: skip
        rows.append(_placed(name, ran, False))
    richest = rows[[r["name"] for r in rows].index("density 5")]["lower_bytes"]
    for row in rows:
        row["over_richest"] = row["placed_bytes"] / richest - 1 if richest else None
    columns = (
        _NAME, Column(key="candidates", label="candidates"), Column(key="impostors", label="impostors"),
        Column(key="hopeless", label="hopeless"), Column(key="stopped", label="stopped by the clock"),
        Column(key="placed_bytes", label="bytes (estimated)"),
        Column(key="lower_bytes", label="lower bound"), Column(key="gap", label="memory / its bound - 1", digits=3),
        Column(key="over_richest", label="memory / bound of the richest offer - 1", digits=3), _SECONDS,
    )  # fmt: skip
    return Section(
        key="placement", title=TITLES["placement"], columns=columns, rows=tuple(rows),
        text="Bytes before the bake over what no choice can weigh less than: among the same candidates, and among those of "
        "density 5, of which the others are"
        " about subsets. " + _front(rows, "over_richest"),
        truth="the lower bound, a linear programme or Lagrangian prices, proven in integers (placement/bound); it shares the "
        "candidates with what is judged, not the search.",
        samples="every problem view; one run each. Time is that of the stages candidates and placement.",
        plots=(_plot("placement", "Memory over its lower bound", rows,
                     {"over_richest": "richest offer's bound", "gap": "own bound"}, y="memory / bound - 1"),),
    )  # fmt: skip


def _placed(name: str, ran: Any, current: bool) -> dict[str, Any]:
    inputs = ran.inputs()
    bound, placed = inputs.get(Stage.BOUND), inputs.get(Stage.PLACEMENT)
    return {
        "name": name, "candidates": len(inputs.get(Stage.CANDIDATES).cluster), "impostors": len(placed.cluster),
        "hopeless": int(placed.hopeless.sum()), "placed_bytes": int(placed.bytes.sum()), "lower_bytes": int(bound.lower_bytes),
        "gap": bound.placed_bytes / bound.lower_bytes - 1 if bound.lower_bytes else None, "stopped": bool(placed.stopped),
        "cpu_seconds": ran.cpu_seconds(Stage.CANDIDATES, Stage.PLACEMENT), "mark": "current" if current else "",
    }  # fmt: skip


def image(sweep: Sweep, settings: Settings, pairs: int) -> Section:
    """Return parallax and FLIP of impostors against their geometry, over the pixel error."""
    own, rows, renderer = settings.quality.pixel_error, [], None
    for error in sorted({own / 2, own, own * 2, own * 4}):
        name = f"{error:g} px"
        one = _no_proof(replace(_placing(settings, bound="off"), quality=replace(settings.quality, pixel_error=error)))
        ran = sweep.run(one, until=Stage.PLACEMENTDB, label=name, skip=(Stage.BOUND,))
        calls = [(pairs // 2 * k, pairs // 2 if k == 0 else pairs - pairs // 2, settings.seed) for k in (0, 1)]
        found = sweep.measure("farfield.experiment.truths:pictures", ran, calls, label=name)
        proof = _merged(found)
        if proof["not_proven"]:
            return not_tried("image", proof["not_proven"])
        renderer, repaired = proof["renderer"], ran.inputs().get(Stage.REPAIR)
        rows.append({
            "name": name, "pixel_error": error, "pairs": proof["pairs"], "max_px": proof["worst_displacement_px"],
            "mean_px": proof["mean_displacement_px"], "flip": proof["flip"], "flip_p95": proof["flip_p95"],
            "in_view": proof["pairs_in_view"], "crack_px": proof["crack_px"], "megabytes": float(repaired.bytes.sum()) / 1e6,
            "layers": int(repaired.layers.sum()),
            "hopeless": int(repaired.hopeless.sum()),
            "cpu_seconds": ran.cpu_seconds(Stage.CANDIDATES, Stage.PLACEMENT, Stage.BAKE),
            "mark": "current" if error == own else "",
        })  # fmt: skip
    columns = (
        _NAME, Column(key="hopeless", label="hopeless views"),
        Column(key="layers", label="layers"), Column(key="megabytes", label="MB", digits=2),
        Column(key="pairs", label="pairs"), Column(key="max_px", label="largest parallax, px", digits=3),
        Column(key="mean_px", label="mean, px", digits=3), Column(key="in_view", label="pairs in view"),
        Column(key="flip", label="FLIP, mean", digits=4), Column(key="flip_p95", label="95 %", digits=3),
        Column(key="crack_px", label="crack pixels"), _SECONDS,
    )  # fmt: skip
    return Section(
        key="image", title=TITLES["image"], columns=columns, rows=tuple(rows),
        text="The admissible parallax decides how many layers an impostor has; doubling the output's resolution is the"
        " same as halving it. " + _front(rows, "mean_px"),
        truth=f"pictures of the level with the impostor and with its geometry, drawn by the proof's own renderer ({renderer}) "
        "from random viewpoints in the view cells.",
        samples=f"{pairs} pairs of an impostor and a viewpoint a row. Time is that of candidates, placement and bake.",
        plots=(_plot("image", "Parallax over time", rows, {"max_px": "largest", "mean_px": "mean"}, y="pixels", log_y=True),
               _plot("image-flip", "FLIP over time", rows, {"flip": "mean", "flip_p95": "95 %"}, y="FLIP")),
    )  # fmt: skip


def _merged(parts: list[dict[str, Any]]) -> dict[str, Any]:
    from farfield.evaluation.proof.merge import merge_proofs

    return merge_proofs(parts, confidence=0.95)


def frame(sweep: Sweep, settings: Settings, samples: Path | None) -> Section:
    """Return how far predicted frame times lie from measured ones, over how many frames the profile was fitted to."""
    from farfield.experiment.truths import fitted

    if samples is None:
        return not_tried(
            "frame",
            "no measured frames: the viewer records them on the target device (docs/calibration.md); "
            "give them with --samples FILE",
        )
    rows = fitted(samples)
    if rows:
        rows[-1]["mark"] = "current"
    columns = (
        _NAME, Column(key="held_out", label="held out"), Column(key="mean_ms", label="predicted - measured, mean ms", digits=3),
        Column(key="p95_ms", label="95 %", digits=3), Column(key="under_share", label="share under-estimated", digits=3),
        Column(key="why", label="not fitted"), Column(key="cpu_seconds", label="s measured", digits=2),
    )  # fmt: skip
    return Section(
        key="frame", title=TITLES["frame"], columns=columns, rows=tuple(rows),
        text="A profile is fitted to the first frames of a shuffled list and asked for those that it has not seen. Time is"
        " what the device spent drawing what it was fitted to. " + _front(rows, "mean_ms"),
        truth="frames that the viewer timed on the target device.", samples=f"{samples.name}.",
        plots=(_plot("frame", "Predicted minus measured", rows, {"mean_ms": "mean", "p95_ms": "95 %"}, y="ms"),
               _plot("frame-under", "Frames that took longer than predicted", rows, {"under_share": "share"}, y="share")),
    )  # fmt: skip


def _quantile(values: Sequence[float], share: float) -> float | None:
    return float(np.quantile(values, share)) if values else None


JUDGED: dict[str, Callable[..., Section]] = {
    "views": views, "visibility": visibility, "placement": placement, "image": image, "frame": frame,
}  # fmt: skip
