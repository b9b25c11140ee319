"""Placing on a base: what still holds is kept, what does not is not, and every target is met."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.inputs import Level
from farfield.bake.bake import bake_batch, merge, plan_batches
from farfield.candidates.generate import generate, plan_shards
from farfield.candidates.generate import merge as merge_candidates
from farfield.placement.antichain import subtree_end
from farfield.placement.base import Base, keep, lacking, match, with_fresh
from farfield.placement.greedy import candidates_refit, place
from farfield.placement.model import fresh_of, only_fresh
from farfield.placement.repair import repair, verdict
from farfield.scene.identity import object_digests
from farfield.scene.model import Scene
from farfield.scene.order import object_order
from farfield.settings import CameraSettings, Settings
from farfield.viewspace.model import take
from towns import town


def base_of(level: Level) -> Base:
    p, h, cells = level.repaired, level.hierarchy, level.cells
    shown = [np.unique(level.views.cell[np.repeat(np.arange(len(level.views.cell)), np.diff(p.serve_row))[p.serve == i]])
             for i in range(len(p.cluster))]  # fmt: skip
    return Base(
        object_digest=object_digests(level.scene), object_box=level.scene.object_box, origin_m=level.scene.origin_m,
        cell_box=cells.cell_box, start=h.start[p.cluster], stop=h.stop[p.cluster], kind=p.kind, view_cell=p.view_cell,
        bytes=p.bytes, layers=p.layers, cost=p.cost, cell_row=np.cumsum([0, *map(len, shown)]),
        cell=np.concatenate(shown).astype(np.int32),
    )  # fmt: skip


def reordered(scene: Scene) -> Scene:
    order = object_order(
        scene.object_box, triangles=scene.object_triangles, calls=scene.object_calls, origin_m=scene.origin_m,
        cell_m=scene.cell_m,
    )  # fmt: skip
    columns = [f for f in Scene.__dataclass_fields__ if f.startswith("object_") and f != "object_name"]
    names = tuple(scene.object_name[o] for o in order)
    return replace(scene, object_name=names, **{name: getattr(scene, name)[order] for name in columns})


def moved(scene: Scene, objects: list[int], by: tuple[float, float, float]) -> Scene:
    matrix, box = scene.object_matrix.copy(), scene.object_box.copy()
    matrix[objects, :, 3] += by
    box[objects] += by
    return reordered(replace(scene, object_matrix=matrix, object_box=box))


def without(scene: Scene, gone: int) -> Scene:
    stay = np.arange(scene.n_objects) != gone
    columns = [f for f in Scene.__dataclass_fields__ if f.startswith("object_") and f != "object_name"]
    names = tuple(np.array(scene.object_name)[stay].tolist())
    return replace(scene, object_name=names, **{name: getattr(scene, name)[stay] for name in columns})


def kept_of(base: Base, level: Level):
    return keep(
        base, level.scene, object_digests(level.scene), level.hierarchy, level.cells, level.views,
        refit=candidates_refit(level.model, level.settings),
    )  # fmt: skip


def placed_on(base: Base, level: Level):
    """What the stages candidates to repair do."""
    kept = kept_of(base, level)
    need = level.views.cost - level.model.target
    short = lacking(kept, need=need, end=subtree_end(level.hierarchy.start, level.hierarchy.stop))
    given = level.scene, level.hierarchy, level.model, level.cells, take(level.views, short)
    fresh = merge_candidates([generate(*given, settings=level.settings, nodes=n) for n in plan_shards(level.hierarchy)])
    both = with_fresh(kept, replace(fresh, view=short[fresh.view].astype(np.int32)))
    p = place(level.scene, level.hierarchy, level.model, level.cells, level.views, both, settings=level.settings)
    given = level.scene, level.hierarchy, level.model, only_fresh(p)
    batches = plan_batches(only_fresh(p))
    baked = merge([bake_batch(*given, settings=level.settings, impostors=n, renderer="numba") for n in batches])
    mended = repair(
        p, level.hierarchy, level.model, level.cells, level.views, both, measured_bytes=baked.bytes,
        measured_cost=baked.cost, layers=np.diff(baked.layer_row).astype(np.int32),
    )  # fmt: skip
    return short, mended


@pytest.fixture(scope="module")
def old() -> Level:
    camera = CameraSettings(width=160, height=160)
    return Level("town", town(196, view_m=32.0), Settings(budget="54 calls", camera=camera))


@pytest.fixture(scope="module")
def base(old) -> Base:
    return base_of(old)


def test_matching_pairs_equal_digests_once_and_in_order():
    rows = np.random.default_rng(0).integers(0, 255, (6, 16), dtype=np.uint8)
    a, b, c, d, e, f = rows
    assert match(np.stack([a, b, a, c, a]), np.stack([d, a, c, a, e])).tolist() == [1, -1, 3, 2, -1]
    assert match(rows[:0], rows).tolist() == [] and match(rows[:2], rows[:0]).tolist() == [-1, -1]
    assert not (f == a).all()


def test_digests_see_what_shapes_a_picture_and_nothing_else(old):
    scene, before = old.scene, object_digests(old.scene)
    renamed = replace(scene, object_name=tuple("x" for _ in scene.object_name))
    np.testing.assert_array_equal(object_digests(renamed), before)
    colour = scene.material_base_color.copy()
    colour[1, 0] += np.float32(2**-20)
    painted = object_digests(replace(scene, material_base_color=colour))
    uses = scene.primitive_material[scene.mesh_primitive[scene.object_mesh]] == 1
    np.testing.assert_array_equal((painted != before).any(1), uses)
    position = scene.position.copy()
    position[scene.primitive_vertex[scene.mesh_primitive[scene.object_mesh[5]]], 1] += np.float32(2**-10)
    changed = (object_digests(replace(scene, position=position)) != before).any(1)
    assert np.flatnonzero(changed).tolist() == [5]


def test_a_level_that_did_not_change_keeps_everything(old, base):
    short, p = placed_on(base, old)
    assert not len(short) and not len(fresh_of(p))
    assert p.base.tolist() == list(range(len(base.start)))
    assert (p.view_cost <= old.repaired.view_cost).all()  # what is kept may serve cells where it was not shown
    np.testing.assert_array_equal(p.bytes, old.repaired.bytes)


def test_what_was_shown_nowhere_is_not_kept(old, base):
    """Its layers are not stored: a view would have a hole in its place."""
    gone = 0
    some = np.repeat(np.arange(len(base.start)), np.diff(base.cell_row)) != gone
    row = np.concatenate([[0], np.cumsum(some)])[base.cell_row]
    unshown = replace(base, cell_row=row, cell=base.cell[some])
    assert gone in kept_of(base, old).base and gone not in kept_of(unshown, old).base
    _, p = placed_on(unshown, old)
    assert verdict(p, old.model) == "valid" and gone not in p.base


@pytest.mark.parametrize("change", ["near", "far", "several", "gone"])
def test_a_changed_level_is_placed_on_what_still_holds(old, base, change):
    if change == "gone":
        scene = without(old.scene, 60)
    else:
        objects, by = {
            "near": ([60], (1.0, 0, 0)),
            "far": ([3], (90.0, 0, 70.0)),
            "several": ([5, 50, 99], (0, 0, 2.5)),
        }[change]
        scene = moved(old.scene, objects, by)
    level = Level("changed", scene, old.settings)
    short, p = placed_on(base, level)
    assert verdict(p, level.model) == "valid"
    assert (p.view_cost <= p.view_target).all()
    assert len(short) < len(level.views.cell) / 2
    kept = p.base >= 0
    assert kept.mean() > 0.5
    assert p.bytes.sum() <= 1.3 * level.repaired.bytes.sum()
    fresh = only_fresh(p)
    assert (fresh.base < 0).all() and len(fresh.cluster) == (p.base < 0).sum()
    assert not len(fresh.serve) and not fresh.serve_row.any()  # ids of the whole placement would mean others here
    digest = object_digests(scene)
    for i in np.flatnonzero(kept):
        c, k = p.cluster[i], p.base[i]
        now = digest[level.hierarchy.start[c] : level.hierarchy.stop[c]]
        np.testing.assert_array_equal(now, base.object_digest[base.start[k] : base.stop[k]])
        np.testing.assert_array_equal(p.view_cell[i], base.view_cell[k])


@pytest.mark.parametrize("seed", range(4))
def test_what_is_kept_is_what_would_be_baked_now(old, base, seed):
    """The bake looks at what stands beside: move a house against others, and bake every impostor that is kept."""
    rng = np.random.default_rng(seed)
    o = int(rng.integers(old.scene.n_objects))
    level = Level("changed", moved(old.scene, [o], (rng.uniform(-6, 6), 0.0, rng.uniform(-6, 6))), old.settings)
    kept = kept_of(base, level)
    some = np.flatnonzero(kept.base >= 0)
    assert len(some)
    columns = {n: getattr(kept, n)[some] for n in ("cluster", "kind", "view_cell", "bytes", "layers", "cost")}
    now = replace(old.repaired, **columns)
    then = replace(old.repaired, **{n: getattr(old.repaired, n)[kept.base[some]] for n in columns})
    for i in range(len(some)):
        a, b = (
            bake_batch(x.scene, x.hierarchy, x.model, p, settings=x.settings, impostors=(i, i + 1), renderer="numba")
            for x, p in ((level, now), (old, then))
        )
        for name in ("eye", "bytes", "cost", "plane", "corner", "tile_at", "tile_size", "tile_data"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


def test_another_view_space_keeps_what_can_be_kept(old, base):
    """Cells that are not the old ones are served where a kept view cell holds them."""
    boxes = old.scene.view_boxes.copy()
    boxes[:, 1, 0] += old.scene.cell_m
    level = Level("wider", replace(old.scene, view_boxes=boxes), old.settings)
    _, p = placed_on(base, level)
    assert verdict(p, level.model) == "valid" and (p.base >= 0).any() and len(fresh_of(p))


def test_a_moved_origin_keeps_nothing_and_is_placed_all_the_same(old, base):
    origin = old.scene.origin_m + np.array([1.0, 0.0, 0.0])
    then = replace(base, origin_m=origin, object_digest=object_digests(replace(old.scene, origin_m=origin)))
    _, p = placed_on(then, old)
    assert verdict(p, old.model) == "valid" and len(fresh_of(p)) == len(p.cluster)
