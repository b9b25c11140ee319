"""Layered environment maps: what is in them, that their layers hold, and that a closed room stays closed."""

from dataclasses import replace

import numpy as np
import pytest
from farfield.candidates.environment import REACH, far_clusters, generate_maps, map_of, merge, plan_shards
from farfield.candidates.generate import generate
from farfield.candidates.generate import merge as merge_shards
from farfield.candidates.generate import plan_shards as cluster_shards
from farfield.candidates.model import BOX
from farfield.evaluation.proof.merge import merge_proofs
from farfield.evaluation.proof.prove import prove
from farfield.evaluation.verify import verify
from farfield.geometry.cells import build_cells
from farfield.hierarchy.build import build_hierarchy
from farfield.impostor.plan import precision
from farfield.placement.greedy import place
from farfield.placement.repair import verdict
from farfield.placementdb.read import Placement
from farfield.rendertime.cost import build_cost_model
from farfield.settings import Settings, from_mapping
from farfield.stability.run import run
from farfield.stages import Stage
from farfield.steps.result import write_files
from farfield.viewspace.split import find_problem_views
from farfield.visibility.model import VisibleSets
from naive import environment as naive
from rooms import blocks, room_settings, write_room
from towns import town

OFF = VisibleSets(mode="off", row=np.zeros(0, np.int64), object=np.zeros(0, np.int32))


def settings_of(budget: str = "60 calls", candidates: str = "environment", far_m: float = 70.0) -> Settings:
    return from_mapping({
        "budget": budget, "camera": {"width": 320, "height": 180}, "view_space": {"interval_deg": 22.5},
        "placement": {"candidates": candidates, "far_m": far_m},
    })  # fmt: skip


@pytest.fixture(scope="module")
def stages():
    scene, settings = town(400, view_m=32.0), settings_of()
    hierarchy, model = build_hierarchy(scene), build_cost_model(scene, settings=settings)
    cells = build_cells(scene.view_boxes, scene.cell_m)
    views = find_problem_views(scene, hierarchy, model, OFF, settings=settings, node=0)
    return scene, hierarchy, model, cells, views


@pytest.mark.parametrize("far_m", [1.0, 25.0, 70.0, 110.0, 1000.0])
def test_an_object_is_wholly_in_the_map_or_wholly_geometry(stages, far_m):
    scene, hierarchy, _, cells, _ = stages
    for cell in cells.cell_box[:3]:
        cluster, face = far_clusters(hierarchy, cell, far_m)
        assert list(zip(cluster.tolist(), face.tolist(), strict=True)) == naive.far_clusters(
            hierarchy, cell, far_m, REACH
        )
        count = np.zeros(scene.n_objects, int)
        for c in cluster:
            count[hierarchy.start[c] : hierarchy.stop[c]] += 1
        assert count.max() <= 1
        beyond = np.array([max(naive.gaps(box, cell)) for box in scene.object_box])
        assert not count[beyond < far_m].any()
        if far_m >= 25:  # nearer than its own size an object may be too wide for any face
            assert count[beyond >= far_m].all()
    if far_m == 70.0:
        assert (
            len(set(face.tolist())) == 4
            and (np.diff(np.stack([hierarchy.start, hierarchy.stop])[:, cluster], axis=0) > 1).any()
        )


def test_all_of_a_face_lies_in_one_grid_and_one_stack_of_layers(stages):
    _, hierarchy, _, cells, _ = stages
    settings, cell = settings_of(), cells.cell_box[1]
    plans = map_of(hierarchy, cell, settings)
    face_of = dict(zip(*(a.tolist() for a in far_clusters(hierarchy, cell, 70.0)), strict=True))
    assert plans.keys() == face_of.keys()
    for face in set(face_of.values()):
        of = [plans[c] for c in plans if face_of[c] == face]
        assert len({p.eye.tobytes() + p.right.tobytes() + p.up.tobytes() + p.texel.tobytes() for p in of}) == 1
        at = np.array([p.slope0 / p.texel for p in of])
        assert np.abs(at - at[0] - np.rint(at - at[0])).max() < 1e-6
        plane = {float(x): (float(a), float(b)) for p in of for x, a, b in zip(p.plane, p.near, p.far, strict=True)}
        assert all(plane[float(x)] == (a, b) for p in of for x, a, b in zip(p.plane, p.near, p.far, strict=True))
    for c, p in plans.items():
        assert np.array_equal(np.cross(p.right, p.up), p.back) and (p.near[1:] == p.far[:-1]).all()
        box = hierarchy.box[c]
        corners = np.array([[box[k >> a & 1, a] for a in range(3)] for k in range(8)]) - p.eye
        ahead = -(corners @ p.back)
        assert p.near[0] <= ahead.min() and ahead.max() <= p.far[-1]
        grid = np.stack([corners @ p.right, corners @ p.up], 1) / ahead[:, None]
        texels = (grid - p.slope0) / p.texel
        assert (texels >= -1e-6).all() and (texels <= p.resolution + 1e-6).all()


