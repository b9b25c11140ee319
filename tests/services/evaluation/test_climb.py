"""The adversary finds worse views than chance, refutes what chance would pass, and its certificate is the same bytes."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from farfield.cli.main import main
from farfield.evaluation import kernels
from farfield.evaluation.bound import bound_over_union
from farfield.evaluation.climb import _angles, _direction, climb
from farfield.evaluation.verify import Eye, verify
from farfield.placementdb.read import Placement
from placements import made_up, save

BOX = np.array([[0.0, 0, 0], [16, 2, 16]])


@pytest.mark.parametrize("seed", range(5))
def test_a_climb_finds_the_top_of_a_hill(seed: int) -> None:
    rng = np.random.default_rng(seed)
    top, look = BOX[0] + rng.random(3) * BOX[1], rng.normal(size=3)
    look /= np.linalg.norm(look)

    def hill(p: np.ndarray, d: np.ndarray) -> float:
        assert ((p >= BOX[0]) & (p <= BOX[1])).all() and abs(d @ d - 1) < 1e-12
        return 1 / (1 + float(((p - top) ** 2).sum()) / 256 + 1 - float(d @ look))

    start = BOX.mean(0), np.array([0.0, 0.0, -1.0])
    found = climb(*start, BOX, hill, start=hill(*start), seed=(seed,), most=400)
    assert found.found > 0.9 > found.start
    assert found == climb(*start, BOX, hill, start=hill(*start), seed=(seed,), most=400)
    assert climb(*start, BOX, hill, start=hill(*start), seed=(seed,), most=7).views == 7


def test_a_climb_keeps_out_of_views_that_do_not_count() -> None:
    found = climb(BOX.mean(0), np.array([0, 0, -1.0]), BOX, lambda p, d: None, start=0.5, seed=(0,))
    assert (found.found, found.start) == (0.5, 0.5) and found.views > 0


def test_angles_are_directions() -> None:
    for d in (*np.random.default_rng(0).normal(size=(50, 3)), [0, 1, 0], [0, -2, 0], [0, 0, 1]):
        d = np.asarray(d, dtype=float)
        np.testing.assert_allclose(_direction(*_angles(d)), d / math.hypot(*d), atol=1e-12)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save(made_up(n_objects=60, n_impostors=12, budget=57, share=1.0, seed=2), tmp_path_factory.mktemp("placed"))


def test_climbing_is_worse_than_as_many_random_views(folder: Path) -> None:
    found = verify(folder, views=200, seed=4, climbs=100)
    sought = found["climb"]
    n_cells = Placement.open(folder).manifest["counts"]["cells"]
    assert sought["cells"] == sought["of_cells"] == n_cells
    chance = verify(folder, views=200 + sought["views"], seed=5)
    assert found["worst_ratio"] == sought["worst_ratio"] > chance["worst_ratio"] >= sought["random_worst_ratio"]
    assert sought["median_gain"] > 1.05
    assert found["views"] == 200 and found["over_bound"] == 0
    worst = found["worst_view"]  # and it is a view like any other
    v = Placement.open(folder).lookup(worst["position"], worst["direction"])
    assert v.cell == worst["cell"] and worst["cost"] <= v.cost_bound


def test_climbs_go_where_no_random_view_fell(folder: Path) -> None:
    found = verify(folder, views=1, seed=0, climbs=1000)
    assert found["climb"]["cells"] > 8
    assert verify(folder, views=60, seed=0, climbs=2)["climb"]["cells"] == 2


def test_what_only_the_climb_finds_refutes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A budget between the worst of a few random views and the worst of the climb: chance alone would pass it."""
    by_chance = verify(folder, views=100, seed=4)["worst_ratio"]
    sought = verify(folder, views=100, seed=4, climbs=100)["worst_ratio"]
    between = round(57 * (by_chance + sought) / 2)
    assert 57 * by_chance <= between < 57 * sought
    read = Placement.open.__func__  # type: ignore[attr-defined]

    def lower(cls: type, path: Path) -> Placement:
        placement = read(cls, path)
        placement.manifest["budget"]["amount"] = between
        return placement

    monkeypatch.setattr(Placement, "open", classmethod(lower))
    assert verify(folder, views=100, seed=4)["over_budget"] == 0
    assert verify(folder, views=100, seed=4, climbs=100)["over_budget"] > 0


def test_the_certificate_is_the_same_bytes_and_says_what_it_speaks_of(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / "certificate.json"
    said = []
    for _ in range(2):
        assert main(["verify", str(folder), "--views", "50", "--climb", "3", "--json"]) == 0
        said.append((path.read_bytes(), json.loads(capsys.readouterr().out)))
    assert said[0] == said[1]
    written = json.loads(said[0][0])
    manifest = Placement.open(folder).manifest
    assert written["found"] == said[0][1] and written["found"]["climb"]["cells"] == 3
    assert written["of"]["manifest_sha256"] == manifest["manifest_sha256"]
    assert written["of"]["scene_sha256"] == manifest["scene"]["sha256"]
    assert written["settings"]["budget"] == "57 calls" and written["refuted"] is False
    assert set(written["software"]["verified_with"]) == {"farfield", "numpy", "numba"}
    assert not [p for p in folder.iterdir() if p.name.endswith(".part")]


def test_a_folder_that_cannot_be_written_is_verified_all_the_same(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*a: object, **k: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "write_text", refuse)
    assert main(["verify", str(folder), "--views", "20", "--climb", "0", "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["views"] == 20 and "Permission denied" in said.err


def test_many_cameras_at_once_see_what_each_sees_alone(folder: Path) -> None:
    rng = np.random.default_rng(4)
    boxes = rng.uniform(-9, 9, (60, 1, 3)) + np.sort(rng.uniform(-3, 3, (60, 2, 3)), axis=1)
    boxes[:5] *= 1e7  # far off, and around the eye
    ids, fixed = np.arange(60), rng.integers(1, 9, 60).astype(np.int64)
    eyes = rng.uniform(-5, 5, (40, 3))
    eye = Eye(Placement.open(folder))
    frames = np.array([eye.frame(d) for d in rng.normal(size=(40, 3))])
    share = np.empty((40, 60))
    for s in range(40):
        kernels.boxes_share(boxes, ids, eyes[s], frames[s], share[s])
    assert 0.1 < (share >= 0).mean() < 0.9
    for pixel in (0.0, 7.5):
        largest = np.full(60, -1.0)
        worst = kernels.cameras_share(boxes, ids, eyes, frames, fixed, pixel, largest)
        np.testing.assert_array_equal(largest >= 0, (share >= 0).any(0))
        if pixel:
            np.testing.assert_array_equal(largest, share.max(0))
        each = [(fixed[row >= 0] + pixel * row[row >= 0]).sum() for row in share]
        assert worst == pytest.approx(max(each), rel=1e-12)


def test_bounds_are_held_against_the_union_of_dense_cameras(folder: Path) -> None:
    placement = Placement.open(folder)
    found = bound_over_union(placement, views=12, samples=40)
    assert (found["views"], found["below_one"]) == (12, 0) and found["over_union"]["least"] >= 1
    assert found["over_worst"]["median"] >= found["over_union"]["median"]
    for k in range(len(placement.manifest["chunks"])):  # bounds that are too low do not pass
        placement.chunk(k)["view_geometry_cost"] = placement.chunk(k)["view_geometry_cost"] // 20
    assert bound_over_union(placement, views=12, samples=40)["below_one"] > 0
