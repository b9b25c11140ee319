"""Large scenes to measure on, built once from packages and kept under `.cache/benchmarks`; each skips where it cannot be.

vienna   the demo city with the furniture of `furniture.py` along its streets: about 5,500 objects and 10 M triangles,
         textured, the size of the model of Vienna in Jeschke et al., I3D 2005
munich   blocks of the Munich scene of the `sionna-rt` wheel side by side: the same town one, two ... ten times
"""

import hashlib
import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks import furniture
from cutout import ROOT, demo_city
from farfield.scene.derive import sample_ground
from farfield.scene.files import Folder
from farfield.scene.images import mime_type
from farfield.scene.level import build_level
from farfield.scene.limits import Limits
from farfield.scene.model import MASK
from farfield.scene.raw import RawMaterial, RawNode, RawPrimitive, RawScene
from farfield.scene.soup import read_ply
from scipy.ndimage import distance_transform_edt

CACHE = ROOT / ".cache" / "benchmarks"
CELL_M = 23.0
PAVEMENT_M = (0.5, 8.0)  # from the walls, where furniture stands


def settings_text(boxes: list[list[list[float]]], *, budget: str, mode: str = "off", seed: int = 0) -> str:
    """Return settings (TOML) as in the paper: 512 x 512, 45 degrees, 1 pixel, 23 m cells, 11.25 degrees."""
    rows = ",\n".join(f"  {json.dumps(box)}" for box in boxes)
    return (
        f'budget = "{budget}"\nseed = {seed}\n\n[camera]\nfov_deg = 45.0\nwidth = 512\nheight = 512\n\n'
        f'[visibility]\nmode = "{mode}"\n\n[view_space]\ncell_m = {CELL_M}\nboxes = [\n{rows},\n]\n'
    )


def vienna() -> tuple[Path, list[list[list[float]]]]:
    """Return the GLB and its street-level view space, as the demo's. Skips where a package is missing."""
    demo = demo_city()
    try:
        demo.folder()
        models = furniture.folder(CACHE)
    except (demo.WheelMissing, furniture.PackageMissing) as error:
        pytest.skip(str(error))
    city, materials = demo.read_city()
    boxes = demo.street_boxes(city)
    path = CACHE / f"vienna-{_digest(__file__, furniture.__file__, demo.__file__)}.glb"
    if not path.exists():
        raw = _painted(city, materials, demo)
        spots = _pavements(city, boxes)
        placed = _furnish(raw, models, spots)
        raw.notice = f"{demo.COPYRIGHT}; {furniture.NOTICE}"
        path.with_suffix(".txt").write_text(furniture.attribution(placed), encoding="utf-8")
        write_raw(path, raw)
    return path, boxes


def munich(columns: int, rows: int, *, side: int = 18) -> tuple[Path, list[list[list[float]]]]:
    """Return the GLB of columns x rows towns, and their view space: side x side cells in the middle of each.

    Skips where the wheel is missing.
    """
    demo = demo_city()
    try:
        source = demo.folder().parent / "munich"
    except demo.WheelMissing as error:
        pytest.skip(str(error))
    town, materials = _read_town(source, demo)
    low = np.min([m[0].position.min(0) for m in town.meshes], 0).astype(np.float64)
    high = np.max([m[0].position.max(0) for m in town.meshes], 0).astype(np.float64)
    step = np.ceil((high - low)[[0, 2]] / CELL_M) * CELL_M
    first = np.rint((low + high)[[0, 2]] / 2 / CELL_M - side / 2) * CELL_M
    boxes = []
    for i in range(columns):
        for k in range(rows):
            x, z = first + (i, k) * step
            far = (x + side * CELL_M, z + side * CELL_M)
            boxes.append(
                [[float(x), float(low[1]) + 1.5, float(z)], [float(far[0]), float(low[1]) + 1.8, float(far[1])]]
            )
    path = CACHE / f"munich-{columns}x{rows}-{_digest(__file__, demo.__file__)}.glb"
    if not path.exists():
        raw = _painted(town, materials, demo)
        nodes = []
        for i in range(columns):
            for k in range(rows):
                matrix = np.eye(4)
                matrix[[0, 2], 3] = (i, k) * step
                nodes += [RawNode(f"{i} {k} {n.name}", n.mesh, matrix) for n in raw.nodes]
        raw.nodes, raw.notice = nodes, demo.COPYRIGHT
        write_raw(path, raw)
    return path, boxes


def _digest(*files: str | None) -> str:
    return hashlib.sha256(b"".join(Path(str(f)).read_bytes() for f in files)).hexdigest()[:16]