def test_no_point_is_off_by_more_than_the_pixel_error_and_no_gap_opens(stages):
    """Attack: random points, texel edges and viewpoints on and in the cell, corners first, in three dimensions."""
    _, hierarchy, _, cells, _ = stages
    settings, cell = settings_of(), cells.cell_box[2]
    p, rng = precision(settings), np.random.default_rng(3)
    corners = np.array([[cell[k >> a & 1, a] for a in range(3)] for k in range(8)])
    viewpoints = np.concatenate([corners, rng.uniform(cell[0], cell[1], (40, 3))])
    worst_angle = worst_step = 0.0
    for c, plan in map_of(hierarchy, cell, settings).items():
        axes, box = np.stack([plan.right, plan.up, -plan.back]), hierarchy.box[c]
        eye = (viewpoints - plan.eye) @ axes.T
        point = (rng.uniform(box[0], box[1], (60, 3)) - plan.eye) @ axes.T
        k = np.clip(np.searchsorted(plan.far, point[:, 2]), 0, len(plan.plane) - 1)
        drawn = point * (plan.plane[k] / point[:, 2])[:, None]
        a, b = (x[None] - eye[:, None] for x in (point, drawn))
        cross, dot = np.cross(a, b), (a * b).sum(-1)
        angle = np.arctan2(np.sqrt((cross * cross).sum(-1)), dot)
        worst_angle = max(worst_angle, float(angle.max()))
        if len(plan.plane) == 1:
            continue
        edge = plan.slope0 + rng.integers(1, plan.resolution, (60, 2)) * plan.texel
        k = rng.integers(0, len(plan.plane) - 1, 60)
        front, back = plan.plane[k], plan.plane[k + 1]
        on = np.concatenate([edge * front[:, None], front[:, None]], 1)
        through = on[None] - eye[:, None]
        there = eye[:, None] + through * ((back - eye[:, 2:]) / through[:, :, 2])[:, :, None]
        moved = np.abs(there[:, :, :2] - (edge * back[:, None])[None]) / (plan.texel * back[:, None])[None]
        worst_step = max(worst_step, float(moved.max()))
    assert 0.3 * p.dl < 2 * np.tan(worst_angle / 2) <= p.dl * (1 + 1e-9)
    assert 0.3 < worst_step <= 1 + 1e-9


def test_shards_leave_no_trace_and_candidates_are_sorted(stages):
    _, hierarchy, model, cells, views = stages
    settings = settings_of()
    made = lambda shards: merge([  # noqa: E731
        generate_maps(hierarchy, model, cells, views, settings=settings, leaves=leaves) for leaves in shards
    ])  # fmt: skip
    whole, parts = made(plan_shards(views)), made([(c, c + 1) for c in range(cells.n_cells)])
    for name in ("cluster", "kind", "view_cell", "bytes", "layers", "cost", "row", "view", "saved"):
        assert np.array_equal(getattr(whole, name), getattr(parts, name)), name
    assert (np.diff(whole.cluster) >= 0).all() and (whole.saved > 0).all() and (whole.kind == BOX).all()
    assert len(np.unique(np.column_stack([whole.cluster, whole.view_cell]), axis=0)) == len(whole.cluster) > 20


def test_every_map_is_placed_whole_and_what_it_cannot_help_is_hopeless(stages):
    scene, hierarchy, model, cells, views = stages
    settings = settings_of()
    candidates = merge([
        generate_maps(hierarchy, model, cells, views, settings=settings, leaves=leaves) for leaves in plan_shards(views)
    ])  # fmt: skip
    placed = place(scene, hierarchy, model, cells, views, candidates, settings=settings)
    assert len(placed.cluster) == len(candidates.cluster) and np.array_equal(placed.bytes, candidates.bytes)
    assert verdict(placed, model) == "infeasible" and 0 < placed.hopeless.sum() < len(views.cell)
    assert ((placed.view_cost > 60) == placed.hopeless).all()
    assert placed.smallest_budget == placed.view_cost.max() > 60
    roomy = replace(model, budget=placed.smallest_budget)
    enough = place(scene, hierarchy, roomy, cells, views, candidates, settings=settings)
    assert verdict(enough, roomy) == "valid" and np.array_equal(enough.view_cost, placed.view_cost)
    near = [max(naive.gaps(scene.object_box[o], cells.cell_box[views.cell[v]])) < 70.0
            for h, v in enumerate(np.flatnonzero(placed.hopeless))
            for o in placed.culprit[placed.culprit_row[h] : placed.culprit_row[h + 1]]]  # fmt: skip
    assert np.mean(near) > 0.5  # what is to blame is not in the map, or alone there


