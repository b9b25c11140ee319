"""Many jobs over one scene that differ in a setting: stages that agree run once, and what each took is kept with it.

Problem  A sweep of ten settings is not ten jobs: most stages read none of what was changed. And whoever stops it, or asks
         a second experiment, should not pay again.
Method   `Executor` with one cache: artifacts lie under digests of all that shapes them. Beside an artifact lies what
         making it took (wall clock, and processor seconds of all processes), so that a reused stage still states its price.
         Measurements are kept in the same way, under the digests of what was measured, their arguments and MEASURES.
Errs     A stage that was interrupted and went on later states no time. Processor seconds are Linux's; elsewhere wall clock.
"""

import hashlib
import importlib
import json
import multiprocessing
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from farfield.executor import Executor, StageRun
from farfield.settings import Settings
from farfield.stages import Stage
from farfield.steps.model import Inputs
from farfield.steps.result import write_files

Tell = Callable[[str], None]
MEASURES = 2  # bumped when a measurement's result changes


@dataclass(frozen=True, slots=True, kw_only=True)
class StageTime:
    """What a stage took when its artifact was made; None: not known (made in pieces, or by somebody else)."""

    seconds: float | None
    cpu_seconds: float | None
    skipped: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Ran:
    """A job of the sweep as far as it was asked to go."""

    settings: Settings
    times: Mapping[Stage, StageTime]
    artifacts: Mapping[Stage, Path]
    digests: Mapping[Stage, str]

    def inputs(self) -> Inputs:
        """Return its artifacts as a stage would see them."""
        from farfield.executor import map_file

        return Inputs(self.settings, {s: map_file(p) for s, p in self.artifacts.items()}, self.digests)

    def cpu_seconds(self, *stages: Stage) -> float | None:
        """Return what some stages took together, processor seconds; None where one of them is not known."""
        found = [self.times[s].cpu_seconds for s in stages if s in self.times]
        return None if any(v is None for v in found) else sum(v for v in found if v is not None)

    def seconds(self, *stages: Stage) -> float | None:
        """Return the same in wall clock."""
        found = [self.times[s].seconds for s in stages if s in self.times]
        return None if any(v is None for v in found) else sum(v for v in found if v is not None)


class Sweep:
    """Runs jobs and measurements over one scene file. A context manager: its processes end with it."""

    def __init__(self, scene: Path, cache: Path, *, workers: int, tell: Tell = lambda text: None) -> None:
        self.scene, self.cache, self.workers, self.tell = scene, cache, workers, tell
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> "Sweep":
        self.cache.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(self, *exception: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def run(self, settings: Settings, *, until: Stage, label: str, skip: Sequence[Stage] = (), apart: str = "") -> Ran:
        """Run the stages up to `until`, `skip` left out. Raises what a stage raises, or StageFailed.

        apart  where not "": a name; from the placement on nothing is shared with runs of another name (a clock stops them)
        """
        cache = self._apart(apart) if apart else self.cache
        work = cache / "scenes"
        work.mkdir(exist_ok=True)
        times: dict[Stage, StageTime] = {}
        names = list(Stage)

        def show(stage: Stage, done: int, total: int, skipped: str | None) -> None:
            self.tell(f"{label}: {stage} {done}/{total}" if total else f"{label}: {stage}")

        with Executor(self.scene, settings, work, workers=self.workers, progress=show, cache=cache) as executor:
            for stage in names[: names.index(until) + 1]:
                if stage in skip:
                    continue
                before = _cpu_below(os.getpid())
                ran = executor.run(stage)
                times[stage] = _time(executor.paths.artifacts[stage], ran, _cpu_below(os.getpid()) - before)
            return Ran(
                settings=settings, times=times, artifacts=dict(executor.paths.artifacts),
                digests=dict(executor.paths.digests),
            )  # fmt: skip

    def _apart(self, name: str) -> Path:
        """Return a cache of its own whose stages before the placement are those of the sweep."""
        cache = self.cache / "apart" / name
        cache.mkdir(parents=True, exist_ok=True)
        for stage in list(Stage)[1 : list(Stage).index(Stage.PLACEMENT)]:
            shared = self.cache / stage
            shared.mkdir(exist_ok=True)
            if not (cache / stage).is_symlink():
                (cache / stage).symlink_to(shared.resolve(), target_is_directory=True)
        return cache

    def measure(self, function: str, ran: Ran, calls: Sequence[tuple[Any, ...]], *, label: str) -> list[Any]:
        """Return `function(folder, *arguments)` for each call, in processes of their own.

        function  "module:name", returns JSON values; of the files that `place` would write into `folder`
        """
        artifact, digest = ran.artifacts[Stage.PLACEMENTDB], ran.digests[Stage.PLACEMENTDB]
        folder = self.cache / "measured"
        folder.mkdir(exist_ok=True)
        kept = [folder / f"{_key(function, digest, call)}.json" for call in calls]
        missing = [k for k, path in enumerate(kept) if not path.exists()]
        if missing and self._pool is None:
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.workers, mp_context=context)
        futures = {k: self._pool.submit(_measure, function, artifact, calls[k]) for k in missing if self._pool}
        for n, (k, future) in enumerate(futures.items()):
            self.tell(f"{label}: {n}/{len(futures)}")
            text = json.dumps(future.result(), sort_keys=True)
            part = kept[k].with_suffix(f".{os.getpid()}.part")
            part.write_text(text, encoding="utf-8")
            part.replace(kept[k])
        return [json.loads(path.read_text()) for path in kept]


def _key(function: str, digest: str, call: Sequence[Any]) -> str:
    text = json.dumps([MEASURES, function, digest, call], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _measure(function: str, artifact: Path, call: Sequence[Any]) -> Any:
    from farfield.executor import map_file

    module, name = function.split(":")
    with tempfile.TemporaryDirectory(prefix="farfield-") as folder:
        write_files(map_file(artifact), Path(folder))
        return getattr(importlib.import_module(module), name)(Path(folder), *call)


def _time(artifact: Path, ran: StageRun, cpu_seconds: float) -> StageTime:
    """Return what the artifact took: just now, or what was kept beside it."""
    beside = artifact.with_name(artifact.name + ".took")
    cpu = cpu_seconds if cpu_seconds > 0 else ran.seconds
    if ran.reused == 0:
        beside.write_text(json.dumps([ran.seconds, cpu]), encoding="utf-8")
    kept = json.loads(beside.read_text()) if beside.exists() else [None, None]
    return StageTime(seconds=kept[0], cpu_seconds=kept[1], skipped=ran.skipped)


def _cpu_below(ancestor: int) -> float:
    """Return the processor seconds of all processes below one, those that ended and were waited for included."""
    parent, ticks = {}, {}
    try:
        hertz = os.sysconf("SC_CLK_TCK")
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    fields = (entry / "stat").read_text().rpartition(")")[2].split()
                except OSError:
                    continue  # it just ended
                parent[int(entry.name)] = int(fields[1])
                ticks[int(entry.name)] = sum(map(int, fields[11:15]))
    except (OSError, ValueError):
        return 0.0
    total = 0
    for pid in ticks:
        above = pid
        while above in parent and above != ancestor:
            above = parent[above]
        if above == ancestor and pid != ancestor:
            total += ticks[pid]
    return total / hertz
