"""Draw atlas pages: blocks, mip levels by the maximum of alpha and the mean of covered colour; WebP, PNG or KTX2.

Method   Sums of linear light and counts of covered texels go down from level 0, so every level is exact from level 0
         and not from rounded bytes: integers, hence the same on every machine. Blocks lie at multiples of 8 texels, so
         a texel of the coarsest level lies over one block only and a page can be reduced as a whole. The bake bleeds
         colour two texels out at level 0; coarser levels bleed their own by one, or filtering would pull in black.
Tried    WebP lossless, seconds and KiB of one page of baked houses, two cores shared with others, by (method, quality):
         (0, 0) 0.15 503, (0, 25) 0.16 493, (0, 75) 0.38 472, (1, 50) 0.9 410, (2, 50) 1.6 396, (4, 75) 1.9 396.
         A city is tens of pages, so the smaller file is worth it up to (1, 50). The same pages as PNG: 340 KiB, 0.1 s.
"""

import io
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from PIL import Image

from farfield.placementdb import ktx2
from farfield.placementdb.layout import LEVELS, PAGE_HEIGHT, PAGE_TEXELS, PAGE_WIDTH

METHOD, QUALITY = 1, 50  # effort of the encoder: 0..6, 0..100


class NotAPage(Exception):
    """A page's file is not what its format says."""


# A block of texels at its place: (x, y, (h, w, 4) u1)
Block = tuple[int, int, np.ndarray]


def _linear16(encoded: np.ndarray) -> np.ndarray:
    """Return linear light in 0..65535 of sRGB values in 0..255 (IEC 61966-2-1)."""
    c = encoded / 255.0
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return np.rint(65535 * linear)


_TO_LINEAR = _linear16(np.arange(256.0)).astype(np.uint32)
_BYTE_STARTS = _linear16(np.arange(255.0) + 0.5).astype(np.uint32)  # linear light from which byte k + 1 is nearest


def page_image(blocks: Sequence[Block]) -> np.ndarray:
    """Return the (1536, 1024, 4) u1 image of a page with all its levels; 0 outside the blocks."""
    image = np.zeros((PAGE_HEIGHT, PAGE_WIDTH, 4), dtype=np.uint8)
    owner = np.zeros((PAGE_TEXELS, PAGE_TEXELS), dtype=np.int32)  # block + 1
    for k, (x, y, texels) in enumerate(blocks):
        height, width = texels.shape[:2]
        assert not owner[y : y + height, x : x + width].any()
        image[y : y + height, x : x + width] = texels
        owner[y : y + height, x : x + width] = k + 1
    top = image[:PAGE_TEXELS]
    alpha = top[:, :, 3]
    count = (alpha > 0).astype(np.uint32)
    total = _TO_LINEAR[top[:, :, :3]] * count[:, :, None]
    for x, y, size in LEVELS[1:]:
        alpha, owner = (np.maximum(*_halves(np.maximum(*_halves(a, 0)), 1)) for a in (alpha, owner))
        count, total = _quartered(count), _quartered(total)
        mean = _mean(total, count)
        bled = _bled(mean, count > 0, owner)
        image[y : y + size, x : x + size, :3] = np.searchsorted(_BYTE_STARTS, bled, side="right")
        image[y : y + size, x : x + size, 3] = alpha
    return image


def _mean(total: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return total / count, rounded half up; 0 where the count is."""
    some = np.maximum(count, 1)[:, :, None]
    return (total + some // 2) // some


def _bled(colour: np.ndarray, covered: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Return the colours with each uncovered texel the mean of the covered ones of its block around it, if any."""
    height, width = covered.shape
    total, count = np.zeros_like(colour), np.zeros(covered.shape, dtype=np.uint32)
    for dy, dx in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
        here = np.s_[max(0, -dy) : height - max(0, dy), max(0, -dx) : width - max(0, dx)]
        there = np.s_[max(0, dy) : height - max(0, -dy), max(0, dx) : width - max(0, -dx)]
        use = covered[there] & (owner[there] == owner[here])
        count[here] += use
        total[here] += np.where(use[:, :, None], colour[there], 0)
    return np.where(covered[:, :, None], colour, _mean(total, count))


def _halves(a: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    return (a[0::2], a[1::2]) if axis == 0 else (a[:, 0::2], a[:, 1::2])


def _quartered(a: np.ndarray) -> np.ndarray:
    low, high = _halves(a, 0)
    low, high = _halves(low + high, 1)
    return low + high


def encode(image: np.ndarray, page_format: str = "webp") -> bytes:
    """Return the image as a lossless file ("webp", "png", "ktx2") that keeps colour under alpha 0."""
    out = io.BytesIO()
    if page_format == "ktx2":
        return ktx2.encode([image[y : y + size, x : x + size] for x, y, size in LEVELS])
    if page_format == "png":
        Image.fromarray(image, "RGBA").save(out, "PNG", compress_level=6)
    else:
        Image.fromarray(image, "RGBA").save(out, "WEBP", lossless=True, exact=True, method=METHOD, quality=QUALITY)
    return out.getvalue()


def decode(data: bytes, page_format: str) -> np.ndarray:
    """Return the (1536, 1024, 4) u1 image of a page's file. Raises NotAPage, whose message completes "it is"."""
    if page_format == "ktx2":
        image = np.zeros((PAGE_HEIGHT, PAGE_WIDTH, 4), dtype=np.uint8)
        try:
            levels = ktx2.decode(data, [size for _, _, size in LEVELS])
        except ktx2.NotKtx2 as error:
            raise NotAPage(str(error)) from error
        for (x, y, size), level in zip(LEVELS, levels, strict=True):
            image[y : y + size, x : x + size] = level
        return image
    try:
        picture = Image.open(io.BytesIO(data), formats=[page_format.upper()])
        if picture.size == (PAGE_WIDTH, PAGE_HEIGHT):
            return np.asarray(picture.convert("RGBA"))
    except OSError as error:
        raise NotAPage(f"no {page_format.upper()} image") from error
    raise NotAPage(f"an image of {picture.size[0]} x {picture.size[1]} texels")


def build_pages(pages: Sequence[Sequence[Block]], *, page_format: str = "webp", threads: int = 1) -> list[bytes]:
    """Return the file of each page; the number of threads does not show in the bytes."""
    with ThreadPoolExecutor(max_workers=max(1, threads)) as pool:
        return list(pool.map(lambda blocks: encode(page_image(blocks), page_format), pages))
