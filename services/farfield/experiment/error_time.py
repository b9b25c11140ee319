"""`farfield experiment error-time`: what each knob's run time buys in error; the truth is never made by what is judged.

Five knobs, each a sweep around the job's own setting: problem views (cell size, interval), visibility (rays), placement
(candidate density, time limit), image (pixel error), frame time (calibration samples). `judged` says how each is held
against the truth; jobs of a sweep share what they agree on (`sweep`).
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from farfield.errors import SettingsInvalid
from farfield.experiment.document import Job, document
from farfield.settings import Settings
from farfield.stages import Stage

HELP = "for each knob, seconds of preprocessing against the error that they buy"
CURVES = ("views", "visibility", "placement", "image", "frame")
SAID = ("curves", "bound-views", "pictures", "pairs", "samples", "boxes", "time-limit")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what only this experiment asks."""
    parser.add_argument("--curves", default=",".join(CURVES), metavar="A,B", help=f"which of {', '.join(CURVES)}")
    parser.add_argument(
        "--bound-views", type=int, default=200, metavar="N", help="problem views held against 100 cameras each"
    )
    parser.add_argument(
        "--pictures", type=int, default=200, metavar="N", help="item buffers that visible sets are held against"
    )
    parser.add_argument(
        "--pairs", type=int, default=120, metavar="N", help="pictures of impostors beside their geometry"
    )
    parser.add_argument(
        "--samples", type=Path, metavar="FILE", help="measured frames, as `farfield calibrate` takes them"
    )
    parser.add_argument("--boxes", type=int, default=64, metavar="N",
                        help="view-space cells of the job's own size that are looked at, in the middle; 0: all")  # fmt: skip
    parser.add_argument("--time-limit", type=float, metavar="S", help="begin no further curve after so many seconds")


def build(job: Job, args: argparse.Namespace) -> dict[str, Any]:
    """Run the sweeps and return the document."""
    from farfield.experiment import judged
    from farfield.experiment.facts import scene_counts
    from farfield.experiment.sweep import Sweep

    wanted = args.curves.split(",")
    if unknown := sorted(set(wanted) - set(CURVES)):
        raise SettingsInvalid("--curves", f"{unknown[0]!r} is not one of {', '.join(CURVES)}")
    started, sections = time.monotonic(), []
    with Sweep(job.scene, job.cache, workers=job.workers, tell=job.tell) as sweep:
        scene = sweep.run(job.settings, until=Stage.SCENE, label="the level").inputs().get(Stage.SCENE)
        settings = replace(
            middle(job.settings, scene, args.boxes), placement=replace(job.settings.placement, time_limit_s=None)
        )
        of = {"views": (args.bound_views,), "visibility": (args.pictures,), "placement": (), "image": (args.pairs,),
              "frame": (args.samples,)}  # fmt: skip
        for curve in CURVES:
            passed = time.monotonic() - started
            if curve not in wanted:
                continue
            if args.time_limit is not None and passed > args.time_limit:
                sections.append(judged.not_tried(curve, f"the time limit of {args.time_limit:g} s had passed"))
            else:
                sections.append(judged.JUDGED[curve](sweep, settings, *of[curve]))
    notes = [f"Looked at: {len(settings.view_space.boxes or ())} boxes of the view space, cells of "
             f"{settings.view_space.cell_m:g} m, budget {settings.budget}.",
             "A machine's first run compiles kernels, in the time of the stage that needs them first."]  # fmt: skip
    defects = [
        f"{row['name']}: {row['below_one']} bounds below the union of what cameras see"
        for section in sections for row in section.rows if row.get("below_one")
    ]  # fmt: skip
    return document(
        "error-time", "Error against run time", replace(job, settings=settings), sections,
        seconds=time.monotonic() - started, notes=notes, counts=scene_counts(scene), defects=defects,
    )  # fmt: skip


def middle(settings: Settings, scene: Any, most: int) -> Settings:
    """Return the settings with the view space cut down to about `most` cells around its middle; 0: as it is.

    Error against time is a matter of a cell, not of how many there are; what was looked at stands in the document.
    """
    boxes = scene.view_boxes + scene.origin_m
    if most:
        side = scene.cell_m * most**0.5 / 2
        centre = (boxes[:, 0].min(0) + boxes[:, 1].max(0)) / 2
        nearest = boxes.mean(1)[((boxes.mean(1) - centre) ** 2)[:, [0, 2]].sum(1).argmin()]
        low, high = boxes[:, 0].copy(), boxes[:, 1].copy()
        at = centre if ((boxes[:, 0] <= centre) & (centre <= boxes[:, 1])).all(1).any() else nearest
        for axis in (0, 2):
            low[:, axis] = low[:, axis].clip(at[axis] - side)
            high[:, axis] = high[:, axis].clip(None, at[axis] + side)
        kept = (low[:, 0] < high[:, 0]) & (low[:, 2] < high[:, 2])
        boxes = boxes if not kept.any() else [[a, b] for a, b in zip(low[kept], high[kept], strict=True)]
    return in_boxes(settings, boxes, cell_m=float(scene.cell_m))


def in_boxes(settings: Settings, boxes: Any, **more: Any) -> Settings:
    """Return the settings with a view space of boxes (B,2,3), scene metres, and what else of it is given."""
    corners: Any = tuple((tuple(map(float, low)), tuple(map(float, high))) for low, high in boxes)
    return replace(settings, view_space=replace(settings.view_space, boxes=corners, **more))
