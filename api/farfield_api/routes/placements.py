"""The files that viewer and tools read: manifest, chunks, pages, scene.glb, report.json; ranges, strong ETags, caching.

A job's placement is one artifact, a container of files: it is unpacked once, below its digest, when first asked for.
A folder registered with `farfield serve --placement` is served as it lies. Either way the address is
/v1/placements/NAME/manifest.json, /v1/placements/NAME/scene.glb, /v1/placements/NAME/report.json.
"""

import hashlib
import os
import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

from farfield.columns import unpack_files
from farfield.errors import JobNotFinished, JobNotFound, PlacementNotFound
from farfield.stages import Stage
from farfield.store import jobs
from farfield.store.artifacts import LocalArtifacts, sync_folder
from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse

from farfield_api.auth import Reader
from farfield_api.errors import RESPONSES
from farfield_api.pages import file_inside
from farfield_api.state import Service, State

router = APIRouter(prefix="/v1/placements", tags=["placements"], responses=RESPONSES)

IMMUTABLE = "private, max-age=31536000, immutable"
TYPES = {".json": "application/json", ".glb": "model/gltf-binary", ".webp": "image/webp", ".png": "image/png"}


@router.get("", summary="Placements to look at: ended jobs and registered folders")
def list_placements(caller: Reader, service: Service) -> dict[str, Any]:
    done = jobs.page(service.engine, caller.tenant_id, state="done", before=None, limit=200)
    listed = [{"id": row.id, "name": row.name, "verdict": row.verdict} for row in done]
    return {"placements": [*({"id": n, "name": n, "verdict": None} for n in service.settings.placements), *listed]}


@router.head("/{placement}/{path:path}", include_in_schema=False)
@router.get("/{placement}/{path:path}", response_class=FileResponse, summary="A file of a placement")
def show(placement: str, path: str, request: Request, caller: Reader, service: Service) -> Response:
    folder = service.settings.placements.get(placement)
    if folder is not None:
        found = _inside(folder, path)
        if found is None:
            raise PlacementNotFound(placement, path)
        # The folder may be placed again under the same name; only names that hold a digest never change.
        caching = IMMUTABLE if re.search("[0-9a-f]{16}", Path(path).name) else "private, no-cache"
        status = found.stat()
        source = f"{status.st_mtime_ns}.{status.st_size}.{status.st_ino}"
    else:
        try:
            root, source = unpacked(service, caller.tenant_id, placement)
        except JobNotFound:
            raise PlacementNotFound(placement) from None
        if path == "report.json":
            row = jobs.get(service.engine, caller.tenant_id, placement)
            found, source = service.artifacts.path(row.report_digest), row.report_digest
        else:
            found = _inside(root, path)
        if found is None:
            raise PlacementNotFound(placement, path)
        caching = IMMUTABLE
    etag = f'"{hashlib.sha256(f"{source}/{path}".encode()).hexdigest()[:32]}"'
    headers = {"etag": etag, "cache-control": caching, "vary": "Cookie, Authorization"}
    if etag in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    media_type = TYPES.get(Path(path).suffix, "application/octet-stream")
    return FileResponse(found, headers=headers, media_type=media_type)


def unpacked_folder(artifacts: LocalArtifacts, digest: str) -> Path:
    """Return where the files of a job's placement lie once they have been asked for."""
    return artifacts.root / "unpacked" / digest


def unpacked(service: State, tenant_id: str, job_id: str) -> tuple[Path, str]:
    """Return (folder with the job's files, digest of its artifact). Raises JobNotFound, JobNotFinished."""
    row = jobs.get(service.engine, tenant_id, job_id)
    digest = jobs.artifact_of(service.engine, job_id, Stage.PLACEMENTDB)
    if row.state != "done" or digest is None:
        raise JobNotFinished(job_id, row.state)
    folder = unpacked_folder(service.artifacts, digest)
    if not folder.is_dir():
        temporary = Path(tempfile.mkdtemp(dir=service.artifacts.temporary, prefix="unpack-"))
        try:
            for name, content in unpack_files(service.artifacts.buffer(digest), where="the placement"):
                target = temporary / name
                assert target.resolve().is_relative_to(temporary.resolve()), name
                target.parent.mkdir(parents=True, exist_ok=True)
                with target.open("wb") as file:
                    file.write(content)
                    file.flush()
                    os.fsync(file.fileno())
            folder.parent.mkdir(exist_ok=True)
            temporary.chmod(0o755)
            temporary.rename(folder)
            sync_folder(folder.parent)
        except OSError:
            # Another request has unpacked the same files meanwhile: theirs are as good.
            shutil.rmtree(temporary, ignore_errors=True)
            if not folder.is_dir():
                raise
    return folder, digest


def _inside(folder: Path, path: str) -> Path | None:
    """Return the file that `path` names: scene.glb and report.json at the top, all else in placement/."""
    return file_inside(folder if path in ("scene.glb", "report.json") else folder / "placement", path)
