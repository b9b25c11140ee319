"""MTL files -> RawMaterial, RawTexture: colour (taken as sRGB), opacity, emission and the base-colour texture."""

import math
import posixpath

from farfield.errors import SceneFileMissing
from farfield.scene.files import SceneFiles, relative_name
from farfield.scene.images import ImageBroken, ImageBudget
from farfield.scene.limits import Limits
from farfield.scene.model import BLEND, MASK
from farfield.scene.raw import CLAMP, REPEAT, RawMaterial, RawScene, RawTexture, linear_from_srgb

# How many words an option of a map statement takes; -o, -s and -t take up to three numbers.
_OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1, "-mm": 2, "-texres": 1,
    "-type": 1, "-o": 3, "-s": 3, "-t": 3,
}  # fmt: skip

Transform = tuple[tuple[float, float], tuple[float, float]]  # scale and offset of u and v
Statements = dict[str, str]


class MtlReader:
    """Reads MTL files of one scene; materials enter it when they are first used."""

    def __init__(self, files: SceneFiles, scene: RawScene, limits: Limits) -> None:
        self._files, self._scene = files, scene
        self._budget = ImageBudget(limits)
        self._statements: dict[str, tuple[Statements, str]] = {}  # by material name, with the MTL's folder
        self._images: dict[str, bytes | None] = {}
        self._textures: dict[tuple[str, int], int] = {}
        self._read_files: set[str] = set()
        self.materials: dict[str, tuple[int, Transform | None]] = {}  # by name: material, how its texture is addressed

    def read(self, name: str) -> None:
        """Note the materials of one file. Raises SceneFileMissing, SceneUriRefused, SceneOverLimit."""
        if name in self._read_files:
            return
        text = self._files.read(name).decode("utf-8", "replace")
        self._read_files.add(name)
        current: Statements = {}
        for line in text.splitlines():
            fields = line.split(None, 1)
            if not fields or fields[0].startswith("#"):
                continue
            key, rest = fields[0].lower(), fields[1].strip() if len(fields) > 1 else ""
            if key == "newmtl":
                current = {}
                self._statements.setdefault(rest, (current, posixpath.dirname(name)))
            else:
                current[key] = rest

    def use(self, name: str) -> None:
        """Bring a material into the scene; one that no file defines stays the default one, with a warning."""
        if name in self.materials or name == "":
            return
        if name not in self._statements:
            self._warn(f"The material {name[:120]!r} is not defined; it is plain white.")
            self._scene.materials.append(RawMaterial(name=name, double_sided=True))
            self.materials[name] = (len(self._scene.materials) - 1, None)
            return
        rows, folder = self._statements[name]
        texture, transform = self._texture(rows.get("map_kd", ""), folder)
        color = _numbers(rows.get("kd", ""), 3) or [1.0, 1.0, 1.0]
        if texture >= 0 and color == [0.0, 0.0, 0.0]:
            color = [1.0, 1.0, 1.0]  # exporters write black where only the texture counts
        opacity = (_numbers(rows.get("d", "").replace("-halo", ""), 1) or [math.nan])[0]
        if not math.isfinite(opacity):
            opacity = 1.0 - (_numbers(rows.get("tr", ""), 1) or [0.0])[0]
        mode = BLEND if opacity < 1.0 else 0
        if mode != BLEND and rows.get("map_d"):
            if rows["map_d"].split()[-1:] == rows.get("map_kd", "").split()[-1:] and texture >= 0:
                mode = MASK
            else:
                self._warn(f"The opacity texture of material {name[:120]!r} is left out.")
        emissive = tuple(linear_from_srgb(_numbers(rows.get("ke", ""), 3) or [0.0, 0.0, 0.0]).tolist())
        glow, way = self._texture(rows.get("map_ke", ""), folder)
        if glow >= 0 and texture >= 0 and way != transform:
            self._warn(
                f"The emissive texture of material {name[:120]!r} is scaled otherwise than its colour; left out."
            )
            glow, emissive = -1, (0.0, 0.0, 0.0)
        elif glow >= 0:
            transform = way
            emissive = emissive if any(emissive) else (1.0, 1.0, 1.0)  # exporters write the texture alone
        self._scene.materials.append(
            RawMaterial(
                name=name, base_color=(*linear_from_srgb(color).tolist(), min(max(opacity, 0.0), 1.0)), alpha_mode=mode,
                emissive=emissive, double_sided=True, texture=texture, emissive_texture=glow,
            )
        )  # fmt: skip
        self.materials[name] = (len(self._scene.materials) - 1, transform)

    def _texture(self, statement: str, folder: str) -> tuple[int, Transform | None]:
        name, scale, offset, wrap = _map_statement(statement)
        if not name:
            return -1, None
        path = relative_name(name, base=folder)
        if path not in self._images:
            self._images[path] = self._image(path)
        data = self._images[path]
        if data is None:
            return -1, None
        if (path, wrap) not in self._textures:
            self._textures[path, wrap] = len(self._scene.textures)
            self._scene.textures.append(RawTexture(data=data, wrap=(wrap, wrap)))
        transform = (scale, offset) if (scale, offset) != ((1.0, 1.0), (0.0, 0.0)) else None
        return self._textures[path, wrap], transform

    def _image(self, path: str) -> bytes | None:
        try:
            return self._budget.checked_image(self._files.read(path), path)
        except SceneFileMissing:
            self._warn(f"The texture {path!r} is missing: its materials keep their colour.")
        except ImageBroken as error:
            self._warn(f"{str(error).rstrip('.')}: its materials keep their colour.")
        return None

    def _warn(self, text: str) -> None:
        self._scene.warn(text)


def _numbers(text: str, n: int) -> list[float] | None:
    """Return the first n numbers; one stands for all; None where they are none."""
    try:
        values = [float(t) for t in text.split()[:n]]
    except ValueError:
        return None
    if len(values) == 1:
        values *= n
    return values if len(values) == n and all(map(math.isfinite, values)) else None


def _map_statement(statement: str) -> tuple[str, tuple[float, float], tuple[float, float], int]:
    """Return (file name, scale, offset, wrap mode) of `map_Kd [options] name with spaces.png`."""
    words = statement.split()
    scale, offset, wrap = (1.0, 1.0), (0.0, 0.0), REPEAT
    while words and words[0].lower() in _OPTIONS:
        option, n = words[0].lower(), _OPTIONS[words[0].lower()]
        given = words[1 : 1 + n]
        if n == 3:
            while given and _numbers(given[-1], 1) is None:
                given.pop()
            values = [float(g) for g in given] if all(_numbers(g, 1) for g in given) else []
            if option == "-s" and values:
                scale = (values[0], values[1] if len(values) > 1 else 1.0)
            elif option == "-o" and values:
                offset = (values[0], values[1] if len(values) > 1 else 0.0)
        elif option == "-clamp" and given == ["on"]:
            wrap = CLAMP
        words = words[1 + len(given) :]
    return " ".join(words), scale, offset, wrap
