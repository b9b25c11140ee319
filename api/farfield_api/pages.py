"""The built pages of the web viewer, and /open, where a login link becomes a session. No inline script anywhere."""

from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse, RedirectResponse, Response
from starlette.exceptions import HTTPException

OURS = Path(__file__).with_name("open")
HASHED = "public, max-age=31536000, immutable"


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
    add("/compare", "compare.html")
    add("/workers", "workers.html")
    add("/storage", "storage.html")
    add("/devices", "devices.html")
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
