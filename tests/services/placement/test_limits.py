"""A clock may stop the optimiser and a signal may kill it: the first leaves a valid placement, the second no trace."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from benchmarks.inputs import Level, town_level
from farfield.columns import pack_dataclass
from farfield.placement import limit as limits
from farfield.placement.antichain import subtree_end
from farfield.placement.checkpoint import Checkpoint
from farfield.placement.choose import choose
from farfield.placement.greedy import place
from farfield.placement.prospects import find_prospects
from farfield.settings import PlacementSettings, Settings
from naive import greedy as naive

from .instances import random_instance, same_refit

SEEDS = range(16)
TESTS = Path(__file__).parents[2]


class Clock:
    """Time that moves on by a second whenever somebody asks."""

    def __init__(self):
        self.now = 0.0

    def monotonic(self):
        self.now += 1.0
        return self.now


@pytest.mark.parametrize("seconds", [0.5, 1.5, 2.5, 4.5, 8.5])
@pytest.mark.parametrize("seed", SEEDS)
def test_whenever_time_is_up_every_target_is_met(seed, seconds, monkeypatch):
    monkeypatch.setattr(limits, "time", Clock())
    x = random_instance(seed, n_objects=7, n_candidates=16)
    settings = Settings(placement=PlacementSettings(time_limit_s=seconds))
    p = place(None, x.hierarchy, x.model, x.cells, x.views, x.candidates, settings=settings, refit=same_refit(x))
    costs = naive.view_costs(x.hierarchy, x.views, p.cluster, p.cost, p.serve_row, p.serve)
    np.testing.assert_array_equal(p.view_cost, costs)
    assert (costs <= p.view_target).all()
    assert set(p.serve.tolist()) == set(range(len(p.cluster)))
    monkeypatch.undo()
    whole = place(None, x.hierarchy, x.model, x.cells, x.views, x.candidates, settings=Settings(), refit=same_refit(x))
    if not p.stopped:
        assert pack_dataclass(p) == pack_dataclass(whole)


def test_a_stopped_town_is_valid_and_says_so_and_enough_time_changes_nothing():
    level = town_level(300, budget="75 calls", view_m=32.0)
    given = level.scene, level.hierarchy, level.model, level.cells, level.views, level.candidates
    settings = lambda s: Settings(budget="75 calls", placement=PlacementSettings(time_limit_s=s))  # noqa: E731
    hasty, patient = place(*given, settings=settings(1e-6)), place(*given, settings=settings(1000.0))
    assert hasty.stopped and not patient.stopped
    assert (hasty.view_cost <= hasty.view_target).all() and hasty.bytes.sum() >= patient.bytes.sum()
    assert pack_dataclass(patient) == pack_dataclass(level.placement)


@pytest.mark.parametrize("everywhere", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_from_any_checkpoint_on_the_choice_is_the_same(seed, everywhere, tmp_path):
    x = random_instance(seed, n_objects=8, n_candidates=20)
    end = subtree_end(x.hierarchy.start, x.hierarchy.stop)
    excess = np.maximum(x.views.cost - find_prospects(x.hierarchy, x.model, x.views, x.candidates, end=end).target, 0)
    whole = choose(x.candidates, excess=excess, end=end, everywhere=everywhere)
    for n in range(len(whole.step) + 1):
        checkpoint = Checkpoint(tmp_path / "choices", seconds=0.0)
        checkpoint.read(len(x.candidates.cluster))
        checkpoint.write(whole.step[:n])
        again = Checkpoint(tmp_path / "choices")
        resumed = choose(x.candidates, excess=excess, end=end, everywhere=everywhere, checkpoint=again)
        assert again.resumed == n
        for name in whole.__slots__:
            np.testing.assert_array_equal(getattr(resumed, name), getattr(whole, name))


def test_a_checkpoint_that_is_cut_or_altered_or_of_other_candidates_is_none(tmp_path):
    path = tmp_path / "choices"
    checkpoint = Checkpoint(path, seconds=0.0)
    assert len(checkpoint.read(9)) == 0
    checkpoint.write(np.array([3, 1, 4], np.int32))
    data = path.read_bytes()
    assert Checkpoint(path).read(9).tolist() == [3, 1, 4]
    assert len(Checkpoint(path).read(10)) == 0
    for n in range(len(data)):
        path.write_bytes(data[:n])
        assert len(Checkpoint(path).read(9)) == 0, f"cut at {n}"
    at = data.index(np.array([3, 1, 4], np.int32).tobytes())
    for n in range(at, at + 12):
        path.write_bytes(data[:n] + bytes([data[n] ^ 1]) + data[n + 1 :])
        assert len(Checkpoint(path).read(9)) == 0, f"altered at {n}"
    Checkpoint(tmp_path / "no" / "folder", seconds=0.0).write(np.zeros(1, np.int32))  # costs the checkpoint only


CHILD = """
import sys, time
from pathlib import Path
from benchmarks.inputs import town_level
from farfield.placement import choose
from farfield.placement.checkpoint import Checkpoint
from farfield.placement.greedy import place
choose.TOPS_A_SLICE = 4
class Slow(Checkpoint):
    def write(self, step, *, at_once=False):
        super().write(step, at_once=at_once)
        time.sleep(0.05)
l = town_level(300, budget="75 calls", view_m=32.0)
given = l.scene, l.hierarchy, l.model, l.cells, l.views, l.candidates
place(*given, settings=l.settings, checkpoint=Slow(Path(sys.argv[1]), seconds=0.0))
"""


def choices_in(path, level: Level):
    return len(Checkpoint(path).read(len(level.candidates.cluster)))


def test_killed_while_it_chooses_it_goes_on_to_the_same_bytes(tmp_path):
    level, path = town_level(300, budget="75 calls", view_m=32.0), tmp_path / "choices"
    given = level.scene, level.hierarchy, level.model, level.cells, level.views, level.candidates
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(path)], env={"PYTHONPATH": str(TESTS), "PATH": ""})
    try:
        until = time.monotonic() + 120
        while child.poll() is None and choices_in(path, level) < 20 and time.monotonic() < until:
            time.sleep(0.05)
        child.send_signal(signal.SIGKILL)
        assert child.wait() == -signal.SIGKILL, "it ended before it was killed"
    finally:
        child.kill()
    checkpoint = Checkpoint(path)
    resumed = place(*given, settings=level.settings, checkpoint=checkpoint)
    assert checkpoint.resumed >= 20
    assert pack_dataclass(resumed) == pack_dataclass(level.placement)
