"""A service of many processes, as an orchestrator starts it: API, reconciler and workers, that share only URLs."""

import json
import os
import secrets
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import httpx
import racing
from farfield.columns import unpack_files
from farfield.executor import THREADS
from farfield.settings import Settings, to_mapping
from farfield.stages import Stage
from farfield.store import jobs, scenes, tenants
from farfield.store.artifacts import LocalArtifacts
from farfield.store.engine import open_engine
from farfield.store.migrate import migrate
from farfield_workers.children import die_with_parent
from servers import MIGRATIONS

FARFIELD = (sys.executable, "-m", "farfield.cli.main")


class Fleet:
    """Its processes; each host has a folder of local copies, and may have words before its commands (`ip netns exec ...`)."""

    def __init__(
        self, folder: Path, *, database: str, broker: str, bucket: str, environment: Mapping[str, str]
    ) -> None:
        self.folder, self.processes = folder, dict[str, subprocess.Popen[bytes]]()
        self.environment = {
            **os.environ, **environment, "FARFIELD_DATABASE_URL": database, "FARFIELD_BROKER_URL": broker,
            "FARFIELD_ARTIFACTS": bucket, "FARFIELD_SECRET": secrets.token_hex(32), "FARFIELD_RATE_STORE": broker,
            "FARFIELD_WEB": str(folder / "web"), "FARFIELD_UPLOADS": str(folder / "uploads"), "PYTHONUNBUFFERED": "1", **THREADS,
        }  # fmt: skip
        (folder / "uploads").mkdir()
        self.key = ""

    def migrate(self) -> None:
        told = self.run(
            *FARFIELD, "migrate", "--make-bucket", "--first-key", FARFIELD_CACHE=str(self.folder / "migrate")
        )
        self.key = told.strip()

    def run(self, *words: str, **environment: str) -> str:
        done = subprocess.run(
            words, env={**self.environment, **environment}, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def start(self, name: str, *words: str, host: str = "one", before: Sequence[str] = (), **environment: str) -> None:
        """Start `python -m WORDS` on a host."""
        given = {**self.environment, "FARFIELD_CACHE": str(self.folder / host), **environment}
        with (self.folder / f"{name}.log").open("ab") as log:
            self.processes[name] = subprocess.Popen(
                [*before, sys.executable, "-m", *words], env=given, stdout=log, stderr=log, start_new_session=True,
                preexec_fn=die_with_parent,
            )  # fmt: skip

    def serve(self, port: int, host: str = "127.0.0.1", **words: Any) -> httpx.Client:
        """Start the API and return a client, once it is ready."""
        self.start("api", "farfield_api", FARFIELD_PORT=str(port), FARFIELD_HOST=host, host="api", **words)
        self.url = f"http://{host}:{port}"
        client = httpx.Client(
            base_url=self.url, headers={"authorization": f"Bearer {self.key}"}, timeout=30, trust_env=False
        )
        end = time.monotonic() + 60
        while True:
            try:
                if client.get("/readyz").status_code == 200:
                    return client
            except httpx.TransportError:
                pass
            assert time.monotonic() < end, self.log("api")
            time.sleep(0.1)

    def submit(self, scene: Path, *words: str) -> str:
        told = self.run(*FARFIELD, "submit", str(scene), "--url", self.url, "--json", *words, FARFIELD_KEY=self.key)
        return str(json.loads(told)["id"])

    def fetch(self, job: str, out: Path) -> None:
        self.run(*FARFIELD, "fetch", job, "--out", str(out), "--url", self.url, "--json", FARFIELD_KEY=self.key)

    def wait(self, client: httpx.Client, job: str, seconds: float = 240.0) -> dict[str, Any]:
        """Return the job's state once it has ended."""
        end = time.monotonic() + seconds
        while (state := client.get(f"/v1/jobs/{job}").json())["state"] in ("queued", "running"):
            assert time.monotonic() < end, (state, {n: self.log(n)[-2000:] for n in self.processes})
            time.sleep(0.2)
        return dict(state)

    def log(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text(errors="replace")

    def stop(self) -> None:
        running = [p for p in self.processes.values() if p.poll() is None]
        for process in running:
            process.terminate()
        for process in running:
            try:
                process.wait(15)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def calm_files(folder: Path, wish: Mapping[str, Any]) -> dict[str, bytes]:
    """Return the files of a toy job that one worker does alone, on SQLite and a folder."""
    folder.mkdir()
    url, data = f"sqlite:///{folder / 'farfield.sqlite'}", json.dumps(wish).encode()
    engine, artifacts = open_engine(url), LocalArtifacts(folder / "artifacts")
    migrate(engine, MIGRATIONS)
    tenant_id, digest = tenants.create_tenant(engine, "toy"), artifacts.put(data)
    scenes.add(engine, tenant_id, digest=digest, name="toy.glb", suffix=".glb", n_bytes=len(data), summary={},
               inspect_digest=artifacts.put(b"{}"), inspect_bytes=2)  # fmt: skip
    job_id, _ = jobs.create(
        engine, tenant_id, name="toy", scene_digest=digest, settings=to_mapping(Settings()), stages=list(Stage),
        idempotency_key=None,
    )  # fmt: skip
    racing.main(url, str(folder / "artifacts"), "0")
    found = jobs.artifact_of(engine, job_id, Stage.PLACEMENTDB)
    assert found is not None
    engine.dispose()
    return {name: bytes(content) for name, content in unpack_files(artifacts.buffer(found))}
