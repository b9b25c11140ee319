"""How large an uploaded level may be. An operator raises what a trusted studio needs."""

from dataclasses import dataclass

from farfield.errors import SceneOverLimit

MIB, GIB = 2**20, 2**30


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Counts and sizes that are checked before anything of that size is allocated."""

    bytes: int = 2 * GIB  # the scene file, and all files it reads, together
    unpacked_bytes: int = 4 * GIB  # of a zip, all entries together
    json_bytes: int = 256 * MIB  # the JSON part of a glTF: parsed it takes some ten times as much
    files: int = 10_000  # entries of a zip
    nodes: int = 1_000_000
    node_depth: int = 256
    triangles: int = 50_000_000  # stored ones: an instance adds none
    vertices: int = 150_000_000
    reach_m: float = 1e9  # the farthest coordinate from the origin, metres
    cells: int = 250_000  # of the view space, roughly: a cell takes about 10 ms, and may have a thousand problem views
    image_pixels: int = 8192 * 8192  # of one texture
    texture_pixels: int = 2**30  # of all textures


def need(amount: int, limit: int, what: str) -> None:
    """Raise SceneOverLimit where `amount` is above `limit`; `what` names it, in the plural."""
    if amount > limit:
        raise SceneOverLimit(f"The scene has {amount} {what}; the limit is {limit}.")
