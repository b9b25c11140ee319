"""Decode base-colour and emissive textures into mip pyramids that kernels can sample.

Levels are averages of 2 x 2 texels in linear light (an odd last row or column is averaged with itself), stored as sRGB
bytes again; alpha is averaged as it is. Only the textures of the batch's materials are decoded.
"""

import io
from typing import NamedTuple

import numpy as np
from PIL import Image

from farfield.bake.shade import DECODE, encode_srgb
from farfield.errors import SceneUnreadable
from farfield.scene.model import Scene


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
    row, sizes, starts, parts, at = [0], [], [], [], 0
    for x in range(n):
        if x in wanted:
            for level in _levels(_image(scene, x)):
                sizes.append(level.shape[1::-1])
                starts.append(at)
                parts.append(level.reshape(-1))
                at += level.size
        row.append(len(sizes))
    return Pyramids(
        level_row=np.array(row, np.int64), level_size=np.array(sizes, np.int32).reshape(-1, 2),
        level_byte=np.array(starts, np.int64), texel=np.concatenate(parts) if parts else np.zeros(0, np.uint8),
    )  # fmt: skip


def _image(scene: Scene, x: int) -> np.ndarray:
    data = scene.texture_data[scene.texture_byte[x] : scene.texture_byte[x + 1]].tobytes()
    try:
        with Image.open(io.BytesIO(data)) as image:
            return np.asarray(image.convert("RGBA"))
    except (OSError, ValueError, Image.DecompressionBombError) as error:
        raise SceneUnreadable(f"texture {x} does not decode: {error}") from error


def _levels(image: np.ndarray) -> list[np.ndarray]:
    levels = [image]
    while max(image.shape[:2]) > 1:
        h, w = image.shape[:2]
        if h % 2 and h > 1:
            image = np.concatenate([image, image[-1:]])
        if w % 2 and w > 1:
            image = np.concatenate([image, image[:, -1:]], axis=1)
        linear = np.empty(image.shape, np.float64)
        linear[..., :3], linear[..., 3] = DECODE[image[..., :3]], image[..., 3]
        if h > 1:
            linear = (linear[0::2] + linear[1::2]) / 2
        if w > 1:
            linear = (linear[:, 0::2] + linear[:, 1::2]) / 2
        image = np.empty(linear.shape, np.uint8)
        image[..., :3], image[..., 3] = encode_srgb(linear[..., :3]), np.floor(linear[..., 3] + 0.5)
        levels.append(image)
    return levels
