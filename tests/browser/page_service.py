"""The real API with the built pages, and a worker on a thread that runs the toy pipeline: what the pages are tested on.

The toy's placement is the golden one, and its report states that placement's figures, so that map and report show
something that is true of the files behind them.
"""

import json
import os
import shutil
import socket
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import toy_pipeline
import uvicorn
from farfield.columns import files_parts
from farfield.evaluation.resident import peak_resident
from farfield.geometry.intervals import direction_at, edges, split_id
from farfield.placementdb.read import Placement
from farfield.settings import to_mapping
from farfield.stages import Stage
from farfield.store import progress, tenants
from farfield.store.artifacts import LocalArtifacts
from farfield.store.engine import open_engine
from farfield_api.app import make_app
from farfield_api.settings import ApiSettings
from farfield_workers.serve import migrate
from farfield_workers.settings import WorkerSettings
from farfield_workers.work import work

ROOT = Path(__file__).resolve().parents[2]
WEB = Path(os.environ.get("FARFIELD_WEB", ROOT / "webviewer" / "dist"))
GOLDEN = ROOT / "tests" / "golden" / "placementdb"


def golden_report(stages: list[dict[str, Any]], *, settings: Any = None, verdict: str | None = None) -> dict[str, Any]:
    """Return a report with every key of docs/formats/report.md, as true of the golden placement."""
    placement = Placement.open(GOLDEN)
    manifest, index = placement.manifest, placement.index
    counts, budget = manifest["counts"], manifest["budget"]
    cells = index["node_box"][index["cell_node"]] + placement.origin_m
    e = edges(len(manifest["interval_edges"]) - 1)
    views = []
    for chunk in range(counts["chunks"]):
        held = placement.chunk(chunk)
        first_cell, first_view = manifest["chunks"][chunk]["cells"][0], manifest["chunks"][chunk]["views"][0]
        for local in range(len(held["cell_view"]) - 1):
            for v in range(held["cell_view"][local], held["cell_view"][local + 1]):
                interval = int(held["view_interval"][v])
                face, i, j = split_id(interval, len(e) - 1)
                box = cells[first_cell + local]
                views.append({
                    "problem_view": first_view + v, "cell": first_cell + local, "interval": interval,
                    "box": box.tolist(), "position": box.mean(0).tolist(),
                    "direction": direction_at(face, (e[i] + e[i + 1]) / 2, (e[j] + e[j + 1]) / 2).tolist(),
                    "geometry_cost": int(held["view_geometry_cost"][v]) + 3, "cost_bound": int(held["view_cost"][v]) + 3,
                    "impostors": 2, "hopeless": bool(held["view_hopeless"][v]),
                })  # fmt: skip
    blamed = [
        {"id": o, "name": name, "box": cells[0].tolist(), "triangles": 12, "calls": 1, "hopeless_views": 90 - 40 * o}
        for o, name in enumerate(["=crowd_plaza_07", "scaffold_north"])
    ]
    hopeless = [
        {**v, "best": v["cost_bound"], "culprits": blamed[: 1 + k % 2]} for k, v in enumerate(views) if v["hopeless"]
    ]
    worst = max(views, key=lambda v: v["cost_bound"])
    return {
        "format": "farfield report", "version": 1, "verdict": verdict or manifest["verdict"], "budget": budget["text"],
        "budget_amount": budget["amount"], "unit": budget["unit"], "per_frame": 3,
        "smallest_budget": {"amount": 24, "text": "24 calls"}, **counts, "candidates": 113, "bytes": manifest["bytes"],
        "file_bytes": manifest["file_bytes"], "video_bytes": manifest["video_bytes"], "lower_bound_bytes": None, "bound": None,
        "camera": manifest["camera"], "quality": manifest["quality"], "bounds": manifest["bounds"],
        "view_space": manifest["view_space"], "stages": stages, "seconds": sum(s["seconds"] for s in stages),
        "peak_bytes": max(s["peak_bytes"] for s in stages), "seed": 0,
        "settings": to_mapping(settings) if settings else {}, "worst_geometry_cost": 27,
        "worst_cost_bound": worst["cost_bound"], "worst_views": sorted(views, key=lambda v: -v["cost_bound"])[:16],
        "hopeless": hopeless[:100], "culprits": blamed, "stopped": False,
        "curve": [{"budget": b, "bytes": n, "views_over": v} for b, n, v in
                  ((20, 45576, 3), (21, 30112, 3), (22, 21500, 1), (24, 9004, 0), (27, 0, 0))],
        "verified": {"views": 1000, "over_budget": 0, "over_bound": 0, "worst_ratio": 0.95, "in_problem_views": 321,
                     "resident": peak_resident(placement),
                     "worst_view": {"position": worst["position"], "direction": worst["direction"], "cost": 20}},
        "warnings": ["a made-up town"], "dropped_triangles": 4, "not_baked": [], "software": {"farfield": "0.1.0"},
        "inputs": {},
    }  # fmt: skip


