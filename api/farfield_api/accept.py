"""A file that has arrived becomes a scene: known already, or read in a process with limits, stored and written down."""

import errno
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import sqlalchemy as sa
from farfield.errors import SceneNotFound, SceneUnreadable
from farfield.store import scenes
from starlette.concurrency import run_in_threadpool

from farfield_api.apart import SCENES, read_apart
from farfield_api.state import State

SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl", ".zip")
MAGICS = ((b"glTF", ".glb"), (b"PK\x03\x04", ".zip"), (b"ply", ".ply"), (b"solid", ".stl"))


@dataclass(frozen=True, slots=True, kw_only=True)
class Arrived:
    """A whole file, and the name it was sent under."""

    path: Path
    name: str
    n_bytes: int
    digest: str


async def accept(service: State, tenant_id: str, file: Arrived) -> tuple[sa.Row[Any], bool]:
    """Return (the scene's row, whether it is new to this tenant); the file stays. Raises SceneError, InputRefused."""
    known = await run_in_threadpool(_known, service, tenant_id, file.digest)
    if known is not None:
        return known, False
    suffix = suffix_of(file)
    with TemporaryDirectory(dir=service.artifacts.temporary, prefix="read-") as folder:
        scene = Path(folder) / f"scene{suffix}"
        await run_in_threadpool(_link, file.path, scene)
        reader = [*service.settings.inspect_command, "--out", folder]
        shown = file.name or f"the scene{suffix}"
        async with SCENES:
            summary = await read_apart(reader, scene, shown, service.settings)
        return await run_in_threadpool(_store, service, tenant_id, file, scene, summary), True


def _known(service: State, tenant_id: str, digest: str) -> sa.Row[Any] | None:
    """Return the scene's row where the tenant has sent it, and nothing of it was lost: else it is stored anew."""
    try:
        row = scenes.get(service.engine, tenant_id, digest)
    except SceneNotFound:
        return None
    blobs = (row.digest, row.inspect_digest, row.picture_digest)
    return row if all(service.artifacts.has(blob) for blob in blobs if blob is not None) else None


def suffix_of(file: Arrived) -> str:
    """Return the ending that says the format: of the name, or by the first bytes. Raises SceneUnreadable."""
    suffix = Path(file.name).suffix.lower()
    if suffix in SUFFIXES:
        return suffix
    with file.path.open("rb") as opened:
        head = opened.read(16)
    for magic, found in MAGICS:
        if head.startswith(magic):
            return found
    raise SceneUnreadable(f"{file.name or 'the upload'} is none of {', '.join(SUFFIXES)}")


def _link(path: Path, link: Path) -> None:
    try:
        os.link(path, link)
    except OSError as error:
        if error.errno not in (errno.EXDEV, errno.EPERM, errno.EOPNOTSUPP):
            raise
        shutil.copyfile(path, link)


def _store(service: State, tenant_id: str, file: Arrived, scene: Path, summary: dict[str, Any]) -> sa.Row[Any]:
    """Blobs first: a row never names what is not there."""
    stored: dict[str, Any] = {}
    for part, path in (("inspect", scene.with_name("inspect.json")), ("picture", scene.with_name("picture.png"))):
        if path.is_file():
            stored[f"{part}_bytes"] = path.stat().st_size
            stored[f"{part}_digest"] = service.artifacts.put_file(path)
    service.artifacts.put_file(scene, file.digest)
    scenes.add(
        service.engine, tenant_id, digest=file.digest, name=file.name or scene.name, suffix=scene.suffix,
        n_bytes=file.n_bytes, summary=summary, quota=service.settings.quota, check=service.artifacts.has, **stored,
    )  # fmt: skip
    return scenes.get(service.engine, tenant_id, file.digest)
