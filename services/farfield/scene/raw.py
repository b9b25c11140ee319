"""What every format's reader returns: a level as its file says it, before it is put on the grid."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from farfield.scene.model import OPAQUE

REPEAT, MIRROR, CLAMP = 10497, 33648, 33071
MOST_WARNINGS, MOST_TEXT = 200, 1000


@dataclass(slots=True)
class RawPrimitive:
    """Triangles of one material, one draw call."""

    position: np.ndarray  # (V,3) f32 or f64, units and axes of the file, finite
    index: np.ndarray  # (T,3) int64 in [0, V)
    material: int  # -1: the format's default
    normal: np.ndarray | None = None  # (V,3) f32, any length
    uv: np.ndarray | None = None  # (V,2) f32, texture transform applied, origin top left
    color: np.ndarray | None = None  # (V,4) f32, linear
    emissive_uv: np.ndarray | None = None  # (V,2) f32; None: as uv
    look: int = 0  # bits of farfield.scene.model.LOOKS


@dataclass(slots=True)
class RawNode:
    """A placed mesh."""

    name: str
    mesh: int
    matrix: np.ndarray  # (4,4) f64, finite, affine
    look: int = 0  # bits of farfield.scene.model.LOOKS

    def __post_init__(self) -> None:
        self.name = plain_text(self.name)


@dataclass(slots=True, kw_only=True)
class RawMaterial:
    name: str = ""
    base_color: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)  # linear
    emissive: tuple[float, ...] = (0.0, 0.0, 0.0)  # linear
    alpha_mode: int = OPAQUE
    alpha_cutoff: float = 0.5
    double_sided: bool = False
    texture: int = -1
    emissive_texture: int = -1
    unlit: bool = False
    look: int = 0  # bits of farfield.scene.model.LOOKS

    def __post_init__(self) -> None:
        self.name = plain_text(self.name)


@dataclass(frozen=True, slots=True, kw_only=True)
class RawTexture:
    data: bytes  # PNG, JPEG or WebP, checked to decode
    wrap: tuple[int, int] = (REPEAT, REPEAT)
    linear: bool = True  # magnified
    smooth: bool = True  # minified


@dataclass(slots=True)
class RawScene:
    meshes: list[list[RawPrimitive]] = field(default_factory=list)
    nodes: list[RawNode] = field(default_factory=list)
    materials: list[RawMaterial] = field(default_factory=list)
    textures: list[RawTexture] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    dropped_triangles: int = 0
    notice: str = ""  # copyright and attribution, to be shown with pictures
    _told: set[str] = field(default_factory=set)
    default_double_sided: bool = False  # of primitives without a material

    def warn(self, text: str) -> None:
        """Say something once; of many things, how many there are."""
        text = plain_text(text)
        if text in self._told:
            return
        self._told.add(text)
        if len(self._told) > MOST_WARNINGS:
            self.warnings[MOST_WARNINGS:] = [f"There are {len(self._told) - MOST_WARNINGS} more warnings."]
        else:
            self.warnings.append(text)


def plain_text(text: str) -> str:
    """Return a text of the file as what any file, database and page can hold: no half characters, no control codes."""
    whole = text[:MOST_TEXT].encode("utf-8", "replace").decode()
    return whole if whole.isprintable() else "".join(c if c.isprintable() else "\ufffd" for c in whole)


def linear_from_srgb(value: npt.ArrayLike) -> np.ndarray:
    """Return linear light of sRGB-encoded values in [0, 1] (IEC 61966-2-1), float64."""
    v = np.clip(np.asarray(value, dtype=np.float64), 0.0, 1.0)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