def _report(inputs: Any, stages: Any) -> dict[str, Any]:
    listed = [
        {"name": str(s.name), "seconds": s.seconds, "peak_bytes": 50_000_000 * (1 + k % 4), "skipped": s.skipped}
        for k, s in enumerate(stages)
    ]
    if toy_pipeline.wishes(inputs).get("plain"):
        return {"verdict": "valid", "stages": listed}  # the least that a report may be
    return golden_report(listed, settings=inputs.settings, verdict=toy_pipeline.wishes(inputs).get("verdict"))


def _files(inputs: Any, shard: Any) -> list[bytes]:
    names = [p for p in GOLDEN.rglob("*") if p.is_file() and p.name != "lookups.json"]
    held = {f"placement/{p.relative_to(GOLDEN).as_posix()}": p.read_bytes() for p in sorted(names)}
    return files_parts({"scene.glb": b"glTF", **held})


def _pipeline() -> Any:
    steps = dict(toy_pipeline.PIPELINE.steps)
    steps[Stage.PLACEMENTDB] = replace(steps[Stage.PLACEMENTDB], run=_files)
    return replace(toy_pipeline.PIPELINE, steps=steps, report=_report, isolated=frozenset())


class PageService:
    """Start it, use `url` and a key (`operator` is another tenant's), stop it.

    `stop_api` and `start_api` in between are a restart on the same port.
    """

    def __init__(self, folder: Path) -> None:
        self.engine = open_engine(f"sqlite:///{folder / 'farfield.sqlite'}")
        migrate(self.engine, ROOT / "migrations")
        tenant = tenants.create_tenant(self.engine, "toy")
        self.key = tenants.create_key(self.engine, tenant, "test", ("read", "submit", "admin"))
        self.reader = tenants.create_key(self.engine, tenant, "reader", ("read",))
        operator = tenants.create_tenant(self.engine, "the operator", operator=True)
        self.operator = tenants.create_key(self.engine, operator, "operator", ("read", "submit", "admin"))
        town = folder / "town"
        shutil.copytree(GOLDEN, town / "placement")
        stages = [{"name": str(s), "seconds": 1.5, "peak_bytes": 40_000_000, "skipped": None} for s in Stage]
        (town / "report.json").write_text(json.dumps(golden_report(stages)))
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"
        self.settings = ApiSettings(
            database_url=str(self.engine.url), broker_url=f"redis+socket://{folder}/none.sock",
            artifacts=folder / "artifacts", secret="ab" * 32, web=WEB, poll_s=0.05, inspect_seconds=20,
            inspect_command=(sys.executable, str(Path(__file__).with_name("page_inspect.py"))),
            placements={"town": town},
        )  # fmt: skip
        self.working = threading.Event()
        self.working.set()
        self._stop = threading.Event()
        self._worker = threading.Thread(target=self._work, daemon=True)

    def start(self) -> None:
        self.start_api()
        self._worker.start()

    def stop(self) -> None:
        self._stop.set()
        self._worker.join()
        self.stop_api()
        self.engine.dispose()

    def start_api(self) -> None:
        config = uvicorn.Config(make_app(self.settings), port=self.port, log_level="error", timeout_graceful_shutdown=1)
        self._server = uvicorn.Server(config)
        self._api = threading.Thread(target=self._server.run, daemon=True)
        self._api.start()
        while not self._server.started:
            time.sleep(0.01)

    def stop_api(self) -> None:
        self._server.should_exit = True
        self._api.join()

    def _work(self) -> None:
        settings = WorkerSettings(
            database_url="", broker_url="", artifacts=self.settings.artifacts, worker="host:1:ab", pipeline="",
            lease_s=60.0, renew_s=1.0, scene_memory_bytes=0, scene_seconds=60,
        )  # fmt: skip
        artifacts, pipeline = LocalArtifacts(self.settings.artifacts), _pipeline()
        while not self._stop.wait(0.02):
            waiting = progress.ready(self.engine) if self.working.is_set() else []
            while waiting and self.working.is_set() and not self._stop.is_set():
                with suppress(Exception):  # the toy fails where it is told to; the shard's row says so
                    waiting += work(self.engine, artifacts, pipeline, settings, waiting.pop(0).shard_id)
