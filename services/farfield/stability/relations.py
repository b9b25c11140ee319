"""Relations that hold exactly between placements of one level in different guise.

Scaled by a power of two, its objects in another order, its shards run in another order, mirrored, with a larger budget;
and the lazy greedy against one that scores everything before each choice.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from farfield.stability.level import Level, street
from farfield.stability.run import Run, run
from farfield.stages import Stage

COMPARED = (Stage.RENDERTIME, Stage.HIERARCHY, Stage.VIEWSPACE, Stage.CANDIDATES, Stage.PLACEMENT)
BUDGET = "24 calls"


@dataclass(frozen=True, slots=True, kw_only=True)
class Relation:
    """What was compared, and what differs: nothing, where the relation holds."""

    name: str
    compared: str
    differs: tuple[str, ...]


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


def served(done: Run) -> list[tuple[frozenset[str], int, int, int]]:
    """Return the chosen impostors as (objects by name, bytes, cost, views that show it), sorted: no ids, no places."""
    scene, clusters, placed = done.get(Stage.SCENE), done.get(Stage.HIERARCHY), done.get(Stage.PLACEMENT)
    views = np.bincount(placed.serve, minlength=len(placed.cluster))
    rows = []
    for i, c in enumerate(placed.cluster.tolist()):
        names = frozenset(scene.object_name[clusters.start[c] : clusters.stop[c]])
        rows.append((names, int(placed.bytes[i]), int(placed.cost[i]), int(views[i])))
    return sorted(rows, key=lambda r: (sorted(r[0]), r[1:]))


def _all_stages(one: Run, other: Run, factor: float | None = None) -> tuple[str, ...]:
    return tuple(
        f"{stage}.{column}"
        for stage in COMPARED
        for column in differences(one.get(stage), other.get(stage), length_factor=factor)
    )


def _placed(level: Level, folder: Path, budget: str = BUDGET, **more: Any) -> Run:
    return run(level.write(folder / "scene.glb"), level.settings(budget=budget), **more)


def scaling(level: Level, plain: Run, folder: Path) -> Relation:
    """Every length times a power of two: bit for bit the same decisions, the same bytes of memory."""
    differs: tuple[str, ...] = ()
    for factor in (2.0**-10, 2.0**7):
        differs += _all_stages(plain, _placed(replace(level, unit_m=factor), folder), factor)
    return Relation(name="scaling", compared="all lengths times 2^-10 and 2^7, bit for bit", differs=differs)


def permutation(level: Level, plain: Run, folder: Path) -> Relation:
    """The objects in another order in the file: the same bytes of every artifact."""
    order = np.random.default_rng(1).permutation(len(level.box)).tolist()
    other = _placed(replace(level, order=order), folder)
    differs = tuple(str(stage) for stage in plain.artifacts if plain.artifacts[stage] != other.artifacts[stage])
    return Relation(
        name="permutation", compared="objects in another order in the file: every artifact", differs=differs
    )


def sharding(level: Level, plain: Run, folder: Path) -> Relation:
    """The shards of every stage run in another order: the same bytes."""
    other = _placed(level, folder, order=lambda shards: shards[::-1])
    differs = tuple(str(stage) for stage in plain.artifacts if plain.artifacts[stage] != other.artifacts[stage])
    return Relation(name="order of shards", compared="the last shard first: every artifact", differs=differs)


def mirror(level: Level, plain: Run, folder: Path) -> Relation:
    """Reflected, without ties: the same objects replaced at the same bytes, cost and number of views."""
    differs = []
    for axis in (0, 2):
        one, other = (_placed(x, folder, one_shard=True) for x in (level, level.mirrored(axis)))
        if served(one) != served(other):
            differs.append(f"impostors, axis {axis}")
        for stage, column in ((Stage.VIEWSPACE, "cost"), (Stage.PLACEMENT, "view_cost")):
            if sorted(getattr(one.get(stage), column).tolist()) != sorted(getattr(other.get(stage), column).tolist()):
                differs.append(f"{stage}.{column}, axis {axis}")
    return Relation(name="mirror", compared="reflected in x and z: impostors, costs", differs=tuple(differs))


def larger_budget(level: Level, plain: Run, folder: Path) -> Relation:
    """A larger budget: its problem views are among those of every smaller one."""
    before: set[tuple[int, int]] | None = None
    differs = []
    amounts = range(16, 44, 4)
    for amount in amounts:
        found = _placed(level, folder, f"{amount} calls", until=Stage.VIEWSPACE).get(Stage.VIEWSPACE)
        views = set(zip(found.cell.tolist(), found.interval.tolist(), strict=True))
        if before is not None and not views <= before:
            differs.append(f"{len(views - before)} new problem views at {amount} calls")
        before = views
    compared = f"problem views at {amounts[0]} to {amounts[-1]} calls are nested"
    return Relation(name="larger budget", compared=compared, differs=tuple(differs))


def lazy_greedy(level: Level, plain: Run, folder: Path) -> Relation:
    """The lazy greedy's choices against those of one that scores every candidate before each of them."""
    from farfield.placement.antichain import subtree_end
    from farfield.placement.choose import choose
    from farfield.stability.naive import greedy

    hierarchy, views = plain.get(Stage.HIERARCHY), plain.get(Stage.VIEWSPACE)
    candidates, target = plain.get(Stage.CANDIDATES), plain.get(Stage.PLACEMENT).view_target
    excess = np.maximum(views.cost - target, 0)
    end = subtree_end(hierarchy.start, hierarchy.stop)
    lazy = choose(candidates, excess=excess, end=end, everywhere=False).step.tolist()
    naive = greedy(candidates, excess=excess, end=end)
    differs = () if lazy == naive else (f"choices {lazy[:5]}... and {naive[:5]}...",)
    return Relation(name="lazy = naive", compared=f"{len(naive)} choices of the greedy, in order", differs=differs)


RELATIONS: tuple[Callable[[Level, Run, Path], Relation], ...] = (
    scaling, permutation, sharding, mirror, larger_budget, lazy_greedy,
)  # fmt: skip


def check_relations(n_objects: int = 40) -> list[Relation]:
    """Return every relation, tried on one street."""
    level = street(n_objects)
    with tempfile.TemporaryDirectory(prefix="farfield-") as folder:
        plain = _placed(level, Path(folder))
        assert len(plain.get(Stage.PLACEMENT).cluster) > 2, "nothing was placed: the relations would hold of nothing"
        return [relation(level, plain, Path(folder)) for relation in RELATIONS]
