"""The demo city: North Beach and Russian Hill, San Francisco, from the scene files of the `sionna-rt` wheel.

Its 4,735 meshes (a wall and a roof a building, and the terrain) become one GLB: a node a mesh, names kept, z-up data
turned to y up, plain materials for wall, roof and ground. The wheel is found, never imported; nothing is fetched.
The data is (c) OpenStreetMap contributors, ODbL; the notice travels in the GLB's asset.copyright.
"""

import importlib.util
import json
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from farfield.scene.derive import sample_ground
from farfield.scene.files import Folder
from farfield.scene.level import build_level
from farfield.scene.limits import Limits
from farfield.scene.raw import RawNode, RawPrimitive, RawScene
from farfield.scene.soup import read_ply

COPYRIGHT = "(c) OpenStreetMap contributors, ODbL 1.0 - https://www.openstreetmap.org/copyright"
CELL_M = 23.0
COLUMNS = (26, 20)  # of 23 m: about 600 x 450 m
EYE_M = (1.5, 1.8)
BUDGET = "1300 calls"
MATERIALS = {
    "marble": ("wall", [0.70, 0.64, 0.49, 1.0]),
    "metal": ("roof", [0.25, 0.25, 0.30, 1.0]),
    "mat-terrain": ("ground", [0.42, 0.45, 0.36, 1.0]),
}


class WheelMissing(RuntimeError):
    """The package sionna-rt is not installed."""


def folder() -> Path:
    """Return the scene's folder in the wheel. Raises WheelMissing."""
    spec = importlib.util.find_spec("sionna")
    for place in (spec.submodule_search_locations or ()) if spec else ():
        found = Path(place) / "rt" / "scenes" / "san_francisco"
        if (found / "san_francisco.xml").is_file():
            return found
    raise WheelMissing("sionna-rt is not installed: pip install --no-deps -r infra/requirements/demo.lock")


def read_city() -> tuple[RawScene, list[str]]:
    """Return the city, metres, y up, one node a mesh, and the material id of each node."""
    scene, materials = RawScene(default_double_sided=True), []
    source = folder()
    for shape in ElementTree.parse(source / "san_francisco.xml").getroot().findall("shape"):
        file = next(s.get("value", "") for s in shape.findall("string") if s.get("name") == "filename")
        files = Folder(source / file, Limits())
        (primitive,) = read_ply(files.read(files.name), files, Limits()).meshes[0]
        x, y, z = primitive.position.T
        primitive.position = np.stack([x, z, -y], 1).astype(np.float32)
        scene.nodes.append(RawNode(str(shape.get("id", file)).removeprefix("mesh-"), len(scene.meshes), np.eye(4)))
        scene.meshes.append([primitive])
        reference = shape.find("ref")
        materials.append(str(reference.get("id")) if reference is not None else "marble")
    return scene, materials


def center(scene: RawScene) -> np.ndarray:
    """Return the middle of the city's box, metres."""
    low = np.min([m[0].position.min(0) for m in scene.meshes], 0).astype(np.float64)
    high = np.max([m[0].position.max(0) for m in scene.meshes], 0).astype(np.float64)
    return (low + high) / 2


def street_boxes(
    scene: RawScene, *, columns: tuple[int, int] = COLUMNS, middle: tuple[float, float] | None = None
) -> list[list[list[float]]]:
    """Return a box a 23 m column of the grid, around x, z (the city's middle), at eye height over the terrain in it."""
    terrain = next(n for n in scene.nodes if n.name == "Terrain")
    primitive = scene.meshes[terrain.mesh][0]
    ground_only = RawScene(
        meshes=[[RawPrimitive(position=primitive.position.copy(), index=primitive.index, material=-1)]],
        nodes=[RawNode("Terrain", 0, np.eye(4))],
    )
    level = build_level(ground_only, unit_m=1.0, up="y")
    n = np.array(columns)
    first = np.rint((center(scene)[[0, 2]] if middle is None else np.array(middle)) / CELL_M - n / 2)
    (x0, z0), (x1, z1) = first * CELL_M, (first + n) * CELL_M
    bounds = level.object_box[0]
    low, high = np.array([x0, bounds[0, 1], z0]), np.array([x1, bounds[1, 1], z1])
    boxes = sample_ground(level, low=low, high=high, cell_m=CELL_M).columns(EYE_M)
    return [[[round(v, 2) for v in corner] for corner in box] for box in boxes.tolist()]


