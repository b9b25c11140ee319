"""Decode base-colour and emissive textures into mip pyramids that kernels can sample.

Levels are averages of 2 x 2 texels in linear light (an odd last row or column is averaged with itself), stored as sRGB
bytes again; alpha is averaged as it is. Only the textures of the batch's materials are decoded. Beyond HELD bytes they go
to a file without a name, mapped: then only the levels that are looked at are resident, and impostors look at coarse ones.
"""

import io
import mmap
import tempfile
from collections.abc import Iterator
from typing import IO, NamedTuple

import numpy as np
from PIL import Image

from farfield.bake.shade import DECODE, encode_srgb
from farfield.errors import SceneUnreadable
from farfield.scene.model import Scene

HELD = 256 << 20  # bytes of texels
STRIP = 256  # rows averaged at once: 67 MB of a texture 8192 wide


class Pyramids(NamedTuple):
    """As the fields of the same name in records.Surface."""

    level_row: np.ndarray
    level_size: np.ndarray
    level_byte: np.ndarray
    texel: np.ndarray


def decode(scene: Scene, materials: np.ndarray) -> Pyramids:
    """Return the pyramids of the textures of these materials (ids); the others have no levels.

    Raises SceneUnreadable for an image that does not decode.
    """
    n = len(scene.texture_byte) - 1
    columns = scene.material_texture[materials], scene.material_emissive_texture[materials]
    wanted = set(np.concatenate(columns).tolist()) - {-1}
    row, sizes, starts, at = [0], [], [], 0
    store = _Store()
    for x in range(n):
        if x in wanted:
            for level in _levels(_image(scene, x)):
                sizes.append(level.shape[1::-1])
                starts.append(at)
                store.add(level.reshape(-1))
                at += level.size
        row.append(len(sizes))
    return Pyramids(
        level_row=np.array(row, np.int64), level_size=np.array(sizes, np.int32).reshape(-1, 2),
        level_byte=np.array(starts, np.int64), texel=store.joined(),
    )  # fmt: skip


class _Store:
    """Bytes one after the other: in memory, or in a file where they are many."""

    def __init__(self) -> None:
        self._parts: list[np.ndarray] = []
        self._held = 0
        self._file: IO[bytes] | None = None

    def add(self, part: np.ndarray) -> None:
        self._parts.append(part)
        self._held += part.size
        if self._held > HELD:
            self._file = self._file or tempfile.TemporaryFile(prefix="farfield-textures-")  # noqa: SIM115  closed in `joined`
            for each in self._parts:
                self._file.write(each.tobytes())
            self._parts, self._held = [], HELD

    def joined(self) -> np.ndarray:
        """Return (D,) u1."""
        if self._file is None:
            return np.concatenate(self._parts) if self._parts else np.zeros(0, np.uint8)
        with self._file as file:
            file.flush()
            # copied on write: kernels are compiled for arrays that may be written to
            return np.frombuffer(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY), np.uint8)


def _image(scene: Scene, x: int) -> np.ndarray:
    data = scene.texture_data[scene.texture_byte[x] : scene.texture_byte[x + 1]].tobytes()
    try:
        with Image.open(io.BytesIO(data)) as image:
            return np.asarray(image.convert("RGBA"))
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise SceneUnreadable(f"texture {x} does not decode: {error}") from error


def _levels(image: np.ndarray) -> Iterator[np.ndarray]:
    yield image
    while max(image.shape[:2]) > 1:
        image = _halved(image)
        yield image


def _halved(image: np.ndarray) -> np.ndarray:
    h, w = image.shape[:2]
    out = np.empty(((h + 1) // 2, (w + 1) // 2, 4), np.uint8)
    for y in range(0, h, STRIP):
        strip = image[y : y + STRIP]
        strip = np.pad(strip, ((0, len(strip) % 2), (0, w % 2), (0, 0)), mode="edge")
        linear = np.empty(strip.shape, np.float64)
        linear[..., :3], linear[..., 3] = DECODE[strip[..., :3]], strip[..., 3]
        linear = (linear[0::2] + linear[1::2]) / 2
        linear = (linear[:, 0::2] + linear[:, 1::2]) / 2
        part = out[y // 2 : y // 2 + len(linear)]
        part[..., :3], part[..., 3] = encode_srgb(linear[..., :3]), np.floor(linear[..., 3] + 0.5)
    return out
