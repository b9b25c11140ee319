"""A small picture of a level from straight above: x to the right, z down, the highest surface at each pixel.

For a page that asks "is this the level that I meant?" before a job is paid for: no more. A triangle has one colour: its
material's, times that of its texture in its middle; alpha is not looked at. Drawn at twice its size and averaged.
Work is bounded: a level that would need more than MOST_LOOKED pixel tests has no picture, however it is built.
"""

import io
import math

import numpy as np
from PIL import Image

from farfield.scene.model import Scene
from farfield.scene.picture_kernels import draw_from_above
from farfield.scene.raw import linear_from_srgb

SIDE_PX = 512  # of the longer side
OVERSAMPLED = 2
MOST_LOOKED = 1 << 31  # some seconds of one core
TEXTURE_PX, MOST_TEXTURE_PIXELS = 64, 1 << 26  # a texture's side here; what is decoded of all of them
_BACKGROUND = np.array([0.93, 0.93, 0.93])


def picture_from_above(scene: Scene) -> bytes | None:
    """Return the picture as PNG (sRGB, RGB, SIDE_PX along the longer side), None where it would take too long."""
    low, high = scene.object_box[:, 0].min(0), scene.object_box[:, 1].max(0)
    extent = float(max(high[0] - low[0], high[2] - low[2]))
    scale = SIDE_PX * OVERSAMPLED / extent if extent > 0 else 1.0
    if not math.isfinite(scale):
        return None
    sides = [max(1, math.ceil(float(high[axis] - low[axis]) * scale / OVERSAMPLED)) * OVERSAMPLED for axis in (2, 0)]
    height = np.full(sides, -np.inf)
    image = np.broadcast_to(_BACKGROUND, (*sides, 3)).copy()
    colors = triangle_colors(scene)
    left = MOST_LOOKED
    for o in range(scene.n_objects):
        first, last = scene.mesh_primitive[scene.object_mesh[o]], scene.mesh_primitive[scene.object_mesh[o] + 1]
        triangles = scene.primitive_triangle[[first, last]]
        looked = draw_from_above(
            scene.position, scene.index, triangles, scene.object_matrix[o], colors, low[0], low[2], scale, height, image,
            left,
        )  # fmt: skip
        if looked < 0:
            return None
        left -= looked
    small = image.reshape(sides[0] // OVERSAMPLED, OVERSAMPLED, sides[1] // OVERSAMPLED, OVERSAMPLED, 3).mean((1, 3))
    out = io.BytesIO()
    Image.fromarray(srgb_bytes(small)).save(out, "PNG", optimize=True)
    return out.getvalue()


def triangle_colors(scene: Scene) -> np.ndarray:
    """(T,3) f32 linear: base colour, the texture in the triangle's middle, the mean of the corners' colours, multiplied."""
    of_triangle = np.repeat(scene.primitive_material, np.diff(scene.primitive_triangle))
    color, uv = _middles(scene, scene.color[:, :3]), _middles(scene, scene.uv)
    colors = np.asarray(scene.material_base_color[:, :3][of_triangle] * color, dtype=np.float32)
    texture, left = scene.material_texture[of_triangle], MOST_TEXTURE_PIXELS
    for x in range(len(scene.texture_byte) - 1):
        data = scene.texture_data[scene.texture_byte[x] : scene.texture_byte[x + 1]]
        with Image.open(io.BytesIO(data.tobytes())) as opened:
            if opened.width * opened.height > left:
                continue
            left -= opened.width * opened.height
            sides = min(opened.width, TEXTURE_PX), min(opened.height, TEXTURE_PX)
            small = linear_from_srgb(np.asarray(opened.convert("RGB").resize(sides, Image.Resampling.BOX)) / 255.0)
        here = np.flatnonzero(texture == x)
        with np.errstate(invalid="ignore"):  # of coordinates that are beyond all measure
            u, v = ((uv[here, k] % 1.0 * n).astype(np.int64).clip(0, n - 1) for k, n in enumerate(sides))
        colors[here] *= small[v, u].astype(np.float32)
    return colors


def _middles(scene: Scene, column: np.ndarray) -> np.ndarray:
    """(V,n) -> (T,n) f64: the mean over each triangle's corners."""
    total = np.zeros((len(scene.index), column.shape[1]))
    for k in range(3):
        total += column.take(scene.index[:, k], axis=0)
    return np.asarray(total / 3.0)


def srgb_bytes(linear: np.ndarray) -> np.ndarray:
    value = np.clip(linear, 0.0, 1.0)
    curved = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.rint(255.0 * curved).astype(np.uint8)
