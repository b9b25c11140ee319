"""Texture images: their size from the header before anything is decoded, and whether they decode.

PNG, JPEG and WebP stay as they are; GIF, BMP and TGA (from OBJ files) are stored again as PNG.
"""

import io
import warnings

from PIL import Image, UnidentifiedImageError

from farfield.errors import SceneOverLimit
from farfield.scene.limits import Limits, need

_KEPT = {"PNG", "JPEG", "WEBP"}
_FORMATS = ("PNG", "JPEG", "WEBP", "GIF", "BMP", "TGA")


class ImageBroken(Exception):
    """The image does not decode; readers turn this into a warning and keep the material's colour."""


def mime_type(data: bytes) -> str:
    """Return the media type of an image that `checked_image` returned."""
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        return "image/png"
    if data[:2] == b"\xff\xd8":
        return "image/jpeg"
    assert data[:4] == b"RIFF" and data[8:12] == b"WEBP"
    return "image/webp"


class ImageBudget:
    """Checks images of one scene against its limits."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._pixels = 0

    def checked_image(self, data: bytes, where: str) -> bytes:
        """Return the image as PNG, JPEG or WebP. Raises SceneOverLimit, and ImageBroken where it does not decode."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)
                image = Image.open(io.BytesIO(data), formats=_FORMATS)
                pixels = image.width * image.height
                need(pixels, self._limits.image_pixels, f"pixels in the texture {where}")
                self._pixels += pixels
                need(self._pixels, self._limits.texture_pixels, "texture pixels")
                image.load()
                if image.format in _KEPT:
                    return data
                out = io.BytesIO()
                image.convert("RGBA").save(out, "PNG", compress_level=6)
                return out.getvalue()
        except Image.DecompressionBombError as error:
            raise SceneOverLimit(f"The texture {where} has too many pixels: {error}") from error
        except UnidentifiedImageError as error:
            raise ImageBroken(f"{where} is not a PNG, JPEG or WebP image.") from error
        except (OSError, SyntaxError, ValueError, EOFError, IndexError, OverflowError) as error:
            raise ImageBroken(f"{where} does not decode: {error}.") from error
