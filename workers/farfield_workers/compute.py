"""One shard as a function of files: inputs mapped, result written and hashed. Also a program, for the isolated stages.

`python -m farfield_workers.compute` reads a call as JSON on stdin, sets its own limits on memory, time and file size,
and prints the outcome as JSON: a crash or an endless loop in a decoder costs this process and one job.
"""

import contextlib
import functools
import hashlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import farfield.errors
from farfield.errors import FailedElsewhere, FarfieldError, StageFailed
from farfield.executor import StageRun, map_file, peak_bytes, reset_peak
from farfield.settings import Settings, from_mapping
from farfield.stages import Stage
from farfield.steps.model import Inputs

from farfield_workers.children import die_with_parent
from farfield_workers.table import Pipeline, load_pipeline

# Of the environment: a process that reads a stranger's file learns no address and no password.
SECRETS = ("FARFIELD_", "AWS_", "PG")


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """A shard with all it reads. Plain values: it travels as JSON."""

    stage: str
    kind: str  # plan, run, merge or report
    params: Any
    settings: Mapping[str, Any]
    scene_file: str
    artifacts: Mapping[str, str]  # stage -> path
    digests: Mapping[str, str]  # stage -> SHA-256
    pieces: Sequence[str]  # paths
    outcomes: Sequence[Mapping[str, Any]]
    checkpoint: str | None = None  # path of a file that outlives a killed run


@dataclass(frozen=True, slots=True)
class Result:
    digest: str
    n_bytes: int
    peak_bytes: int


def settings_of(given: Mapping[str, Any]) -> Settings:
    """Return the checked settings: those of one job are asked for by each of its shards."""
    return _settings_of(json.dumps(given, sort_keys=True))


@functools.lru_cache(maxsize=64)
def _settings_of(text: str) -> Settings:
    return from_mapping(json.loads(text))


Tell = Callable[[dict[str, Any]], None]


def inputs_of(call: Call, tell: Tell | None = None) -> Inputs:
    """Return what the stage sees; `tell` hears what it says of itself."""
    artifacts = {Stage(s): map_file(Path(path)) for s, path in call.artifacts.items()}
    digests = {Stage(s): digest for s, digest in call.digests.items()}
    checkpoint = Path(call.checkpoint) if call.checkpoint is not None else None
    return Inputs(settings_of(call.settings), artifacts, digests, Path(call.scene_file), checkpoint, tell)


def compute(pipeline: Pipeline, call: Call, out: Path, *, tell: Tell | None = None) -> Result:
    """Run the shard and write its artifact to `out`. Raises what the stage raises."""
    reset_peak()
    inputs = inputs_of(call, tell)
    parts: Sequence[bytes | memoryview]
    if call.kind == "report":
        runs = [StageRun(**{k: v for k, v in o.items() if k != "state"}) for o in call.outcomes]
        parts = [json.dumps(pipeline.report(inputs, runs), sort_keys=True, indent=1).encode() + b"\n"]
    else:
        step = pipeline.steps[Stage(call.stage)]
        if call.kind == "plan":
            reason = step.skip(inputs)
            plan = {"skip": reason, "shards": [] if reason else step.plan(inputs)}
            parts = [json.dumps(plan, sort_keys=True).encode()]
        elif call.kind == "merge":
            if step.merge is None:
                raise StageFailed(call.stage, "it was skipped, but says no empty result")
            parts = step.merge(inputs, [map_file(Path(piece)) for piece in call.pieces])
        else:
            parts = step.run(inputs, call.params)
    digest, n_bytes = hashlib.sha256(), 0
    with out.open("wb") as file:
        for part in parts:
            digest.update(part)
            n_bytes += file.write(part)
    return Result(digest.hexdigest(), n_bytes, peak_bytes())


def compute_isolated(pipeline_name: str, call: Call, out: Path, *, memory_bytes: int, seconds: int) -> Result:
    """Do what `compute` does in a process of its own with these limits. Raises FailedElsewhere, StageFailed."""
    order = {"pipeline": pipeline_name, "call": asdict(call), "out": str(out), "memory_bytes": memory_bytes}
    command = [sys.executable, "-m", "farfield_workers.compute"]
    kept = {name: value for name, value in os.environ.items() if not name.startswith(SECRETS)}
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, env=kept
    ) as child:
        try:
            answer = _wait(child, json.dumps({**order, "seconds": seconds}).encode(), seconds)
        except subprocess.TimeoutExpired:
            raise FailedElsewhere(
                "SceneOverLimit", f"reading the scene took more than {seconds} s",
                farfield.errors.SceneOverLimit.advice,
            ) from None  # fmt: skip
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
    try:
        told = json.loads(answer)
    except ValueError:
        raise StageFailed(call.stage, f"its process ended with status {child.returncode}") from None
    if "error" in told:
        raise FailedElsewhere(**told["error"])
    return Result(**told)


def _wait(child: "subprocess.Popen[bytes]", order: bytes, seconds: float) -> bytes:
    """Return what the child prints. Wakes every second: a cancel arrives as an exception, which a long wait would hold."""
    end = time.monotonic() + seconds
    unsent: bytes | None = order
    while True:
        try:
            return child.communicate(unsent, timeout=1.0)[0]
        except subprocess.TimeoutExpired:
            unsent = None  # a second call goes on with the rest of the first one's
            if time.monotonic() > end:
                raise


def main() -> int:
    """Compute the call on stdin within its limits and print the outcome."""
    die_with_parent()
    order = json.load(sys.stdin)
    limits = {
        resource.RLIMIT_AS: order["memory_bytes"],
        resource.RLIMIT_CPU: order["seconds"],
        resource.RLIMIT_FSIZE: order["memory_bytes"],
        resource.RLIMIT_CORE: 0,
    }
    for what, limit in limits.items():
        resource.setrlimit(what, (limit, limit))
    call = Call(**order["call"])
    # What a decoder prints must not mix with our answer.
    answer, sys.stdout = sys.stdout, sys.stderr
    told: dict[str, Any]
    try:
        told = asdict(compute(load_pipeline(order["pipeline"]), call, Path(order["out"])))
    except FarfieldError as error:
        told = {"error": {"code": error.code, "message": str(error), "advice": error.advice}}
    except MemoryError:
        advice = farfield.errors.SceneOverLimit.advice
        told = {"error": {"code": "SceneOverLimit", "message": "the scene needs too much memory", "advice": advice}}
    json.dump(told, answer)
    return 0


if __name__ == "__main__":
    sys.exit(main())
