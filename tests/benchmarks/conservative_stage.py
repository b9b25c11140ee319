"""The stage `visibility` in mode `conservative` on whole levels: time, what it drops, and rays that attack what it dropped.

    python -m benchmarks.conservative_stage munich --folder DIR --seconds 400     # again until it says that all is done

Each shard is run as the stage runs it; what is done lies in DIR, so that a run may be cut into pieces. In the end: seconds,
the share of the pairs (cell, object) which the sampling finds hidden that are proved and dropped, and random segments of
`test_conservative.Attack` from random cells at dropped objects.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np
from benchmarks.test_conservative import SCENES, Attack
from farfield.columns import dataclass_parts, unpack_dataclass
from farfield.executor import map_file, write_parts
from farfield.geometry.cells import build_cells
from farfield.scene.read import read_scene
from farfield.settings import Settings, ViewSpaceSettings
from farfield.visibility import conservative
from farfield.visibility.merge import merge
from farfield.visibility.model import Sightings, VisibleSets
from farfield.visibility.sample import Sampler, plan_shards

LEVELS = {  # scene, cell, view space: None is the derived one
    "munich": ("munich-osm", 23.0, None),
    "san-francisco": ("san-francisco-osm", 23.0, None),
    "bim": ("schependomlaan-bim", 2.0, (((-1.0, -0.6, -23.0), (22.9, 13.0, 1.0)),)),
}
RAYS = 500_000  # of the attack, a cell


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("level", choices=LEVELS)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=400.0, help="begin no further shard after so long")
    parser.add_argument("--shards", type=int, default=10**9, help="so many, drawn with seed 0")
    parser.add_argument("--attacked", type=int, default=40, help="cells")
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    name, cell_m, boxes = LEVELS[args.level]
    level = read_scene(
        SCENES / name / "scene.glb", settings=Settings(view_space=ViewSpaceSettings(cell_m=cell_m, boxes=boxes))
    )
    cells = build_cells(level.view_boxes, level.cell_m)
    settings, nodes = Settings(), plan_shards(cells)
    some = sorted(np.random.default_rng(0).permutation(nodes)[: args.shards].tolist())
    for node in some:
        if (args.folder / f"conservative-{node}.ffc").exists():
            continue
        if time.monotonic() - began > args.seconds:
            print("not done yet: run again", flush=True)
            return
        start = time.process_time()
        sampler = Sampler(level, cells, node, seed=settings.seed)
        sampler.run(rays=settings.visibility.rays, missed_ppm=settings.visibility.missed_ppm)
        write_parts(
            dataclass_parts(sampler.sightings(mode="sampled", seen_share=None)), args.folder / f"sampled-{node}.ffc"
        )
        sampled = time.process_time() - start
        sampler.keep(conservative.prove(level, cells, node, sampler.witnessed()))
        found = sampler.sightings(mode="conservative", seen_share=None, occluders=conservative.reasons(level, cells))
        seconds = np.array([sampled, time.process_time() - start])
        np.savetxt(args.folder / f"seconds-{node}.txt", seconds)
        write_parts(dataclass_parts(found), args.folder / f"conservative-{node}.ffc")
        n_cells, (first, both) = cells.stop[node] - cells.start[node], seconds
        print(f"shard {node}: {n_cells} cells, {first:.1f} + {both - first:.1f} s", flush=True)
    own = np.concatenate([np.arange(cells.start[node], cells.stop[node]) for node in some])

    def sets(mode: str) -> np.ndarray:
        parts = [unpack_dataclass(Sightings, map_file(args.folder / f"{mode}-{node}.ffc")) for node in some]
        visible: VisibleSets = merge(level, cells, parts)
        seen = np.zeros((cells.n_cells, level.n_objects), dtype=bool)
        seen[np.repeat(np.arange(cells.n_cells), np.diff(visible.row)), visible.object] = True
        return seen

    sampled, keep = sets("sampled"), sets("conservative")
    assert not (sampled & ~keep)[own].any(), "a witnessed pair was dropped"
    hidden = ~sampled[own]
    dropped = int((hidden & ~keep[own]).sum())
    seconds = sum(np.loadtxt(args.folder / f"seconds-{node}.txt") for node in some)
    print(
        f"{args.level}: {len(own)} of {cells.n_cells} cells, {level.n_objects} objects, {len(some)} of {len(nodes)} shards; "
        f"{seconds[0]:.0f} s sampling and {seconds[1] - seconds[0]:.0f} s proving on one core; "
        f"{dropped:,} of {int(hidden.sum()):,} hidden pairs dropped: {dropped / hidden.sum():.3f}; objects a cell: "
        f"{sampled[own].sum(1).mean():.1f} sampled, {keep[own].sum(1).mean():.1f} conservative", flush=True,
    )  # fmt: skip
    rng = np.random.default_rng(1)
    attack, wrong = Attack(level, cells, rng), 0
    attacked = rng.permutation(own)[: args.attacked]
    for cell in attacked:
        wrong += attack.violations(cells.cell_box[cell], keep[cell], RAYS)[0]
    print(
        f"attack: {len(attacked)} cells, {len(attacked) * RAYS:,} segments, {wrong} reached what was dropped",
        flush=True,
    )


if __name__ == "__main__":
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    main()
