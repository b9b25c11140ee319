"""`verify` sees what rays see, passes placements that keep their promise, and catches those that do not."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from farfield.errors import ColumnsAltered, NotColumns, PlacementFileError, PlacementFileMissing
from farfield.evaluation import kernels
from farfield.evaluation.level import read_boxes
from farfield.evaluation.verify import Eye, draw_views, merge_found, refuted, verify
from farfield.placementdb.layout import MANIFEST
from farfield.placementdb.read import Placement
from farfield.placementdb.write import sealed
from naive import evaluation as naive
from placements import glb, made_up, save


def change_manifest(folder: Path, **changes: Any) -> None:
    path = folder / "placement" / MANIFEST
    path.write_bytes(sealed(json.loads(path.read_text()) | changes))


@pytest.fixture(scope="module")
def eye(tmp_path_factory: pytest.TempPathFactory) -> Eye:
    folder = save(made_up(origin_m=(0, 0, 0)), tmp_path_factory.mktemp("level"))
    return Eye(Placement.open(folder))


def share_of(eye: Eye, boxes: np.ndarray, at: np.ndarray, direction: np.ndarray) -> np.ndarray:
    out = np.empty(len(boxes))
    kernels.boxes_share(boxes, np.arange(len(boxes)), at, eye.frame(direction), out)
    return out


def random_boxes(rng: np.random.Generator, n: int) -> np.ndarray:
    centre, half = rng.normal(size=(n, 3)) * 20, rng.exponential(4, (n, 3)) * rng.integers(0, 2, (n, 3)).clip(0.01)
    return np.stack([centre - half, centre + half], axis=1)


@pytest.mark.parametrize("seed", range(4))
def test_boxes_cover_what_their_edges_and_the_screen_corners_say(eye: Eye, seed: int) -> None:
    rng = np.random.default_rng(seed)
    at, direction = rng.normal(size=3), rng.normal(size=3)
    boxes = random_boxes(rng, 150)
    boxes = boxes[np.maximum(np.maximum(boxes[:, 0] - at, at - boxes[:, 1]), 0).max(1) > 1]
    ray = naive.rays(direction, 45.0, 1280, 720, 60)
    n_seen = 0
    for box, share in zip(boxes, share_of(eye, boxes, at, direction), strict=True):
        expected = naive.box_share(box, at, direction, 45.0, 1280, 720)
        n_seen += share >= 0
        assert max(share, 0) == pytest.approx(expected, abs=0.01), f"{box=}"
        assert share >= 0 or not naive.box_mask(box, at, ray).any()
    assert 5 < n_seen < len(boxes)


def test_a_box_that_a_ray_meets_is_never_culled(eye: Eye) -> None:
    """Thin boxes, at the border of the screen: the ray's point on the box is inside the pyramid, so is the box."""
    rng = np.random.default_rng(7)
    for _ in range(400):
        at, direction = rng.normal(size=3) * 5, rng.normal(size=3)
        frame = eye.frame(direction)
        right, up = frame[0] * eye.tan_x**2, frame[1] * eye.tan_y**2
        point = at + rng.exponential(30) * (frame[2] + rng.uniform(-1, 1) * right + rng.uniform(-1, 1) * up)
        half = rng.exponential(2, 3) * rng.integers(0, 2, 3)
        middle = point + rng.uniform(-1, 1, 3) * half * 0.999999
        box = np.stack([middle - half - 1e-9, middle + half + 1e-9])
        assert share_of(eye, box[None], at, direction)[0] >= 0, f"{at=} {direction=} {box=}"


def test_the_eye_in_a_box_sees_it_everywhere(eye: Eye) -> None:
    box = np.array([[[-1.0, -1, -1], [1, 1, 1]]])
    for corner in ([0, 0, 0], [1, 0, 0], [-1, 1, 1]):
        assert share_of(eye, box, np.array(corner, dtype=float), np.array([0.3, 0.2, -1]))[0] == 1.0


def test_polygons_cover_what_rays_say(eye: Eye) -> None:
    rng = np.random.default_rng(3)
    n = 250
    for _ in range(40):
        at, direction = rng.normal(size=3), rng.normal(size=3)
        angle = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 9)))
        a, b = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
        corners = at + direction / np.linalg.norm(direction) * 9 + rng.normal(size=3)
        corners = corners + 6 * (np.cos(angle)[:, None] * a + np.sin(angle)[:, None] * b)
        share = kernels.polygons_share(corners, np.array([0, len(corners)]), at, eye.frame(direction))
        seen = naive.polygon_mask(corners, at, naive.rays(direction, 45.0, 1280, 720, n)).mean()
        assert share == pytest.approx(seen, abs=8 / n)


