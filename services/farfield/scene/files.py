"""The files of a level: a folder or a zip, and which names in it may be read.

Only files at or below the scene's own folder are read, whatever the scene names; nothing is ever fetched. A name with a
scheme (but `data:`), an absolute one, one that climbs out by `..` or through a symbolic link is refused by name.
Sizes are checked before a file is read or unpacked; a zip is never unpacked to disk.
"""

import base64
import binascii
import posixpath
import re
import stat
import urllib.parse
import zipfile
import zlib
from pathlib import Path
from typing import Protocol

from farfield.errors import SceneFileMissing, SceneUnreadable, SceneUriRefused
from farfield.scene.limits import Limits, need


class SceneFiles(Protocol):
    """Read access to the files beside a scene; `name` is the scene file's own."""

    name: str

    def read(self, relative: str) -> bytes:
        """Return a file's bytes. Raises SceneUriRefused, SceneFileMissing, SceneOverLimit, SceneUnreadable."""


def relative_name(uri: str, *, base: str = "") -> str:
    """Return the normal form, `a/b.png`, of a reference seen from the folder `base`. Raises SceneUriRefused."""
    name = urllib.parse.unquote(uri).replace("\\", "/")
    if "\0" in name or not name.strip():
        raise SceneUriRefused(f"The scene refers to {_shown(uri)}, which is no file name.")
    if name.startswith("/") or re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", name):
        raise SceneUriRefused(f"The scene refers to {_shown(uri)}; only relative names are read.")
    normal = posixpath.normpath(posixpath.join(base, name))
    if normal == ".." or normal.startswith(("../", "/")):
        raise SceneUriRefused(f"The scene refers to {_shown(uri)}, which is outside its folder.")
    return normal


def _shown(name: str) -> str:
    return repr(name if len(name) <= 200 else name[:199] + "\u2026")


def data_uri(uri: str, *, limits: Limits) -> bytes | None:
    """Return the bytes of a `data:` address, None for any other. Raises SceneUnreadable where it is broken."""
    if uri[:5].lower() != "data:":
        return None
    need(len(uri), limits.bytes, "characters in a data: address")
    head, comma, body = uri[5:].partition(",")
    if not comma:
        raise SceneUnreadable("A data: address has no comma.")
    try:
        if head.lower().endswith(";base64"):
            return base64.b64decode(urllib.parse.unquote(body), validate=True)
        return urllib.parse.unquote_to_bytes(body)
    except (binascii.Error, ValueError) as error:
        raise SceneUnreadable("A data: address is not valid base64.") from error


class Folder:
    """A scene file on disk and what lies beside and below it."""

    def __init__(self, path: Path, limits: Limits) -> None:
        # Whoever names the scene may name a link to it: what it refers to lies beside the file itself.
        whole = path.resolve()
        self.root, self.name = whole.parent, whole.name
        self._limits = limits
        self._total = 0

    def read(self, relative: str) -> bytes:
        try:
            path = (self.root / relative).resolve()
            if not path.is_relative_to(self.root):
                raise SceneUriRefused(f"The scene refers to {_shown(relative)}, which is outside its folder.")
            status = path.stat()
        except (OSError, ValueError, RuntimeError) as error:
            raise SceneFileMissing(f"The scene refers to {_shown(relative)}, which is not there.") from error
        if not stat.S_ISREG(status.st_mode):
            raise SceneFileMissing(f"The scene refers to {_shown(relative)}, which is not a plain file.")
        self._total += status.st_size
        need(self._total, self._limits.bytes, "bytes")
        try:
            return path.read_bytes()
        except OSError as error:
            raise SceneFileMissing(f"The scene refers to {_shown(relative)}, which cannot be read.") from error


_RANKS = {".glb": 0, ".gltf": 0, ".obj": 1, ".ply": 2, ".stl": 3}


class Zip:
    """A zip with one scene in it. `name` is the scene's entry; names may reach anything in the zip, nothing outside."""

    def __init__(self, path: Path, limits: Limits) -> None:
        need(path.stat().st_size, limits.bytes, "bytes")
        self._total = 0
        self._limits = limits
        try:
            self._zip = zipfile.ZipFile(path)
            entries = [e for e in self._zip.infolist() if not e.is_dir()]
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
            raise SceneUnreadable(f"The zip cannot be read: {error}.") from error
        need(len(entries), limits.files, "files")
        need(sum(e.file_size for e in entries), limits.unpacked_bytes, "unpacked bytes")
        self._entries = {posixpath.normpath(e.filename.replace("\\", "/")): e for e in entries}
        self.name = self._scene_name()

    def _scene_name(self) -> str:
        names = [
            n for n in self._entries if not n.startswith("__MACOSX/") and not posixpath.basename(n).startswith(".")
        ]
        ranks = {n: _RANKS[s] for n in names if (s := posixpath.splitext(n)[1].lower()) in _RANKS}
        if not ranks:
            raise SceneUnreadable("The zip holds no glTF, GLB, OBJ, PLY or STL file.")
        best = min(ranks.values())
        found = sorted(n for n, rank in ranks.items() if rank == best)
        if len(found) > 1:
            raise SceneUnreadable(
                f"The zip holds {len(found)} scenes ({', '.join(map(_shown, found[:4]))}); it must hold one."
            )
        return found[0]

    def read(self, relative: str) -> bytes:
        entry = self._entries.get(relative)
        if entry is None:
            raise SceneFileMissing(f"The scene refers to {_shown(relative)}, which is not in the zip.")
        self._total += entry.file_size
        need(self._total, self._limits.unpacked_bytes, "unpacked bytes")
        try:
            with self._zip.open(entry) as stream:
                data = stream.read(entry.file_size + 1)
        except (zipfile.BadZipFile, zlib.error, OSError, RuntimeError, NotImplementedError, EOFError) as error:
            raise SceneUnreadable(f"{_shown(relative)} in the zip cannot be unpacked: {error}.") from error
        if len(data) != entry.file_size:
            raise SceneUnreadable(f"{_shown(relative)} in the zip is not as long as the zip says.")
        return data
