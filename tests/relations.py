"""Levels for the relations of placements, and the pipeline run in this process: stage after stage, artifacts as bytes."""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from farfield.pipeline import STEPS, Inputs
from farfield.settings import Settings, from_mapping
from farfield.stages import Stage
from levels import BOX_CORNERS, BOX_FACES, Gltf, pack_glb

STEP_M = 2.0**-8  # coordinates are multiples: sums stay exact in float64, also 2**24 m away


@dataclass(frozen=True)
class Houses:
    """Boxes (N,2,3) f64 and where the camera may be, scene metres; no two houses alike, no corner on a cell's border."""

    box: np.ndarray
    view: tuple[tuple[float, float, float], tuple[float, float, float]]
    cell_m: float = 8.0
    order: Sequence[int] | None = None  # of the nodes in the file
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def write(self, path: Path) -> Path:
        """Write a GLB: a mesh a house, its corners as they are, moved by its node."""
        level = Gltf()
        for c in ((0.8, 0.7, 0.6, 1), (0.6, 0.3, 0.2, 1)):
            level.add("materials", {"pbrMetallicRoughness": {"baseColorFactor": c}})
        for i in self.order if self.order is not None else range(len(self.box)):
            low, high = self.box[i]
            position = (BOX_CORNERS * (high - low)).astype(np.float32)
            faces = np.concatenate([BOX_FACES] * (1 + i % 3))
            mesh = level.mesh(level.primitive(position, faces, material=i % 2))
            level.node(name=f"house {i}", mesh=mesh, translation=(low + self.shift).tolist())
        path.write_bytes(level.glb())
        return path

    def settings(self, scale: float = 1.0, **more: Any) -> Settings:
        """Return settings for the houses in units of `scale` metres; keys of `more` are dotted with two underscores."""
        low, high = ([(x + d) * scale for x, d in zip(p, self.shift)] for p in self.view)
        values: dict[str, Any] = {
            "camera": {"width": 320, "height": 180}, "scene": {"unit_m": scale, "up": "y"},
            "view_space": {"cell_m": self.cell_m * scale, "boxes": [[low, high]]}, "visibility": {"mode": "off"},
        }  # fmt: skip
        for key, value in more.items():
            *path, last = key.split("__")
            node = values
            for part in path:
                node = node.setdefault(part, {})
            node[last] = value
        return from_mapping(values)


def houses(n: int = 70, *, seed: int = 0, far_m: float = 160.0) -> Houses:
    """Return a row of streets along x that begins before the view space."""
    rng = np.random.default_rng(seed)
    low = np.stack([rng.uniform(4, far_m, n), np.zeros(n), rng.uniform(-30, 30, n)], 1)
    size = np.stack([rng.uniform(3, 7, n), rng.uniform(3, 12, n), rng.uniform(3, 7, n)], 1)
    # Odd multiples of the step: no corner, middle or eye lies on a border of any cell.
    steps = lambda x: (2 * np.floor(x / (2 * STEP_M)) + 1) * STEP_M  # noqa: E731
    low = steps(low)
    return Houses(np.stack([low, low + steps(size) + STEP_M], 1), ((-24.0, 1.0, -4.0), (-8.0, 2.0, 4.0)))


@dataclass
class Run:
    """What every stage made, up to the last one that was asked for."""

    settings: Settings
    artifacts: dict[Stage, bytes] = field(default_factory=dict)

    def inputs(self, scene_file: Path | None = None) -> Inputs:
        digests = {stage: hashlib.sha256(content).hexdigest() for stage, content in self.artifacts.items()}
        return Inputs(self.settings, dict(self.artifacts), digests, scene_file)

    def get(self, stage: Stage) -> Any:
        return self.inputs().get(stage)


def run(
    scene_file: Path,
    settings: Settings,
    *,
    until: Stage = Stage.PLACEMENT,
    order: Callable[[list[Any]], list[Any]] = list,
    one_shard: bool = False,
) -> Run:
    """Run the stages up to `until`; the shards of each in the order that `order` gives them.

    one_shard  do not cut the candidates: where their shards are cut shapes which of them are kept
    """
    done = Run(settings)
    for stage in Stage:
        step = STEPS[stage]
        inputs = done.inputs(scene_file)
        shards = [] if step.skip(inputs) else json.loads(json.dumps(step.plan(inputs)))
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


def differences(one: Any, other: Any, *, length_factor: float | None = None) -> list[str]:
    """Return the columns of two artifacts (dataclasses) in which they differ.

    length_factor  a column may also be `length_factor` or its powers times the other, number by number: lengths, areas
    """
    found = []
    for f in fields(one):
        a, b = getattr(one, f.name), getattr(other, f.name)
        if not isinstance(a, np.ndarray):
            same = a == b or (length_factor is not None and isinstance(a, float) and b == a * length_factor)
        elif a.shape != b.shape or a.dtype != b.dtype:
            same = False
        elif length_factor is not None and a.dtype.kind == "f":
            powers = [a * length_factor**k for k in (0, 1, -1, 2)]
            same = bool(np.any([p.view(np.int64) == b.view(np.int64) for p in powers], axis=0).all())
        else:
            same = a.tobytes() == b.tobytes()
        if not same:
            found.append(f.name)
    return found


def served(run: Run) -> list[tuple[frozenset[str], int, int, int]]:
    """Return the chosen impostors as (objects by name, bytes, cost, views that show it), sorted: no ids, no places."""
    scene, clusters, placed = run.get(Stage.SCENE), run.get(Stage.HIERARCHY), run.get(Stage.PLACEMENT)
    views = np.bincount(placed.serve, minlength=len(placed.cluster))
    rows = []
    for i, c in enumerate(placed.cluster.tolist()):
        names = frozenset(scene.object_name[clusters.start[c] : clusters.stop[c]])
        rows.append((names, int(placed.bytes[i]), int(placed.cost[i]), int(views[i])))
    return sorted(rows, key=lambda r: (sorted(r[0]), r[1:]))


def edited(glb: bytes, edit: Callable[[dict[str, Any]], None]) -> bytes:
    """Return a GLB whose JSON document `edit` has changed in place."""
    size = int.from_bytes(glb[12:16], "little")
    document = json.loads(glb[20 : 20 + size])
    edit(document)
    return pack_glb(json.dumps(document).encode(), glb[28 + size :])


def shuffled_nodes(document: dict[str, Any]) -> None:
    """Give the nodes of a flat glTF document another order."""
    order = np.random.default_rng(0).permutation(len(document["nodes"])).tolist()
    document["nodes"] = [document["nodes"][i] for i in order]