def test_a_placement_that_keeps_its_promise_is_not_refuted(tmp_path: Path) -> None:
    made = made_up(n_objects=60, n_impostors=12, budget=57, share=1.0, seed=2)
    found = verify(save(made, tmp_path), views=600, seed=4)
    assert not refuted(found)
    assert (found["views"], found["over_budget"], found["over_bound"]) == (600, 0, 0)
    assert 0 < found["worst_ratio"] <= 1
    assert 0 < found["in_hopeless_views"] < found["in_problem_views"] == 600
    assert found == json.loads(json.dumps(found))
    worst = found["worst_view"]
    v = Placement.open(tmp_path).lookup(worst["position"], worst["direction"])
    assert (v.cell, v.problem_view, v.cost_bound) == (worst["cell"], worst["problem_view"], worst["cost_bound"])
    assert worst["cost"] <= v.cost_bound


def test_time_budgets_count_pixels(tmp_path: Path) -> None:
    folder = save(made_up(n_objects=60, share=1.0, seed=2, budget=57), tmp_path)
    price = json.loads((folder / "placement" / MANIFEST).read_text())["cost_model"]
    price |= {"per_pixel": 1.0, "per_impostor_pixel": 0.5, "per_impostor_triangle": 2.0}
    change_manifest(folder, cost_model=price)
    placement = Placement.open(folder)
    eye = Eye(placement)
    position, direction = np.array([150.0, 2.0, -310.0]), np.array([0.5, 0.1, -1.0])
    v = placement.lookup(position, direction)
    cost, n_objects = eye.cost(v, position, direction)
    shares = share_of(eye, placement.index["object_box"][v.objects], position - placement.origin_m, direction)
    expected = 3 + n_objects + len(v.impostors) + 1280 * 720 * shares[shares >= 0].sum()
    for i in v.impostors:
        for layer in placement.impostors[int(i)].layers:
            seen = naive.polygon_mask(layer.corners, position, naive.rays(direction, 45.0, 1280, 720, 400)).mean()
            expected += 0.5 * 1280 * 720 * seen + 2 * (len(layer.corners) - 2)
    assert len(v.impostors)
    assert cost == pytest.approx(expected, rel=0.02)


def test_hidden_problem_views_are_found(tmp_path: Path) -> None:
    """The placement says there are no problem views, but most of the town is in sight from its edge."""
    made = made_up(n_objects=100, budget=6, share=0.0, n_impostors=0, seed=1)
    found = verify(save(made, tmp_path), views=300)
    assert refuted(found)
    assert found["over_budget"] > 30
    assert found["over_bound"] >= found["over_budget"]
    assert found["worst_ratio"] > 2


def test_an_impostor_outside_its_view_cell_is_found(tmp_path: Path) -> None:
    made = made_up(n_objects=60, budget=57, share=1.0, seed=2)
    made["placement"].view_cell[:, 3] -= 40.0  # the box ends in the middle of the view space
    found = verify(save(made, tmp_path), views=300)
    assert found["outside_view_cell"] > 20
    assert refuted(found)


@pytest.mark.parametrize("place,held", [
    ([0, 0, 5], True), ([0, 0, 11], False), ([0, 0, 0.5], False), ([2.4, 0, 5], True), ([2.6, 0, 5], False),
    ([0, 0, -5], False),
])  # fmt: skip
def test_shafts_hold_their_cone(tmp_path: Path, place: list[float], held: bool) -> None:
    made = made_up(origin_m=(7.0, 0.0, 0.0), n_impostors=2)
    made["placement"].kind[:] = 0
    made["placement"].view_cell[:] = [0, 0, 0, 0, 0, 1, 0.5, 1, 10]
    eye = Eye(Placement.open(save(made, tmp_path)))
    assert eye.held(0, np.array(place) + [7.0, 0, 0]) is held  # noqa: RUF005