def test_cells_are_boxes_of_one_view_cell(stages):
    scene, hierarchy, model, cells, views = stages
    settings = settings_of(candidates="cells")
    candidates = merge_shards([
        generate(scene, hierarchy, model, cells, views, settings=settings, nodes=nodes) for nodes in cluster_shards(hierarchy)
    ])  # fmt: skip
    boxes = {box.tobytes() for box in cells.cell_box.reshape(-1, 6)}
    assert len(candidates.cluster) > 100 and (candidates.kind == BOX).all()
    assert {c.tobytes() for c in candidates.view_cell[:, :6]} <= boxes
    placed = place(scene, hierarchy, model, cells, views, candidates, settings=settings)
    assert verdict(placed, model) == "valid" and (placed.kind == BOX).all()
    assert {c.tobytes() for c in placed.view_cell[:, :6]} <= boxes
    wide = from_mapping(
        {"budget": "60 calls", "camera": {"width": 320, "height": 180}, "view_space": {"interval_deg": 22.5}}
    )
    found = merge_shards([
        generate(scene, hierarchy, model, cells, views, settings=wide, nodes=nodes) for nodes in cluster_shards(hierarchy)
    ])  # fmt: skip
    both = place(scene, hierarchy, model, cells, views, found, settings=wide)
    assert both.bytes.sum() < placed.bytes.sum()


# A closed room ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """The room's placement, and its stages."""
    folder = tmp_path_factory.mktemp("room")
    done = run(write_room(folder / "room.glb", blocks()), room_settings(), until=Stage.PLACEMENTDB)
    write_files(done.artifacts[Stage.PLACEMENTDB], folder)
    return folder, done


def seams():
    """Yield a direction along each of the twelve seams, and one into each of the eight corners."""
    for axis in range(3):
        for a in (-1.0, 1.0):
            for b in (-1.0, 1.0):
                for along in (-0.6, 0.3):
                    out = np.empty(3)
                    out[axis], out[(axis + 1) % 3], out[(axis + 2) % 3] = along, a, b
                    yield out
    for k in range(8):
        yield np.array([1.0 if k >> a & 1 else -1.0 for a in range(3)])


def test_no_ray_leaves_the_room_through_a_seam_or_anywhere(room):
    placement, rng = Placement.open(room[0]), np.random.default_rng(2)
    pages = [placement.page(k)[:1024] for k in range(len(placement.manifest["pages"]))]
    index, cell = placement.index, placement.index["node_box"][0]
    face = np.array([int(np.argmax(naive.gaps(index["cluster_box"][c], cell))) for c in index["impostor_cluster"]])
    assert placement.manifest["counts"]["cells"] == 1 and set(face.tolist()) == set(range(6))
    tried = from_map = slips = slips_without_a_face = 0
    for n, direction in enumerate([*seams(), *rng.normal(size=(8, 3))]):
        eye = rng.uniform(-2, 2, 3) if n % 3 else rng.choice([-2.0, 2.0], 3)
        found = placement.lookup(eye, direction)
        assert found.problem_view is not None and len(found.impostors)
        aim = direction / np.linalg.norm(direction)
        ray = aim + rng.normal(0, 0.04, (150, 3)) * (rng.random((150, 1)) < 0.9)
        kept = naive.meets_boxes(index["object_box"][found.objects] + placement.origin_m, eye, ray)
        by_map = naive.meets_layers(placement, pages, found.impostors, eye, ray)
        slips += int((~(by_map | kept)).sum())
        tried, from_map = tried + len(ray), from_map + int(by_map.sum())
        if n >= 32:  # the test sees what is missing
            main = 2 * int(np.argmax(np.abs(aim))) + int(aim[np.argmax(np.abs(aim))] < 0)
            others = found.impostors[face[found.impostors] != main]
            slips_without_a_face += int((~(naive.meets_layers(placement, pages, others, eye, ray) | kept)).sum())
    assert slips == 0 and slips_without_a_face > 100
    assert tried == 6000 and from_map > 0.95 * tried


def test_pictures_of_the_room_show_no_crack(room):
    proof = merge_proofs([prove(room[0], 0, 60, seed=4, each=0)], confidence=0.95)
    if proof["not_proven"]:
        pytest.skip(proof["not_proven"])
    assert proof["pairs"] > 40 and proof["failed"] == 0 and proof["crack_px"] == 0
    assert proof["worst_displacement_px"] <= proof["allowed_px"] * 1.001


def test_figures_were_bounds_and_no_random_view_refutes_them(room):
    folder, done = room
    before, after = done.get(Stage.PLACEMENT), done.get(Stage.REPAIR)
    assert (after.bytes <= before.bytes).all() and (after.cost <= before.cost).all()
    found = verify(folder, views=1000, seed=5)
    assert found["verdict"] == "valid" and found["in_problem_views"] == 1000
    assert (found["over_budget"], found["over_bound"], found["outside_view_cell"]) == (0, 0, 0)
