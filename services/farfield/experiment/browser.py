"""One page of the viewer in a headless Chromium: serves it a placement and a task, takes what it measured.

No driver and no protocol: the page fetches its task from the server that this opens on the loopback, and posts its result there.
"""

import json
import os
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

PAGE = "methods.html"
TYPES = {".html": "text/html; charset=utf-8", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml",
         ".wasm": "application/wasm", ".json": "application/json"}  # fmt: skip
# Software WebGL2, and nothing that talks to the network.
QUIET = ("--headless", "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run",
         "--disable-dev-shm-usage", "--disable-renderer-backgrounding", "--window-size=800,600")  # fmt: skip
SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
_MOST_POSTED = 512 * 2**20


class PageFailed(Exception):
    """The page did not measure what it was asked to; the message is for a table's cell."""


def find_browser() -> str | None:
    """Return a Chromium's path, None where there is none; FARFIELD_CHROMIUM names one."""
    names = (os.environ.get("FARFIELD_CHROMIUM", ""), "chromium", "chromium-browser", "google-chrome")
    return next((found for name in names if name and (found := shutil.which(name))), None)


def find_pages() -> Path | None:
    """Return the folder of the built web pages, None where there is none; FARFIELD_WEB names one."""
    folder = Path(os.environ.get("FARFIELD_WEB") or Path(__file__).resolve().parents[3] / "webviewer" / "dist")
    return folder if (folder / PAGE).is_file() else None


class Pages:
    """Serves the pages while the context lasts. Pictures that a page posts are kept for the pages after it."""

    def __init__(self, web: Path, browser: str, *, gpu: bool = False) -> None:
        self.web, self.browser, self.gpu = web, browser, gpu
        self.files: Mapping[str, Path] = {}
        self.task = b""
        self.pictures: dict[str, bytes] = {}
        self.result: dict[str, Any] | None = None
        self.done = threading.Event()
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(self))
        self._server.daemon_threads = True

    def __enter__(self) -> "Pages":
        threading.Thread(target=self._server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    def measure(self, task: Mapping[str, Any], folder: Path, scene: Path, *, limit_s: float) -> dict[str, Any]:
        """Open the page on the placement in `folder`, with `scene` as its geometry; return what it posts. Raises PageFailed."""
        self.files = {str(p.relative_to(folder)): p for p in folder.rglob("*") if p.is_file()} | {"scene.glb": scene}
        self.task, self.result = json.dumps(task).encode(), None
        self.done.clear()
        with tempfile.TemporaryDirectory(prefix="farfield-browser-", ignore_cleanup_errors=True) as profile:
            flags = [*QUIET, *(() if self.gpu else SOFTWARE), *(("--no-sandbox",) if _is_root() else ())]
            command = [
                self.browser,
                *flags,
                f"--user-data-dir={profile}",
                f"http://127.0.0.1:{self._server.server_port}/{PAGE}",
            ]
            with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
                try:
                    self._wait(process, limit_s)
                finally:
                    process.terminate()
                    try:
                        process.wait(20)
                    except subprocess.TimeoutExpired:
                        process.kill()
        if self.result is None:
            raise PageFailed("the page posted nothing that can be read")
        if "error" in self.result:
            raise PageFailed(str(self.result["error"]).splitlines()[0])
        return self.result

    def _wait(self, process: "subprocess.Popen[bytes]", limit_s: float) -> None:
        until = time.monotonic() + limit_s
        while not self.done.wait(0.2):
            if process.poll() is not None:
                raise PageFailed(f"the browser ended with code {process.returncode}")
            if time.monotonic() > until:
                raise PageFailed(f"not done after {limit_s:g} s")

    def posted(self, path: str, body: bytes) -> bool:
        """Take what a page posts; False where nobody waits for it."""
        if path.startswith("/compare/picture/"):
            self.pictures[path] = body
        elif path == "/compare/result" and not self.done.is_set():
            try:
                told = json.loads(body)
                self.result = told if isinstance(told, dict) else None
            except ValueError:
                self.result = None
            self.done.set()
        else:
            return False
        return True

    def answer(self, path: str) -> tuple[str, bytes | Path] | None:
        """Return type and content of an address, None where there is nothing."""
        if path == "/compare/task":
            return "application/json", self.task
        if path in self.pictures:
            return "application/octet-stream", self.pictures[path]
        if path.startswith("/compare/files/"):
            found = self.files.get(path.removeprefix("/compare/files/"))
            return None if found is None else ("application/octet-stream", found)
        file = (self.web / path.lstrip("/")).resolve()
        if not file.is_relative_to(self.web.resolve()) or not file.is_file():
            return None
        return TYPES.get(file.suffix, "application/octet-stream"), file


def _is_root() -> bool:
    return hasattr(os, "geteuid") and os.geteuid() == 0


def _handler(pages: Pages) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            found = pages.answer(self.path.split("?")[0])
            kind, content = found or ("text/plain", b"")
            self._send(200 if found else 404, kind, content.read_bytes() if isinstance(content, Path) else content)

        def do_POST(self) -> None:
            length = int(self.headers.get("content-length") or 0)
            if length > _MOST_POSTED:
                self._send(413, "text/plain", b"")
                return
            self._send(200 if pages.posted(self.path, self.rfile.read(length)) else 404, "text/plain", b"")

        def _send(self, status: int, kind: str, content: bytes) -> None:
            self.send_response(status)
            self.send_header("content-type", kind)
            self.send_header("content-length", str(len(content)))
            self.send_header("cache-control", "no-store")
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            pass

        def handle(self) -> None:
            try:
                super().handle()
            except ConnectionError:
                pass  # the page cancels what it no longer wants

    return Handler
