"""The built pages of the web viewer, and /open, where a login link becomes a session. No inline script anywhere."""

from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse, RedirectResponse, Response
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

OURS = Path(__file__).with_name("open")
HASHED = "public, max-age=31536000, immutable"
# blob: is how three.js hands textures and workers around; styles may be inline, scripts never.
POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; "
    "font-src 'self'; connect-src 'self' blob: data:; worker-src 'self' blob:; base-uri 'none'; form-action 'self'; "
    "frame-ancestors 'none'"
)
HEADERS = {
    "content-security-policy": POLICY,
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}


class SecurityHeaders:
    """Adds the headers to every response."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        self.headers = [(k.encode(), v.encode()) for k, v in HEADERS.items()]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), *self.headers]
            await send(message)

        await self.app(scope, receive, with_headers)


def file_inside(folder: Path, path: str) -> Path | None:
    """Return the file that `path` names below `folder`; None where there is none, or a link leads out of it."""
    try:
        root = folder.resolve()
        found = (root / path).resolve()
        return found if found.is_relative_to(root) and found.is_file() else None
    except (OSError, RuntimeError, ValueError):  # a name too long, links in a circle, a null character
        return None


def add_pages(app: FastAPI, web: Path) -> None:
    """Serve the pages in `web` under the addresses that people see; what is there is looked up at every request."""

    def page(name: str) -> Response:
        found = web / name
        if not found.is_file():
            raise HTTPException(404, "the pages are not built: run `make setup`, or set FARFIELD_WEB")
        return FileResponse(found, headers={"cache-control": "no-cache"})

    def add(path: str, name: str) -> None:
        app.add_api_route(path, lambda: page(name), methods=["GET", "HEAD"], include_in_schema=False)

    def add_with(path: str, name: str) -> None:
        app.add_api_route(path, lambda item: page(name), methods=["GET", "HEAD"], include_in_schema=False)

    add("/jobs", "jobs.html")
    add_with("/jobs/{item}", "job.html")
    add_with("/jobs/{item}/report", "report.html")
    add_with("/viewer/{item}", "viewer.html")
    add_with("/viewer/{item}/report", "report.html")

    @app.get("/", include_in_schema=False)
    def root() -> Response:
        return RedirectResponse("/jobs")

    @app.get("/open", include_in_schema=False)
    def opener() -> Response:
        return FileResponse(OURS / "open.html", headers={"cache-control": "no-store"})

    @app.get("/open/{name}", include_in_schema=False)
    def opener_file(name: str) -> Response:
        if name not in ("open.js", "open.css"):
            raise HTTPException(404, "there is no such file")
        return FileResponse(OURS / name, headers={"cache-control": "no-cache"})

    @app.get("/{path:path}", include_in_schema=False)
    def asset(path: str) -> Response:
        found = file_inside(web, path) if not path.startswith("v1/") else None
        if found is None:
            raise HTTPException(404, f"there is nothing at /{path}")
        return FileResponse(found, headers={"cache-control": HASHED if path.startswith("assets/") else "no-cache"})
