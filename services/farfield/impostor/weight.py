"""What an impostor weighs, in bytes: additive, so that placement can bound it, and shared by estimates and the bake.

bytes = 4 a texel of its cropped layers + an overhead for the impostor + an overhead a layer. The overheads stand for
what the placement database stores beside the texels: an impostor's frame, cluster, view cell and lists; a layer's
plane, slab, page, and 8 corners with their texture coordinates.
"""

TEXEL_BYTES = 4  # RGBA8; lossless files are smaller, mip levels in video memory a third larger
IMPOSTOR_BYTES = 192
LAYER_BYTES = 160

MAX_LAYERS = 64  # of one impostor
MAX_SIDE = 4096  # texels of an impostor's grid, along x or y
MAX_LAYER_TRIANGLES = 6  # a cropped layer is a convex polygon of at most 8 corners
PAGE_TEXELS = 1024  # side of a page of the placement database; a larger tile is cut, which adds triangles


def impostor_bytes(texels: int, layers: int) -> int:
    """Return the bytes of an impostor with that many texels in all its cropped layers together."""
    return TEXEL_BYTES * texels + IMPOSTOR_BYTES + LAYER_BYTES * layers