def write_city(
    path: Path, scene: RawScene, materials: list[str], keep: Callable[[str, np.ndarray], bool] = lambda name, box: True
) -> int:
    """Write the city as GLB, or those meshes whose name and box (2,3) `keep` accepts; return how many nodes it has."""
    order = list(MATERIALS)
    body = bytearray()
    views: list[dict[str, Any]] = []
    accessors: list[dict[str, Any]] = []
    meshes: list[dict[str, Any]] = []
    nodes: list[dict[str, Any]] = []

    def add(array: np.ndarray, kind: str, component: int, target: int, **more: Any) -> int:
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": array.nbytes, "target": target})
        body.extend(array.tobytes())
        body.extend(bytes(-len(body) % 4))
        row = {"bufferView": len(views) - 1, "componentType": component, "type": kind, "count": len(array)}
        accessors.append(row | more)
        return len(accessors) - 1

    for node, material in zip(scene.nodes, materials, strict=True):
        primitive = scene.meshes[node.mesh][0]
        low, high = primitive.position.min(0), primitive.position.max(0)
        if not keep(node.name, np.stack([low, high])):
            continue
        corners = primitive.index.reshape(-1)
        small = len(primitive.position) < 65536
        indices = corners.astype("<u2" if small else "<u4")
        position = add(
            primitive.position.astype("<f4"), "VEC3", 5126, 34962,
            min=low.astype(float).tolist(), max=high.astype(float).tolist(),
        )  # fmt: skip
        corner = add(indices, "SCALAR", 5123 if small else 5125, 34963)
        row = {"attributes": {"POSITION": position}, "indices": corner, "material": order.index(material)}
        nodes.append({"name": node.name, "mesh": len(meshes)})
        meshes.append({"name": node.name, "primitives": [row]})
    document = {
        "asset": {"version": "2.0", "generator": "farfield demo", "copyright": COPYRIGHT},
        "scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes, "meshes": meshes,
        "materials": [
            {"name": name, "doubleSided": True,
             "pbrMetallicRoughness": {"baseColorFactor": color, "metallicFactor": 0.0, "roughnessFactor": 0.9}}
            for name, color in MATERIALS.values()
        ],
        "accessors": accessors, "bufferViews": views, "buffers": [{"byteLength": len(body)}],
    }  # fmt: skip
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = b"glTF" + b"".join(n.to_bytes(4, "little") for n in (2, 28 + len(text) + len(body), len(text))) + b"JSON"
    path.write_bytes(head + text + len(body).to_bytes(4, "little") + b"BIN\0" + body)
    return len(nodes)


def settings_text(
    boxes: list[list[list[float]]], *, budget: str = BUDGET, fov_deg: float = 45.0, size: tuple[int, int] = (1280, 720)
) -> str:
    """Return the demo's settings as TOML. `size` of the picture, pixels."""
    rows = ",\n".join(f"  {json.dumps(box)}" for box in boxes)
    return (
        f'# A band at eye height over the streets, a box a column of {CELL_M:g} m.\nbudget = "{budget}"\n\n'
        f"[camera]\nfov_deg = {fov_deg}\nwidth = {size[0]}\nheight = {size[1]}\n\n"
        '[visibility]\nmode = "off"\n\n'
        f"[view_space]\ncell_m = {CELL_M}\nboxes = [\n{rows},\n]\n"
    )


def build(scene: Path, settings: Path) -> None:
    """Write the city's GLB and the demo's settings. Raises WheelMissing."""
    city, materials = read_city()
    write_city(scene, city, materials)
    settings.write_text(settings_text(street_boxes(city)), encoding="utf-8")


if __name__ == "__main__":
    build(Path(sys.argv[1]), Path(sys.argv[2]))
