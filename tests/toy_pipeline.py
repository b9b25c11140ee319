"""A pipeline of small pure functions, for tests of the service: what it does is said in the scene file, as JSON.

{"shards": 6, "seconds": 0.0, "fail": "bake", "until": PATH, "error": "named" | "odd", "crash_once": PATH, "skip": true,
"tell": [FACT, ...], "tell_seconds": 0.0}: the last two of stage placement
"""

import json
import os
import signal
import time
from pathlib import Path

from farfield.columns import files_parts
from farfield.errors import SceneEmpty
from farfield.stages import Queue, Stage
from farfield.steps.model import Step
from farfield_workers.table import Pipeline

OPTIONAL = frozenset({Stage.EVALUATION, Stage.PROOF})


def wishes(inputs):
    """Return what the scene file asks for, from the file or from the artifact of stage scene."""
    if Stage.SCENE in inputs.artifacts:
        return json.loads(bytes(inputs.artifacts[Stage.SCENE]))
    return json.loads(inputs.scene_file.read_text())


def _act(stage, inputs, shard):
    wish = wishes(inputs)
    if stage == Stage.SCENE:
        time.sleep(wish.get("scene_seconds", 0.0))
    if stage == Stage.VIEWSPACE:
        time.sleep(wish.get("seconds", 0.0))
        once = wish.get("crash_once")
        if once and shard == 1 and not Path(once).exists():
            Path(once).touch()
            os.kill(os.getpid(), signal.SIGKILL)
    if stage == Stage.PLACEMENT and inputs.tell is not None:
        for fact in wish.get("tell", []):
            inputs.tell(fact)
            time.sleep(wish.get("tell_seconds", 0.0))
    if wish.get("fail") == stage and not ("until" in wish and Path(wish["until"]).exists()):
        if wish.get("error") == "named":
            raise SceneEmpty("the toy has no triangles")
        raise RuntimeError("a secret of /this/machine")


def _run(stage):
    def run(inputs, shard):
        _act(stage, inputs, shard)
        if stage == Stage.SCENE:
            return [inputs.scene_file.read_bytes()]
        seen = {s: inputs.digests[s][:8] for s in sorted(inputs.artifacts)}
        return [json.dumps([stage, shard, seen, inputs.settings.budget]).encode()]

    return run


def _merge(inputs, pieces):
    return [b"[" + b",".join(bytes(p) for p in pieces) + b"]"]


def _files(inputs, shard):
    _act(Stage.PLACEMENTDB, inputs, shard)
    page = bytes(range(256)) * 40
    manifest = json.dumps({"budget": inputs.settings.budget, "viewspace": inputs.digests[Stage.VIEWSPACE]}).encode()
    return files_parts({"scene.glb": b"glTF", "placement/manifest.json": manifest, "placement/pages/p.bin": page})


def _step(stage, before):
    many = stage in (Stage.VIEWSPACE, Stage.CANDIDATES)
    skips = stage in (Stage.VISIBILITY, Stage.CANDIDATES)
    return Step(
        stage=stage, version=1, inputs=() if stage == Stage.SCENE else (Stage.SCENE, *before[-1:]),
        queue={Stage.PLACEMENT: Queue.OPTIMIZER, Stage.BAKE: Queue.GL}.get(stage, Queue.CPU),
        reads=("budget",) if stage == Stage.PLACEMENTDB else (),
        plan=lambda inputs: list(range(wishes(inputs).get("shards", 6))) if many else ["all"],
        run=_files if stage == Stage.PLACEMENTDB else _run(stage), merge=_merge if many or skips else None,
        skip=lambda inputs: "the toy has nothing to hide" if skips and wishes(inputs).get("skip", True) else None,
    )  # fmt: skip


def _inputs_of(stage):
    order = list(Stage)
    if stage == Stage.PLACEMENTDB:
        return (Stage.VIEWSPACE,)
    # Nothing reads what a job can go on without.
    return tuple(s for s in order[1 : max(order.index(stage), 1)] if s not in OPTIONAL)


def _report(inputs, stages):
    verdict = "valid" if Stage.EVALUATION in inputs.artifacts else "unproven"
    listed = [{"name": s.name, "seconds": s.seconds, "skipped": s.skipped, "shards": s.shards} for s in stages]
    figures = {"bytes": 1500, "hopeless_views": 0, "smallest_budget": {"amount": 9, "text": "9 calls"}}
    curve = [{"budget": 9, "bytes": 1500, "views_over": 0}, {"budget": 12, "bytes": 0, "views_over": 0}]
    budget = {"budget": inputs.settings.budget, "budget_amount": 9, "unit": "calls"}
    return {"verdict": verdict, "stages": listed, "curve": curve, **budget, **figures}


PIPELINE = Pipeline(
    steps={stage: _step(stage, _inputs_of(stage)) for stage in Stage},
    report=_report,
    optional=OPTIONAL,
    isolated=frozenset({Stage.SCENE}),
)
