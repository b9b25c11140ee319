"""`farfield place --cache DIR`: what changed is done again, what did not is not, and the bytes are those of a fresh run."""

import json
import shutil
import subprocess
import sys
import time
import tomllib
from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest
from browser.levels import box_level
from farfield.executor import Executor
from farfield.placement.checkpoint import Checkpoint
from farfield.settings import from_mapping
from farfield.stages import Stage

SETTINGS = """budget = "{budget}"
seed = {seed}
[view_space]
cell_m = 8.0
boxes = [[[-24.0, 1.0, -4.0], [-8.0, 2.0, 4.0]]]
[camera]
fov_deg = 45.0
width = {width}
height = 360
[quality]
pixel_error = {pixel_error}
[visibility]
mode = "off"
[placement]
assignment = "{assignment}"
"""
FIRST = {"budget": "12 calls", "seed": 1, "width": 640, "pixel_error": 1.0, "assignment": "fastest"}
UP_TO = {  # what changed -> the stages that are found done; a later one is, too, where what it reads comes out the same
    "nothing": "hierarchy rendertime visibility viewspace candidates placement bake repair bound placementdb evaluation proof",
    "seed": "hierarchy rendertime visibility viewspace candidates placement bake repair bound",
    "assignment": "hierarchy rendertime visibility viewspace candidates",
    "pixel_error": "hierarchy rendertime visibility viewspace",
    "width": "hierarchy visibility",
    "budget": "hierarchy visibility",
    "level": "",
}
OTHER = {"seed": 2, "assignment": "least", "pixel_error": 2.0, "width": 320, "budget": "14 calls"}


def level(moved: float = 0.0) -> bytes:
    low = np.stack([np.arange(24) * 6.0, np.zeros(24), np.zeros(24)], 1)
    low[20, 0] += moved
    return box_level(np.stack([low, low + np.array([4.0, 5.0, 4.0])], 1))


@pytest.fixture(scope="module")
def cached(run, tmp_path_factory):
    """A folder with a level, its settings, and a cache that knows the job."""
    folder = tmp_path_factory.mktemp("cache")
    (folder / "row.glb").write_bytes(level())
    (folder / "row.toml").write_text(SETTINGS.format(**FIRST))
    words = ("--settings", folder / "row.toml", "--cache", folder / "cache", "--workers", 1, "--json")
    ran = run("place", folder / "row.glb", *words, "--out", folder / "first")
    assert ran.code == 0, ran.err
    assert {s["reused"] for s in ran.document["stages"]} == {0}
    assert ran.document["impostors"] > 0
    # Another job may read the same file with other buffers beside it: what it reads replaces nobody's scene.
    assert {path.name for path in (folder / "cache").iterdir()} == set(Stage) - {Stage.SCENE}
    return folder


@pytest.mark.parametrize("changed", UP_TO)
def test_only_what_depends_on_the_change_runs_again(cached: Path, run, files_of, tmp_path, changed):
    scene, settings = tmp_path / "row.glb", tmp_path / "row.toml"
    scene.write_bytes(level(0.5 if changed == "level" else 0.0))
    settings.write_text(SETTINGS.format(**FIRST | ({changed: OTHER[changed]} if changed in OTHER else {})))
    words = (scene, "--settings", settings, "--workers", 1, "--json")
    ran = run("place", *words, "--cache", cached / "cache", "--out", tmp_path / "again")
    assert ran.code == 0, ran.err
    ran_again = {s["name"] for s in ran.document["stages"] if s["skipped"] is None and s["reused"] < s["shards"]}
    stages = {s["name"] for s in ran.document["stages"] if s["skipped"] is None}
    done = set(UP_TO[changed].split()) & stages
    assert not done & ran_again
    depends = [s for s in Stage if s in stages and s not in done]
    assert depends[:2] == [s for s in depends if s in ran_again][:2]  # the scene is always read anew, then what changed
    if changed in ("budget", "level"):
        fresh = run("place", *words, "--out", tmp_path / "fresh")
        assert fresh.code == 0, fresh.err
        assert files_of(tmp_path / "again" / "placement") == files_of(tmp_path / "fresh" / "placement")
    assert json.loads((tmp_path / "again" / "report.json").read_text())["verdict"] == "valid"


def test_a_killed_job_goes_on_from_what_it_left_in_the_cache(cached: Path, run, files_of, tmp_path):
    words = [cached / "row.glb", "--settings", cached / "row.toml", "--cache", tmp_path / "cache", "--workers", 1]
    command = [sys.executable, "-m", "farfield.cli.main", "place", *words, "--out", tmp_path / "out"]
    with subprocess.Popen(list(map(str, command)), stderr=subprocess.DEVNULL) as killed:
        end = time.monotonic() + 120
        while not list(tmp_path.glob("cache/candidates/*.ffc")) and killed.poll() is None and time.monotonic() < end:
            time.sleep(0.02)
        killed.kill()
    assert not (tmp_path / "out" / "report.json").exists()
    ran = run("place", *words, "--json", "--out", tmp_path / "out")
    assert ran.code == 0, ran.err
    reused = {s["name"] for s in ran.document["stages"] if s["reused"]}
    assert {"hierarchy", "rendertime", "viewspace"} <= reused
    assert files_of(tmp_path / "out" / "placement") == files_of(cached / "first" / "placement")


def test_a_killed_optimizer_goes_on_from_its_checkpoint_in_the_cache(cached: Path, tmp_path, monkeypatch):
    shutil.copytree(cached / "cache", tmp_path / "cache")
    left = sorted((tmp_path / "cache" / "placement").glob("*.ffc"))
    expected = {path: path.read_bytes() for path in left}  # of every change that was tried before
    for path in left:
        path.unlink()
        path.with_suffix(".checkpoint").write_bytes(b"cut off")  # one that cannot be read is none
    read = []
    plain = Checkpoint.read

    def reading(self, n_candidates):
        read.append(self.path)
        return plain(self, n_candidates)

    monkeypatch.setattr(Checkpoint, "read", reading)
    settings = from_mapping(tomllib.loads((cached / "row.toml").read_text()))
    work = tmp_path / "work"
    work.mkdir()
    told = lambda *_: None  # noqa: E731
    with Executor(cached / "row.glb", settings, work, workers=1, progress=told, cache=tmp_path / "cache") as executor:
        monkeypatch.setattr(executor, "_submit", lambda f, stage, *more: _at_once(f, stage, executor.paths, *more))
        for stage in list(Stage)[: list(Stage).index(Stage.PLACEMENT) + 1]:
            executor.run(stage)
    assert len(read) == 1
    made = read[0].with_suffix(".ffc")
    assert made.read_bytes() == expected[made]
    assert not read[0].exists()


def _at_once(function, *arguments):
    done = Future()
    done.set_result((function(*arguments), 0))
    return done
