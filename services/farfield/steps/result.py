"""Stages 10 to 12: the placement's files, and what was tried against them."""

import hashlib
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from farfield.columns import Parts, files_parts, pack_parts, unpack, unpack_files
from farfield.stages import Stage
from farfield.steps.impostors import open_base
from farfield.steps.model import Inputs, Shard, cells_of

# 10 placementdb -----------------------------------------------------------------------------------------------------


def placementdb(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.placementdb.base import NAME
    from farfield.placementdb.write import build
    from farfield.scene.write import write_glb

    scene = inputs.get(Stage.SCENE)
    glb = write_glb(scene, inputs.get(Stage.DETAIL).of_meshes())
    digests = {str(stage): inputs.digests[stage] for stage in (Stage.SCENE, Stage.HIERARCHY, Stage.BAKE, Stage.REPAIR)}
    digests["scene.glb"] = hashlib.sha256(glb).hexdigest()
    placement = inputs.get(Stage.REPAIR)
    kept = open_base(inputs).layers_of(placement.base[placement.base >= 0]) if len(placement.base) else None
    files, base = build(
        scene, inputs.get(Stage.HIERARCHY), inputs.get(Stage.RENDERTIME), cells_of(inputs),
        inputs.get(Stage.VISIBILITY), inputs.get(Stage.VIEWSPACE), placement, inputs.get(Stage.BAKE),
        settings=inputs.settings, digests=digests, levels=inputs.get(Stage.DETAIL), kept=kept,
    )  # fmt: skip
    below = {f"placement/{name}": content for name, content in files.items()}
    return files_parts({"scene.glb": glb, NAME: base, **below})


# 11 evaluation ------------------------------------------------------------------------------------------------------

VIEWS_A_SHARD, SHARDS = 500, 4


def evaluation_plan(inputs: Inputs) -> list[Shard]:
    return [[inputs.settings.seed + i, VIEWS_A_SHARD] for i in range(SHARDS)]


def evaluation(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.evaluation.verify import verify

    with tempfile.TemporaryDirectory(prefix="farfield-") as folder:
        write_files(inputs.artifacts[Stage.PLACEMENTDB], Path(folder))
        return pack_parts("verified", {}, verify(Path(folder), views=shard[1], seed=shard[0]))


def evaluation_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.evaluation.verify import merge_found

    return pack_parts("verified", {}, merge_found([unpack(a)[2] for a in artifacts]))


# 12 proof -----------------------------------------------------------------------------------------------------------

PAIRS_A_SHARD = 80


def proof_skip(inputs: Inputs) -> str | None:
    if inputs.settings.proof.mode == "off":
        return "proof.mode is off"
    return None if _shown_impostors(inputs) else "no impostor is shown anywhere"


def _shown_impostors(inputs: Inputs) -> int:
    from farfield.placementdb.squeeze import expand

    files = dict(unpack_files(inputs.artifacts[Stage.PLACEMENTDB], where="artifact of stage placementdb"))
    entry = json.loads(bytes(files["placement/manifest.json"]))["index"]
    columns = expand(bytes(files[f"placement/{entry['file']}"]), entry["expanded"], where=entry["file"])[1]
    return int((columns["impostor_chunk"] >= 0).sum())


def proof_plan(inputs: Inputs) -> list[Shard]:
    proof = inputs.settings.proof
    each = proof.views if proof.mode == "all" else 0
    pairs = _shown_impostors(inputs) * each if each else proof.pairs
    return [[first, min(PAIRS_A_SHARD, pairs - first), each] for first in range(0, pairs, PAIRS_A_SHARD)]


def proof(inputs: Inputs, shard: Shard) -> Parts:
    from farfield.evaluation.proof.prove import prove_apart

    first, count, each = shard
    with tempfile.TemporaryDirectory(prefix="farfield-") as folder:
        write_files(inputs.artifacts[Stage.PLACEMENTDB], Path(folder))
        return pack_parts("proof", {}, prove_apart(Path(folder), first, count, seed=inputs.settings.seed, each=each))


def proof_merge(inputs: Inputs, artifacts: Sequence[Any]) -> Parts:
    from farfield.evaluation.proof.merge import merge_proofs

    found = [unpack(a)[2] for a in artifacts]
    return pack_parts("proof", {}, merge_proofs(found, confidence=inputs.settings.proof.confidence))


def write_files(buffer: Any, folder: Path) -> None:
    """Write the files of a stage `placementdb` artifact below `folder`: scene.glb, base.ffc and placement/..."""
    for name, content in unpack_files(buffer, where="artifact of stage placementdb"):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
