"""Which stages run beside others: those that no other reads, as soon as their inputs are there, where memory allows."""

import pytest
from farfield import executor as module
from farfield.executor import Executor, StageRun
from farfield.settings import Settings
from farfield.stages import Stage

STAGES = list(Stage)


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Return a function: an executor whose stages only note that they ran, after those up to `last`."""
    monkeypatch.setattr(module, "free_bytes", lambda: 1 << 40)

    def make(last: Stage, workers: int = 2):
        executor = Executor(tmp_path / "a.glb", Settings(), tmp_path, workers=workers, progress=lambda *_: None)

        def run(stage: Stage) -> StageRun:
            path = tmp_path / stage
            path.write_bytes(bytes(10))
            executor.paths.artifacts[stage] = path
            if stage == Stage.PROOF:
                raise ValueError("cracked")
            return StageRun(name=stage, seconds=1.0, peak_bytes=1, skipped=None, shards=1, reused=0)

        monkeypatch.setattr(executor, "_run_stage", run)
        for stage in STAGES[: STAGES.index(last) + 1]:
            executor.run(stage)
        return executor

    return make


def test_the_bound_begins_beside_the_bake(made):
    executor = made(Stage.CANDIDATES)
    executor.begin_leaves()
    assert not executor._begun
    executor.run(Stage.PLACEMENT)
    executor.begin_leaves()
    assert list(executor._begun) == [Stage.BOUND]
    for stage in (Stage.BAKE, Stage.REPAIR, Stage.BOUND):
        executor.run(stage)
        executor.begin_leaves()
    assert not executor._begun
    assert [run.name for run in executor.stages] == STAGES[: STAGES.index(Stage.BOUND) + 1]


def test_what_fails_beside_others_fails_when_its_turn_comes(made):
    executor = made(Stage.PLACEMENTDB)
    executor.begin_leaves()
    assert set(executor._begun) == {Stage.EVALUATION, Stage.PROOF}
    executor.run(Stage.EVALUATION)
    with pytest.raises(ValueError, match="cracked"):
        executor.run(Stage.PROOF)


def test_nothing_runs_beside_others_without_a_second_worker_or_the_memory(made, monkeypatch):
    executor = made(Stage.PLACEMENT, workers=1)
    executor.begin_leaves()
    assert not executor._begun
    executor = made(Stage.PLACEMENT)
    monkeypatch.setattr(module, "free_bytes", lambda: 2 << 30)
    executor.begin_leaves()
    assert not executor._begun
