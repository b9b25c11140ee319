"""An upload across kill -9 of the API and of the client: the same bytes, little memory. With `--bench` it is 1 GiB."""

import fcntl
import hashlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import httpx
import pytest
from farfield.client import Client, file_digest
from farfield.store import tenants
from farfield.store.engine import open_engine

READ = (
    "import json, pathlib, sys; out = pathlib.Path(sys.argv[sys.argv.index('--out') + 1]);"
    "(out / 'inspect.json').write_text('{}'); print(json.dumps({'triangles': 1, 'warnings': []}))"
)
SEND = "import sys, pathlib; from farfield.client import Client; Client(*sys.argv[1:3]).send_scene(pathlib.Path(sys.argv[3]))"


class Api:
    """One API process that is killed and comes back at the same address; the most memory that any of them took."""

    def __init__(self, folder, database):
        engine = open_engine(f"sqlite:///{database}")
        self.key = tenants.create_key(engine, tenants.create_tenant(engine, "toy"), "test", ("read", "submit"))
        engine.dispose()
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.url, self.peak_bytes = f"http://127.0.0.1:{self.port}", 0
        read = folder / "read.py"
        read.write_text(READ)
        self.environment = {
            **os.environ, "FARFIELD_DATABASE_URL": f"sqlite:///{database}", "FARFIELD_HOST": "127.0.0.1",
            "FARFIELD_PORT": str(self.port), "FARFIELD_ARTIFACTS": str(folder / "artifacts"), "FARFIELD_SECRET": "ab" * 32,
            "FARFIELD_BROKER_URL": f"redis+socket://{folder}/none.sock", "FARFIELD_INSPECT": f"{sys.executable} {read}",
        }  # fmt: skip
        self.log = (folder / "api.log").open("ab")
        self.start()

    def start(self):
        command = [sys.executable, "-m", "farfield_api"]
        self.process = subprocess.Popen(command, env=self.environment, stdout=self.log, stderr=self.log)
        for _ in range(600):
            try:
                return httpx.get(f"{self.url}/livez", trust_env=False)
            except httpx.TransportError:
                time.sleep(0.1)
        raise AssertionError("it did not start")

    def look(self):
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        peak = next(int(line.split()[1]) << 10 for line in status.splitlines() if line.startswith("VmHWM"))
        self.peak_bytes = max(self.peak_bytes, peak)

    def kill(self):
        self.look()
        self.process.kill()
        self.process.wait()


@pytest.fixture
def api(tmp_path, empty_database):
    database = tmp_path / "farfield.sqlite"
    database.write_bytes(empty_database.read_bytes())
    made = Api(tmp_path, database)
    yield made
    made.kill()
    made.log.close()


def test_an_upload_survives_the_kill_of_either_side(api, tmp_path, request):
    n_bytes = (1 << 30) if request.config.getoption("--bench") else (40 << 20)
    path = tmp_path / "level.glb"
    with path.open("wb") as file:
        for k in range(n_bytes >> 20):
            file.write(hashlib.shake_256(str(k).encode()).digest(1 << 20))
    digest, started = file_digest(path), time.monotonic()

    sender = subprocess.Popen([sys.executable, "-c", SEND, api.url, api.key, str(path)])
    with Client(api.url, api.key, trust_proxy=False) as service:
        upload = lambda: next(iter(service._get("/v1/uploads", {"sha256": digest})["uploads"]), None)  # noqa: E731
        folder = tmp_path / "artifacts" / "uploads"
        while not (folder.is_dir() and any(f.stat().st_size > n_bytes // 4 for f in folder.iterdir())):
            assert sender.poll() is None
            time.sleep(0.005)
        sender.send_signal(signal.SIGKILL)
        sender.wait()
        with next(folder.iterdir()).open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX)  # until the API has seen that the line is dead
        kept = upload()["received"]
        assert n_bytes // 4 < kept <= n_bytes
        seen, killed = [], threading.Event()

        def sent(n):
            seen.append(n)
            if sum(seen) > 3 * n_bytes // 4 and not killed.is_set():
                killed.set()
                api.kill()
                threading.Thread(target=api.start).start()

        told = service.send_scene(path, digest=digest, sent=sent)
        seconds = time.monotonic() - started
    assert killed.is_set()
    assert seen[0] == kept, "what the killed client sent is not sent again"
    assert sum(seen) == n_bytes
    blob = tmp_path / "artifacts" / digest[:2] / digest
    assert (told["digest"], told["bytes"], file_digest(blob)) == (digest, n_bytes, digest)
    assert os.listdir(folder) == []
    api.look()
    print(
        f"\n{n_bytes >> 20} MiB in {seconds:.1f} s across two kills; the API took at most {api.peak_bytes / 2**20:.0f} MiB"
    )
    assert api.peak_bytes < 100 << 20 or not request.config.getoption("--bench")
