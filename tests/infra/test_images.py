"""What the images install suffices: their lock files in fresh environments, made as the Dockerfile makes them (--images).

No container runtime is needed, and the package index is.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest
from farfield.store import tenants
from farfield.store.engine import open_engine
from farfield.store.migrate import migrate
from farfield_workers.children import die_with_parent
from servers import free_port

ROOT = Path(__file__).parents[2]
UV = ROOT / ".cache" / "uv" / "bin" / "uv"
MEMBERS = {"api": ["farfield", "farfield_api"], "reader": ["farfield", "farfield_api"],
           "worker": ["farfield", "farfield_workers"], "baker": ["farfield", "farfield_workers"]}  # fmt: skip
IMPORT_ALL = """
import importlib, pkgutil, sys
for name in sys.argv[1].split(","):
    package = importlib.import_module(name)
    for module in pkgutil.walk_packages(package.__path__, name + "."):
        if not any(part in module.name for part in sys.argv[2].split(",")):
            importlib.import_module(module.name)
print("all")
"""


def uv(*words):
    environment = {**os.environ, "UV_PYTHON_DOWNLOADS": "never", "UV_LINK_MODE": "copy"}
    subprocess.run([UV, "--quiet", *map(str, words)], check=True, env=environment, cwd=ROOT)


def clean(**more):
    """An environment without anything of ours."""
    kept = {k: v for k, v in os.environ.items() if k in ("PATH", "LANG", "LD_LIBRARY_PATH")}
    return {**kept, "HOME": "/tmp", **{k: str(v) for k, v in more.items()}}


def level(folder):
    """A tetrahedron of ten metres."""
    path = folder / "level.obj"
    path.write_text("v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    return path


@pytest.fixture(scope="module")
def pythons(request, tmp_path_factory):
    """The interpreter of each image's environment."""
    if not request.config.getoption("--images"):
        pytest.skip("installs the images' lock files: --images")
    folder = tmp_path_factory.mktemp("images")
    for name in ("build", *MEMBERS):
        uv("venv", "--python", sys.executable, folder / name)
        lock = ROOT / "infra" / "requirements" / f"{name}.lock"
        uv("pip", "sync", "--python", folder / name / "bin" / "python", "--require-hashes", lock)
    for member in ("services", "api", "workers"):
        uv("build", "--wheel", "--no-build-isolation", "--python", folder / "build" / "bin" / "python",
           "--out-dir", folder / "wheels", ROOT / member)  # fmt: skip
    for name, members in MEMBERS.items():
        wheels = [next((folder / "wheels").glob(f"{member}-*.whl")) for member in members]
        uv("pip", "install", "--python", folder / name / "bin" / "python", "--no-deps", "--offline", *wheels)
    return {name: folder / name / "bin" / "python" for name in MEMBERS}


def test_the_api_starts_and_reads_a_level_without_numba_in_its_process(pythons, tmp_path):
    database, port = f"sqlite:///{tmp_path / 'farfield.sqlite'}", free_port()
    engine = open_engine(database)
    migrate(engine, ROOT / "migrations")
    key = tenants.create_key(engine, tenants.create_tenant(engine, "t"), "t", ("read", "submit"))
    engine.dispose()
    reader = f"{pythons['reader']} -m farfield.cli.main"
    environment = clean(
        FARFIELD_DATABASE_URL=database, FARFIELD_BROKER_URL=f"redis+socket://{tmp_path}/none", FARFIELD_PORT=port,
        FARFIELD_ARTIFACTS=tmp_path / "artifacts", FARFIELD_MIGRATIONS=ROOT / "migrations", FARFIELD_WEB=tmp_path,
        FARFIELD_INSPECT=f"{reader} inspect --json", FARFIELD_CALIBRATE=f"{reader} calibrate --json",
        NUMBA_CACHE_DIR=tmp_path / "numba",
    )  # fmt: skip
    for absent in ("numba", "scipy", "moderngl", "trimesh", "pytest"):
        assert subprocess.run([pythons["api"], "-c", f"import {absent}"], capture_output=True).returncode == 1
    command = [pythons["api"], "-m", "farfield_api"]
    with (tmp_path / "log").open("wb") as log, subprocess.Popen(
        command, env=environment, cwd="/", stdout=log, stderr=log, preexec_fn=die_with_parent
    ) as process:  # fmt: skip
        try:
            client = httpx.Client(base_url=f"http://127.0.0.1:{port}", headers={"authorization": f"Bearer {key}"},
                                  timeout=300, trust_env=False)  # fmt: skip
            end = time.monotonic() + 60
            while True:
                try:
                    ready = client.get("/readyz").json()
                    break
                except httpx.TransportError:
                    assert time.monotonic() < end, (tmp_path / "log").read_text()
                    time.sleep(0.1)
            assert ready["status"] == "degraded", ready  # without a broker
            scene = level(tmp_path)
            name = {"content-disposition": f'attachment; filename="{scene.name}"'}
            sent = client.post("/v1/scenes", content=scene.read_bytes(), headers=name)
            assert sent.status_code == 201, sent.text + (tmp_path / "log").read_text()
            assert sent.json()["triangles"] > 0
        finally:
            process.terminate()


def test_the_workers_environment_has_all_that_its_code_imports_and_runs_a_stage(pythons, tmp_path):
    scene = level(tmp_path)
    environment = clean(NUMBA_CACHE_DIR=tmp_path / "numba", FARFIELD_DATABASE_URL="sqlite://",
                        FARFIELD_BROKER_URL="memory://", FARFIELD_ARTIFACTS=tmp_path / "artifacts")  # fmt: skip
    for name, without in (
        ("worker", ".gl,_gl,proof,.cli,.client,.sending,.exact"),
        ("baker", ".cli,.client,.sending,.exact"),
    ):
        words = [pythons[name], "-c", IMPORT_ALL, "farfield,farfield_workers", f"__main__,{without}"]
        told = subprocess.run(words, env=environment, cwd="/", capture_output=True, text=True)
        assert told.stdout.endswith("all\n"), told.stderr
    words = [pythons["worker"], "-m", "farfield.cli.main", "inspect", "--json", str(scene)]
    told = subprocess.run(words, env=environment, cwd="/", capture_output=True, text=True)
    assert told.returncode == 0, told.stderr
    assert json.loads(told.stdout)["triangles"] > 0
