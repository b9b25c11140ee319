"""A made-up town that passes every real stage in seconds, and what an undisturbed run makes of it."""

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

from farfield.scene.write import write_glb
from farfield.settings import CameraSettings, ProofSettings, Settings, ViewSpaceSettings, VisibilitySettings, to_mapping
from farfield.stages import Stage
from farfield.store import jobs, scenes, tenants
from farfield.store.artifacts import LocalArtifacts
from farfield.store.engine import open_engine
from farfield_workers.serve import migrate
from farfield_workers.settings import WorkerSettings
from farfield_workers.table import PIPELINE
from farfield_workers.work import work
from servers import MIGRATIONS
from towns import town


def level(seed: int) -> tuple[bytes, dict]:
    """Return (GLB, settings) of a small town whose middle sees too much."""
    scene = town(48, seed=seed, view_m=16.0)
    boxes = tuple(tuple(map(tuple, box)) for box in scene.view_boxes.tolist())
    settings = Settings(
        budget="24 calls", camera=replace(CameraSettings(), width=160, height=90),
        visibility=VisibilitySettings(mode="off"), proof=ProofSettings(mode="off"),
        view_space=replace(ViewSpaceSettings(), boxes=boxes, cell_m=16.0, interval_deg=45.0),
    )  # fmt: skip
    return write_glb(scene), to_mapping(settings)


def undisturbed(seed: int) -> dict[str, str]:
    """Return the digest of each stage's artifact, made by one worker whom nobody disturbs."""
    glb, settings = level(seed)
    folder = Path(tempfile.mkdtemp(prefix="farfield-calm-"))
    try:
        url = f"sqlite:///{folder / 'farfield.sqlite'}"
        engine = open_engine(url)
        migrate(engine, MIGRATIONS)
        artifacts = LocalArtifacts(folder / "artifacts")
        mine = WorkerSettings(
            database_url=url, broker_url="", artifacts=folder / "artifacts", worker="calm",
            pipeline="farfield_workers.table:PIPELINE", lease_s=60.0, renew_s=5.0, scene_memory_bytes=4 << 30,
            scene_seconds=60,
        )  # fmt: skip
        tenant_id = tenants.create_tenant(engine, "calm")
        digest = artifacts.put(glb)
        scenes.add(
            engine, tenant_id, digest=digest, name="town.glb", suffix=".glb", n_bytes=len(glb), summary={},
            inspect_digest=artifacts.put(b"{}"), inspect_bytes=2,
        )  # fmt: skip
        job_id, message = jobs.create(
            engine, tenant_id, name="town", scene_digest=digest, settings=settings, stages=list(Stage),
            idempotency_key=None,
        )  # fmt: skip
        waiting = [message]
        pipeline = replace(PIPELINE, isolated=frozenset())
        while waiting:
            waiting += work(engine, artifacts, pipeline, mine, waiting.pop(0).shard_id)
        row = jobs.get(engine, tenant_id, job_id)
        assert row.state == "done", row.error
        found = {s["name"]: s["artifact"] for s in jobs.stages_of(engine, job_id)}
        engine.dispose()
        return found
    finally:
        shutil.rmtree(folder)