def _read_town(source: Path, demo: Any) -> tuple[RawScene, list[str]]:
    """Return another city of the wheel as `san_francisco.read_city` returns its own."""
    scene, materials = RawScene(default_double_sided=True), []
    (file,) = source.glob("*.xml")
    for shape in ElementTree.parse(file).getroot().findall("shape"):
        name = next(s.get("value", "") for s in shape.findall("string") if s.get("name") == "filename")
        files = Folder(source / name, Limits())
        (primitive,) = read_ply(files.read(files.name), files, Limits()).meshes[0]
        x, y, z = primitive.position.T
        primitive.position = np.stack([x, z, -y], 1).astype(np.float32)
        scene.nodes.append(RawNode(str(shape.get("id", name)).removeprefix("mesh-"), len(scene.meshes), np.eye(4)))
        scene.meshes.append([primitive])
        reference = shape.find("ref")
        known = str(reference.get("id")) if reference is not None else "marble"
        materials.append(known if known in demo.MATERIALS else "marble")
    return scene, materials


def _painted(city: RawScene, materials: list[str], demo: Any) -> RawScene:
    """Return the city with the demo's materials as materials."""
    order = list(demo.MATERIALS)
    city.materials = [
        RawMaterial(name=name, base_color=tuple(color), double_sided=True) for name, color in demo.MATERIALS.values()
    ]
    for node, material in zip(city.nodes, materials, strict=True):
        city.meshes[node.mesh][0].material = order.index(material)
    return city


class _Spots:
    """Where things may stand: a raster of free squares with the ground's height."""

    def __init__(self, free: np.ndarray, height: np.ndarray, corner: tuple[float, float], step: float) -> None:
        self.free, self.height, self.corner, self.step = free, height, corner, step
        self.rng = np.random.default_rng(2005)

    def take(self, radius_m: float) -> np.ndarray | None:
        """Return a place (3,) on the ground with nothing within the radius, and mark it taken; None if there is none."""
        reach = int(np.ceil(radius_m / self.step))
        i, k = np.nonzero(self.free)
        for pick in self.rng.permutation(len(i))[:2000]:
            a, b = int(i[pick]), int(k[pick])
            here = slice(max(0, a - reach), a + reach + 1), slice(max(0, b - reach), b + reach + 1)
            if self.free[here].all() and np.isfinite(self.height[here]).all():
                self.free[here] = False
                return np.array(
                    [self.corner[0] + a * self.step, self.height[here].min(), self.corner[1] + b * self.step]
                )
        return None


def _pavements(city: RawScene, boxes: list[list[list[float]]]) -> _Spots:
    """Return the open ground near walls around the view space."""
    corners = np.array(boxes)
    low, high = corners[:, 0].min(0) - 4 * CELL_M, corners[:, 1].max(0) + 4 * CELL_M
    terrain = next(n for n in city.nodes if n.name == "Terrain")
    ground = city.meshes[terrain.mesh][0]
    level = build_level(
        RawScene(meshes=[[RawPrimitive(position=ground.position.copy(), index=ground.index, material=-1)]],
                 nodes=[RawNode("Terrain", 0, np.eye(4))]), unit_m=1.0, up="y",
    )  # fmt: skip
    low[1], high[1] = level.object_box[0, :, 1]
    sampled = sample_ground(level, low=low, high=high, cell_m=4.0)
    built = np.zeros(sampled.height.shape, dtype=bool)
    for node in city.nodes:
        if node.mesh == terrain.mesh:
            continue
        p = city.meshes[node.mesh][0].position
        a = np.floor((p[:, [0, 2]].min(0) - (sampled.x0, sampled.z0)) / sampled.step).astype(int)
        b = np.ceil((p[:, [0, 2]].max(0) - (sampled.x0, sampled.z0)) / sampled.step).astype(int) + 1
        if (b > 0).all():
            built[max(0, a[0]) : b[0], max(0, a[1]) : b[1]] = True
    away = distance_transform_edt(~built) * sampled.step
    free = (away >= PAVEMENT_M[0]) & (away <= PAVEMENT_M[1]) & np.isfinite(sampled.height)
    return _Spots(free, sampled.height, (sampled.x0, sampled.z0), sampled.step)


def _furnish(raw: RawScene, models: Path, spots: _Spots) -> list[furniture.Model]:
    """Add every model once, in its true size, turned at random; one that finds no room is left out."""
    placed = []
    for model, given in furniture.read_models(models):
        primitives = _by_material(given)
        points = np.concatenate([p.position for p in primitives]).astype(np.float64)
        turned = (points[:, None, :] * model.turn).sum(2)
        low, high = turned.min(0), turned.max(0)
        scale = np.array(model.size_m) / np.maximum(high - low, 1e-9)
        at = spots.take(float(np.hypot(model.size_m[0], model.size_m[2])) / 2)
        if at is None:
            continue
        angle = spots.rng.uniform(0, 2 * np.pi)
        about = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        linear = (about * scale) @ model.turn
        foot = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = linear, at - (about * scale) @ foot
        first, texture = len(raw.materials), len(raw.textures)
        for material in given.materials:
            material.texture += texture if material.texture >= 0 else 0
        for primitive in primitives:
            primitive.material += first if primitive.material >= 0 else 0
        raw.materials += given.materials
        raw.textures += given.textures
        raw.nodes.append(RawNode(model.name, len(raw.meshes), matrix))
        raw.meshes.append(primitives)
        placed.append(model)
    return placed


