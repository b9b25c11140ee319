"""Serve the built web pages and placement folders under the service's addresses, without the service.

    PYTHONPATH=tests .venv/bin/python tests/browser/static_server.py DIR [--port 8080]     # then open /viewer/NAME of DIR

/viewer/NAME                              webviewer/dist/viewer.html
/v1/placements/NAME/scene.glb             DIR/scene.glb
/v1/placements/NAME/report.json           DIR/report.json, {} where there is none
/v1/placements/NAME/manifest.json, ...    DIR/placement/...
anything else                             webviewer/dist
"""

import argparse
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DIST = ROOT / "webviewer" / "dist"
POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self' blob: data:; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
TYPES = {
    ".html": "text/html; charset=utf-8", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml",
    ".json": "application/json", ".webp": "image/webp", ".ktx2": "image/ktx2", ".glb": "model/gltf-binary",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Cut:
    """The connection breaks after this share of the body; below 0: without any answer."""

    share: float


# Given the path of a request, returns a status to fail with, bytes to send instead, a cut, or None to answer normally.
Trouble = Callable[[str], int | bytes | Cut | None]


def find(path: str, placements: Mapping[str, Path]) -> Path | None:
    """Return the file behind a request's path, None where there is none."""
    parts = path.split("?")[0].strip("/").split("/")
    if ".." in parts:
        return None
    if parts[0] in ("viewer", "jobs", "job", "report"):
        found = DIST / f"{parts[0]}.html"
    elif parts[:2] == ["v1", "placements"] and len(parts) > 3 and parts[2] in placements:
        folder = placements[parts[2]]
        found = (folder if parts[3:] in (["scene.glb"], ["report.json"]) else folder / "placement").joinpath(*parts[3:])
    else:
        found = DIST.joinpath(*parts)
    return found if found.is_file() else None


@contextmanager
def serving(placements: Mapping[str, Path], *, port: int = 0, trouble: Trouble | None = None) -> Iterator[str]:
    """Serve on a thread while the context lasts; yields the address, http://127.0.0.1:PORT."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            made = trouble(self.path) if trouble else None
            found = find(self.path, placements)
            cut, made = (made, None) if isinstance(made, Cut) else (Cut(1.0), made)
            if cut.share < 0:
                self.close_connection = True
                return
            if made is None and found is None and self.path.endswith("/report.json"):
                made = b"{}"
            if isinstance(made, int) or (made is None and found is None):
                self.send_response(made if isinstance(made, int) else 404)
                self.send_header("content-length", "0")
                self.end_headers()
                return
            content = made if isinstance(made, bytes) else found.read_bytes()
            self.send_response(200)
            self.send_header("content-type", TYPES.get(found.suffix if found else "", "application/octet-stream"))
            self.send_header("content-length", str(len(content)))
            self.send_header("content-security-policy", POLICY)
            self.send_header("cache-control", "no-store")
            self.end_headers()
            self.wfile.write(content[: int(cut.share * len(content))])
            self.close_connection = cut.share < 1

        def log_message(self, *_: object) -> None:
            pass

        def handle(self) -> None:
            try:
                super().handle()
            except ConnectionError:
                pass  # the page cancels what it no longer wants

    with listening(Handler, port=port) as url:
        yield url


@contextmanager
def listening(handler: type[BaseHTTPRequestHandler], *, port: int = 0) -> Iterator[str]:
    """Answer on a thread while the context lasts; yields the address, http://127.0.0.1:PORT."""
    server = ThreadingHTTPServer(("127.0.0.1", port), handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--port", type=int, default=8080)
    given = parser.parse_args()
    with serving({given.folder.name: given.folder}, port=given.port) as url:
        print(f"{url}/viewer/{given.folder.name}")
        threading.Event().wait()


if __name__ == "__main__":
    main()