def test_views_are_inside_and_cover_poles_and_cells(tmp_path: Path) -> None:
    boxes = np.array([[[-32.0, 1, -32], [32, 3, 32]], [[40, 2, 0], [60, 2, 10]]])
    placement = Placement.open(save(made_up(view_boxes=boxes), tmp_path))
    views = list(draw_views(placement, 400, 0))
    assert all(a[0].tolist() == b[0].tolist() for a, b in zip(views, draw_views(placement, 400, 0), strict=True))
    for position, direction in views:
        assert placement.find_cell(position) >= 0
        assert direction @ direction == pytest.approx(1, abs=1e-12)
    assert sum(abs(d[1]) > 0.99 for _, d in views) > 15
    assert {placement.find_cell(p) for p, _ in views} == set(range(placement.manifest["counts"]["cells"]))


def test_results_of_shards_add_up(tmp_path: Path) -> None:
    folder = save(made_up(n_objects=60, budget=57, share=1.0, seed=2), tmp_path)
    parts = [verify(folder, views=50, seed=s) for s in (3, 4)]
    both = merge_found(parts)
    assert both["views"] == 100
    assert both["worst_ratio"] == max(p["worst_ratio"] for p in parts)
    assert both["in_hopeless_views"] == sum(p["in_hopeless_views"] for p in parts)
    assert both["seed"] == 3


def test_boxes_of_the_level_are_exact(tmp_path: Path) -> None:
    made = made_up(origin_m=(1e6 + 0.1, 0, 3))
    (tmp_path / "scene.glb").write_bytes(glb(made["scene"]))
    boxes = read_boxes(tmp_path / "scene.glb")
    expected = made["scene"].object_box + made["scene"].origin_m
    np.testing.assert_allclose([boxes[i] for i in range(24)], expected, rtol=0, atol=1e-9)


def test_another_level_is_refused(tmp_path: Path) -> None:
    folder = save(made_up(), tmp_path)
    (folder / "scene.glb").write_bytes(glb(made_up(seed=1)["scene"]))
    with pytest.raises(ColumnsAltered, match=r"scene\.glb.*SHA-256"):
        verify(folder, views=1)
    change_manifest(folder, scene=None)
    with pytest.raises(ColumnsAltered, match="object 0 is not where"):
        verify(folder, views=1)
    (folder / "scene.glb").write_bytes(glb(made_up(n_objects=23)["scene"]))
    with pytest.raises(ColumnsAltered, match="23 objects where the placement has 24"):
        verify(folder, views=1)


def test_a_missing_or_damaged_level_is_refused(tmp_path: Path) -> None:
    folder = save(made_up(), tmp_path)
    content = (folder / "scene.glb").read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(40):
        bad = bytearray(content[: rng.integers(0, len(content))])
        for at in rng.integers(0, len(bad), min(len(bad), 5)):
            bad[at] ^= 1 << rng.integers(8)
        (folder / "scene.glb").write_bytes(bytes(bad))
        with pytest.raises(PlacementFileError):
            verify(folder, views=1)
    (folder / "scene.glb").write_bytes(b"{}")
    with pytest.raises(NotColumns):
        verify(folder, views=1)
    (folder / "scene.glb").unlink()
    with pytest.raises(PlacementFileMissing):
        verify(folder, views=1)


def test_a_damaged_page_stops_verify(tmp_path: Path) -> None:
    folder = save(made_up(), tmp_path)
    page = next((folder / "placement" / "pages").iterdir())
    page.write_bytes(page.read_bytes()[:-1])
    with pytest.raises(PlacementFileError, match=page.name):
        verify(folder, views=1)


def test_only_the_visible_set_of_the_cell_is_drawn_and_counted(tmp_path: Path) -> None:
    made = made_up(n_objects=40, n_impostors=6, budget=57, share=1.0, visible=True, seed=4)
    placement, visible = Placement.open(save(made, tmp_path) / "placement"), made["visible"]
    eye, hidden = Eye(placement), 0
    for position, direction in draw_views(placement, 200, 0):
        v = placement.lookup(position, direction)
        seen = set(visible.object[visible.row[v.cell] : visible.row[v.cell + 1]].tolist())
        covered = {int(o) for i in v.impostors for o in placement.impostors[int(i)].objects}
        assert set(v.objects.tolist()) == seen - covered
        cost, drawn = eye.cost(v, position, direction)
        assert cost == placement.manifest["cost_model"]["per_frame"] + drawn + len(v.impostors)  # in calls
        everything = replace(v, objects=np.arange(40), levels=np.zeros(40, dtype=v.levels.dtype))
        hidden += eye.cost(everything, position, direction)[1] > drawn
    assert hidden > 20
