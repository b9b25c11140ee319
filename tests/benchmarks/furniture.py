"""The models of the Debian package `sweethome3d-furniture`: 820 textured objects, 9.9 million triangles.

The package is found, or downloaded and unpacked (never installed) by apt into a folder; nothing else is fetched.
Models: (c) Scopia, Reallusion, Andrew Kator and Jennifer Legaz, the contributors of Blend Swap and eTeks; CC BY 3.0
and CC0. Who made which goes into the notice file beside a scene (`attribution`).
"""

import re
import subprocess
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from farfield.errors import SceneFileMissing
from farfield.scene.limits import Limits
from farfield.scene.model import BLEND, OPAQUE
from farfield.scene.obj import read_obj
from farfield.scene.raw import RawScene

PACKAGE = "sweethome3d-furniture"
INSTALLED = Path("/usr/share/sweethome3d/furniture")
NOTICE = "Furniture: (c) Scopia, Reallusion, A. Kator & J. Legaz, Blend Swap contributors, eTeks; CC BY 3.0, CC0"


_AUTHORS_DISK = re.compile(rb"^(\s*map_\w+\s+)(?:[A-Za-z]:)?[\\/].*[\\/]", re.MULTILINE)


class PackageMissing(RuntimeError):
    """The package is not installed and apt cannot download it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """One catalogue entry. `size_m` is what it measures after `turn`: width (x), height (y), depth (z)."""

    name: str
    creator: str
    catalogue: str
    obj: str
    size_m: tuple[float, float, float]
    turn: np.ndarray  # (3,3)


def folder(cache: Path) -> Path:
    """Return the folder with the catalogues, downloading the package into `cache` if need be. Raises PackageMissing."""
    if any(INSTALLED.glob("*.sh3f")):
        return INSTALLED
    unpacked = cache / PACKAGE
    found = unpacked / INSTALLED.relative_to("/")
    if not any(found.glob("*.sh3f")):
        unpacked.mkdir(parents=True, exist_ok=True)
        try:
            subprocess.run(["apt-get", "download", PACKAGE], cwd=unpacked, check=True, capture_output=True, timeout=600)
            (archive,) = unpacked.glob(f"{PACKAGE}_*.deb")
            subprocess.run(["dpkg", "-x", str(archive), str(unpacked)], check=True, capture_output=True, timeout=600)
            archive.unlink()
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            raise PackageMissing(f"{PACKAGE} is not installed, and apt could not download it") from error
    return found


def read_models(where: Path) -> Iterator[tuple[Model, RawScene]]:
    """Yield every model of every catalogue, in order of catalogue and number, with its meshes as the file has them.

    Materials that let light through are made opaque: they could not be replaced, and nothing that holds them.
    """
    for path in sorted(where.glob("*.sh3f")):
        with zipfile.ZipFile(path) as catalogue:
            for model in _entries(catalogue, path.stem):
                files = _Entry(catalogue, model.obj)
                raw = read_obj(catalogue.read(model.obj), files, Limits())
                for material in raw.materials:
                    if material.alpha_mode == BLEND:
                        material.alpha_mode, material.base_color = OPAQUE, (*material.base_color[:3], 1.0)
                yield model, raw


def attribution(models: list[Model]) -> str:
    """Return a line a model: its name, who made it, and the catalogue whose licence it has."""
    rows = [f"{m.name}\t{m.creator}\t{m.catalogue}" for m in models]
    return f"{NOTICE}\nmodel\tcreator\tcatalogue\n" + "\n".join(rows) + "\n"


class _Entry:
    """The files beside an OBJ in its catalogue."""

    def __init__(self, catalogue: zipfile.ZipFile, name: str) -> None:
        self._catalogue, self.name = catalogue, name

    def read(self, relative: str) -> bytes:
        try:
            data = self._catalogue.read(relative)
        except KeyError as error:
            raise SceneFileMissing(relative) from error
        # Some name a texture by its place on the author's disk, which the reader rightly refuses.
        return _AUTHORS_DISK.sub(rb"\1", data) if relative.endswith(".mtl") else data


def _entries(catalogue: zipfile.ZipFile, name: str) -> Iterator[Model]:
    text = catalogue.read("PluginFurnitureCatalog.properties").decode("latin-1")
    found = re.findall(r"^(\w+)#(\d+)\s*=\s*(.*?)\s*$", text, re.MULTILINE)
    rows: dict[int, dict[str, str]] = {}
    for key, number, value in found:
        rows.setdefault(int(number), {})[key] = value
    for number, row in sorted(rows.items()):
        obj = row["model"].lstrip("/")
        size = tuple(float(row[key]) / 100 for key in ("width", "height", "depth"))
        turn = np.array(row.get("modelRotation", "1 0 0 0 1 0 0 0 1").split(), dtype=np.float64).reshape(3, 3)
        yield Model(
            name=f"{name} {number} {Path(obj).stem}", creator=row.get("creator", "unknown"), catalogue=name, obj=obj,
            size_m=(size[0], size[1], size[2]), turn=turn,
        )  # fmt: skip