def _by_material(raw: RawScene) -> list[RawPrimitive]:
    """Return all triangles of a file as one primitive a material: one object, a call a material."""
    groups: dict[int, list[RawPrimitive]] = {}
    for mesh in raw.meshes:
        for primitive in mesh:
            groups.setdefault(primitive.material, []).append(primitive)
    found = []
    for material, parts in sorted(groups.items()):
        ends = np.cumsum([0, *(len(p.position) for p in parts)])
        whole = lambda name: all(getattr(p, name) is not None for p in parts)  # noqa: B023, E731
        join = lambda name: np.concatenate([getattr(p, name) for p in parts]) if whole(name) else None  # noqa: B023, E731
        found.append(RawPrimitive(
            position=join("position"), index=np.concatenate([p.index + e for p, e in zip(parts, ends, strict=False)]),
            material=material, normal=join("normal"), uv=join("uv"),
        ))  # fmt: skip
    return found


def write_raw(path: Path, raw: RawScene) -> None:
    """Write a level as GLB: a node an object, positions, normals and texture coordinates as they are."""
    body = bytearray()
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "farfield benchmarks", "copyright": raw.notice}, "scene": 0,
        "scenes": [{"nodes": list(range(len(raw.nodes)))}], "nodes": [], "meshes": [], "accessors": [],
        "bufferViews": [], "materials": [], "textures": [], "images": [], "samplers": [{}],
    }  # fmt: skip

    def view(data: bytes) -> int:
        document["bufferViews"].append({"buffer": 0, "byteOffset": len(body), "byteLength": len(data)})
        body.extend(data)
        body.extend(bytes(-len(body) % 4))
        return len(document["bufferViews"]) - 1

    def accessor(array: np.ndarray, kind: str, component: int, **more: Any) -> int:
        row = {"bufferView": view(array.tobytes()), "componentType": component, "type": kind, "count": len(array)}
        document["accessors"].append(row | more)
        return len(document["accessors"]) - 1

    for mesh in raw.meshes:
        rows = []
        for p in mesh:
            position = p.position.astype("<f4")
            bounds = {"min": position.min(0).astype(float).tolist(), "max": position.max(0).astype(float).tolist()}
            attributes = {"POSITION": accessor(position, "VEC3", 5126, **bounds)}
            if p.normal is not None:
                attributes["NORMAL"] = accessor(p.normal.astype("<f4"), "VEC3", 5126)
            if p.uv is not None and p.material >= 0 and raw.materials[p.material].texture >= 0:
                attributes["TEXCOORD_0"] = accessor(p.uv.astype("<f4"), "VEC2", 5126)
            short = len(position) < 65536
            corners = accessor(p.index.reshape(-1).astype("<u2" if short else "<u4"), "SCALAR", 5123 if short else 5125)
            row: dict[str, Any] = {"attributes": attributes, "indices": corners}
            rows.append(row if p.material < 0 else row | {"material": p.material})
        document["meshes"].append({"primitives": rows})
    identity = np.eye(4)
    for node in raw.nodes:
        matrix = {} if (node.matrix == identity).all() else {"matrix": node.matrix.T.reshape(-1).tolist()}
        document["nodes"].append({"name": node.name, "mesh": node.mesh, **matrix})
    for m in raw.materials:
        surface: dict[str, Any] = {"baseColorFactor": list(m.base_color), "metallicFactor": 0.0}
        if m.texture >= 0:
            surface["baseColorTexture"] = {"index": m.texture}
        mode = {"alphaMode": "MASK"} if m.alpha_mode == MASK else {}
        document["materials"].append(
            {"name": m.name, "doubleSided": m.double_sided, "pbrMetallicRoughness": surface, **mode}
        )
    for t in raw.textures:
        document["images"].append({"bufferView": view(t.data), "mimeType": mime_type(t.data)})
        document["textures"].append({"source": len(document["images"]) - 1, "sampler": 0})
    document["buffers"] = [{"byteLength": len(body)}]
    document = {key: value for key, value in document.items() if value != []}
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    word = lambda n: n.to_bytes(4, "little")  # noqa: E731
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_suffix(".part").open("wb") as file:
        for part in (b"glTF", word(2), word(28 + len(text) + len(body)), word(len(text)), b"JSON", text,
                     word(len(body)), b"BIN\0", body):  # fmt: skip
            file.write(part)
    path.with_suffix(".part").replace(path)
