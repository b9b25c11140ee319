"""Materials and textures of a glTF -> RawMaterial, RawTexture; only those that a drawn primitive uses."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from farfield.errors import SceneFileMissing
from farfield.scene.accessors import Json
from farfield.scene.images import ImageBroken, ImageBudget
from farfield.scene.limits import Limits
from farfield.scene.model import BLEND, MASK, OPAQUE, SHINY, TRANSMISSIVE
from farfield.scene.raw import CLAMP, MIRROR, REPEAT, RawMaterial, RawScene, RawTexture

Transform = tuple[list[list[float]], list[float]]  # uv' = linear uv + offset
TexCoord = tuple[int, Transform | None]  # the TEXCOORD set that the base colour reads, -1 none
NONE: TexCoord = (-1, None)


class Materials:
    """Reads materials into `scene` when they are first used."""

    def __init__(
        self,
        document: dict[str, Any],
        image_source: Callable[[dict[str, Any], str], bytes],
        scene: RawScene,
        limits: Limits,
    ) -> None:
        self._document = document
        self._image_source = image_source
        self._scene = scene
        self._budget = ImageBudget(limits)
        self._known: dict[int, tuple[int, TexCoord, TexCoord]] = {}
        self._images: dict[int, bytes | None] = {}
        self._textures: dict[tuple[int, tuple[int, int], bool, bool], int] = {}

    def index(self, value: Any, where: str) -> tuple[int, TexCoord, TexCoord]:
        """Return (material in the RawScene or -1, how its base colour and its emissive texture are addressed)."""
        if value is None:
            return -1, NONE, NONE
        key = Json.integer(value, f"{where}.material")
        if key not in self._known:
            row = Json.pick(Json.rows(self._document.get("materials"), "materials"), key, f"{where}.material")
            self._known[key] = self._read(row, f"materials[{key}]")
        return self._known[key]

    def _read(self, row: dict[str, Any], where: str) -> tuple[int, TexCoord, TexCoord]:
        extensions = Json.table(row.get("extensions"), f"{where}.extensions")
        glossy = extensions.get("KHR_materials_pbrSpecularGlossiness")
        if "pbrMetallicRoughness" not in row and glossy is not None:
            pbr, color_key, texture_key = Json.table(glossy, where), "diffuseFactor", "diffuseTexture"
        else:
            pbr = Json.table(row.get("pbrMetallicRoughness"), f"{where}.pbrMetallicRoughness")
            color_key, texture_key = "baseColorFactor", "baseColorTexture"
        color = _finite(Json.numbers(pbr.get(color_key, [1, 1, 1, 1]), 4, f"{where}.{color_key}"), 1.0)
        texture, tex_coord = self._texture(pbr.get(texture_key), f"{where}.{texture_key}")
        mode = {"MASK": MASK, "BLEND": BLEND}.get(str(row.get("alphaMode")), OPAQUE)
        unlit = "KHR_materials_unlit" in extensions  # its extension leaves nothing of light, its own or another's
        emissive = (0.0, 0.0, 0.0) if unlit else self._emissive(row, extensions, where)
        glow, glow_coord = -1, NONE
        if any(emissive):
            glow, glow_coord = self._texture(row.get("emissiveTexture"), f"{where}.emissiveTexture")
            if row.get("emissiveTexture") is not None and glow < 0:
                emissive = (0.0, 0.0, 0.0)  # an image that cannot be read must not glow all over
        look = 0 if unlit else _look(row, pbr, extensions, where)
        if look & TRANSMISSIVE:
            mode = BLEND  # glass: what lies behind it must be seen
        material = RawMaterial(
            name=row["name"] if isinstance(row.get("name"), str) else where,
            base_color=tuple(min(max(c, 0.0), 1.0) for c in color),
            emissive=emissive,
            alpha_mode=mode,
            alpha_cutoff=_finite([Json.number(row.get("alphaCutoff", 0.5), f"{where}.alphaCutoff")], 0.5)[0],
            double_sided=row.get("doubleSided") is True,
            texture=texture,
            emissive_texture=glow,
            unlit=unlit,
            look=look,
        )
        self._scene.materials.append(material)
        return len(self._scene.materials) - 1, tex_coord, glow_coord

    def _emissive(self, row: dict[str, Any], extensions: dict[str, Any], where: str) -> tuple[float, ...]:
        factor = _finite(Json.numbers(row.get("emissiveFactor", [0, 0, 0]), 3, f"{where}.emissiveFactor"), 0.0)
        strength = Json.table(extensions.get("KHR_materials_emissive_strength"), where).get("emissiveStrength", 1.0)
        scale = _finite([Json.number(strength, f"{where}: emissiveStrength")], 1.0)[0]
        return tuple(min(max(f * scale, 0.0), 1e6) for f in factor)

    def _texture(self, value: Any, where: str) -> tuple[int, TexCoord]:
        if value is None:
            return -1, NONE
        info = Json.table(value, where)
        row = Json.pick(Json.rows(self._document.get("textures"), "textures"), info.get("index"), f"{where}.index")
        extensions = Json.table(row.get("extensions"), f"{where}.extensions")
        source = Json.table(extensions.get("EXT_texture_webp"), where).get("source", row.get("source"))
        if source is None:
            self._warn(f"{where} has no image that can be read; the material keeps its colour.")
            return -1, NONE
        key = Json.integer(source, f"{where}: source")
        if key not in self._images:
            self._images[key] = self._image(key, where)
        data = self._images[key]
        if data is None:
            return -1, NONE
        sampler: dict[str, Any] = {}
        if row.get("sampler") is not None:
            sampler = Json.pick(
                Json.rows(self._document.get("samplers"), "samplers"), row["sampler"], f"{where}: sampler"
            )
        wrap_s, wrap_t = (
            w if (w := sampler.get(k, REPEAT)) in (REPEAT, MIRROR, CLAMP) else REPEAT for k in ("wrapS", "wrapT")
        )
        linear = sampler.get("magFilter") != 9728
        smooth = sampler.get("minFilter") not in (9728, 9984, 9986)  # all others mix texels
        identity = (key, (int(wrap_s), int(wrap_t)), linear, smooth)
        if identity not in self._textures:
            self._textures[identity] = len(self._scene.textures)
            self._scene.textures.append(RawTexture(data=data, wrap=identity[1], linear=linear, smooth=smooth))
        return self._textures[identity], _addressing(info, where)

    def _image(self, index: int, where: str) -> bytes | None:
        row = Json.pick(Json.rows(self._document.get("images"), "images"), index, f"{where}: source")
        try:
            return self._budget.checked_image(self._image_source(row, f"images[{index}]"), f"images[{index}]")
        except (SceneFileMissing, ImageBroken) as error:
            self._warn(f"{str(error).rstrip('.')}: its materials keep their colour.")
            return None

    def _warn(self, text: str) -> None:
        self._scene.warn(text)


_SHINE = ("clearcoat", "iridescence", "anisotropy", "sheen", "specular", "dispersion")
_GLASS = ("transmission", "volume", "diffuse_transmission")
_METAL = 0.5  # from this metallic factor on a surface shows its surroundings more than itself


def _look(row: dict[str, Any], pbr: dict[str, Any], extensions: dict[str, Any], where: str) -> int:
    """Return what of a material no picture can hold. A metallic factor that is left out is 1, as glTF has it;
    a material that states no factors at all is taken for a plain one."""
    shiny = any(f"KHR_materials_{name}" in extensions for name in _SHINE)
    if "pbrMetallicRoughness" in row:
        shiny = shiny or Json.number(pbr.get("metallicFactor", 1.0), f"{where}.metallicFactor") >= _METAL
    glass = any(f"KHR_materials_{name}" in extensions for name in _GLASS)
    return (SHINY if shiny else 0) | (TRANSMISSIVE if glass else 0)


def _finite(values: list[float], default: float) -> list[float]:
    return [v if math.isfinite(v) else default for v in values]


def _addressing(info: dict[str, Any], where: str) -> TexCoord:
    """KHR_texture_transform: uv' = T R S uv, with R turning counter-clockwise for the origin at the top left."""
    tex_coord = Json.count(info.get("texCoord", 0), f"{where}.texCoord")
    found = Json.table(info.get("extensions"), f"{where}.extensions").get("KHR_texture_transform")
    if found is None:
        return tex_coord, None
    row = Json.table(found, f"{where}: KHR_texture_transform")
    tex_coord = Json.count(row.get("texCoord", tex_coord), f"{where}: KHR_texture_transform.texCoord")
    offset = _finite(Json.numbers(row.get("offset", [0, 0]), 2, f"{where}: offset"), 0.0)
    scale = _finite(Json.numbers(row.get("scale", [1, 1]), 2, f"{where}: scale"), 1.0)
    angle = _finite([Json.number(row.get("rotation", 0), f"{where}: rotation")], 0.0)[0]
    c, s = float(np.cos(angle)), float(np.sin(angle))
    return tex_coord, ([[c * scale[0], s * scale[1]], [-s * scale[0], c * scale[1]]], offset)
