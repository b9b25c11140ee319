"""A placement's impostors as one .glb, as `farfield export gltf` writes them: in a process apart, streamed from a file.

Problem  An export of a city takes seconds and a gigabyte of address space, and needs what the API does not load.
Method   The placement's own files (not the level's) are laid into a temporary folder piece by piece, or the registered folder
         is linked there; the command line exports them within the limits of `apart`, one export at a time. What is
         sent is read from the finished file, whose folder is gone before the first byte leaves: an answer that ends
         early leaves nothing behind. Memory here: one piece.
"""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO

from farfield.store.artifacts import Artifacts, pieces
from starlette.concurrency import run_in_threadpool

from farfield_api.apart import read_apart
from farfield_api.slices import files_in
from farfield_api.state import State

EXPORTS = asyncio.Semaphore(1)
LEVEL = ("placement/geometry/", "placement/textures/")  # the level's own pages: no impostor needs them


async def export(service: State, source: Path | str, name: str, options: list[str]) -> IO[bytes]:
    """Return the exported .glb, an open file without a name.

    source   a registered folder, or the digest of a job's placement
    name     what to call it in a refusal
    options  of `farfield export gltf`

    Raises InputRefused with the error's name, SceneOverLimit, ArtifactMissing.
    """
    with TemporaryDirectory(dir=service.artifacts.temporary, prefix="export-") as scratch:
        folder, out = Path(scratch) / "placement", Path(scratch) / "impostors.glb"
        command = [*service.settings.export_command, *options, "--out", str(out)]
        async with EXPORTS:  # held while the files lie there: a city's take room
            if isinstance(source, Path):
                folder.symlink_to(source.resolve())
            else:
                await run_in_threadpool(_lay_out, service.artifacts, source, Path(scratch))
            await read_apart(command, folder, name, service.settings)
        return out.open("rb")


def body(file: IO[bytes]) -> Iterator[bytes]:
    """Yield the file's bytes, and close it whether or not all are asked for."""
    with file:
        yield from pieces(file, 0, None)


def _lay_out(artifacts: Artifacts, digest: str, scratch: Path) -> None:
    for name, (start, stop) in files_in(artifacts, digest).items():
        if name.startswith("placement/") and not name.startswith(LEVEL):
            path = (scratch / name).resolve()
            assert path.is_relative_to(scratch.resolve()), "a placement names a file outside its folder"
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("wb") as file:
                for piece in artifacts.stream(digest, start, stop):
                    file.write(piece)
