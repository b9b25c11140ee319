"""The viewer's geometry and the bake agree on colours: every kind of material that is baked, pixel by pixel.

The camera's picture is taken for the texel grid of an impostor, so that the bake's own kernels say what each pixel shows.
"""

import base64
import copy
import io
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser.levels import give_level
from browser.static_server import DIST, ROOT, serving
from farfield.bake.bake import _surface
from farfield.bake.clip import gather
from farfield.bake.sample import alpha_at
from farfield.bake.shade import encode_srgb, shade_at
from farfield.bake.textures import decode
from farfield.candidates.model import BOX
from farfield.impostor.plan import LayerPlan
from farfield.placementdb.read import Placement
from farfield.scene.read import read_scene
from farfield.scene.write import write_glb
from farfield.settings import Settings, ViewSpaceSettings
from levels import Gltf, pack_glb
from panels import box_cell
from PIL import Image

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(not (DIST / "viewer.html").is_file(), reason="the pages are not built: npm run build"),
]
TREE = ROOT / "tests" / "golden" / "placementdb"
COLUMNS, DISTANCE_M = 4, 14.0
PLAIN = {"metallicFactor": 0.0}


def image_of(values: np.ndarray, kind: str) -> bytes:
    out = io.BytesIO()
    Image.fromarray(values.astype(np.uint8)).save(
        out, kind, **({"lossless": True, "exact": True} if kind == "WEBP" else {})
    )
    return out.getvalue()


def waves(size: int, turns: float) -> np.ndarray:
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    phase = 2 * np.pi * turns / size
    return np.stack([128 + 90 * np.sin(phase * x), 128 + 90 * np.sin(phase * y), np.full_like(x, 90.0)], -1)


def palette() -> np.ndarray:
    rng = np.random.default_rng(4)
    return np.concatenate(
        [rng.integers(0, 256, (4, 4, 3)), np.where(np.indices((4, 4)).sum(0) % 2, 255, 20)[..., None]], -1
    )


def materials(level: Gltf) -> dict[str, int]:
    """Add the materials, by name; each is looked at on a quad of its own."""

    def texture(values: np.ndarray, kind: str = "PNG", **sampler: int) -> int:
        mime = f"image/{kind.lower()}"
        image = level.add("images", {"bufferView": level.view(image_of(values, kind)), "mimeType": mime})
        row: dict[str, Any] = {"sampler": level.add("samplers", {"wrapS": 10497, "wrapT": 10497, **sampler})}
        row |= {"extensions": {"EXT_texture_webp": {"source": image}}} if kind == "WEBP" else {"source": image}
        return level.add("textures", row)

    smooth = {"index": texture(waves(64, 1))}
    nearest = {"index": texture(palette(), magFilter=9728, minFilter=9728, wrapS=33648)}
    turned = {"extensions": {"KHR_texture_transform": {"rotation": 0.5, "scale": [1.5, 0.75], "offset": [0.2, 0.1]}}}
    rows: dict[str, dict[str, Any]] = {
        "plain": {"pbrMetallicRoughness": PLAIN | {"baseColorFactor": [0.7, 0.4, 0.2, 1]}},
        "coloured": {"pbrMetallicRoughness": PLAIN | {"baseColorFactor": [0.9, 0.9, 0.9, 1]}},
        "smooth": {"pbrMetallicRoughness": PLAIN | {"baseColorTexture": smooth | turned}},
        "nearest": {"pbrMetallicRoughness": PLAIN | {"baseColorTexture": nearest}},
        "glowing": {"pbrMetallicRoughness": PLAIN | {"baseColorTexture": smooth, "baseColorFactor": [0.2, 0.2, 0.3, 1]},
                    "emissiveFactor": [0.5, 0.25, 1], "emissiveTexture": smooth | {"texCoord": 1}},
        "unlit": {"pbrMetallicRoughness": PLAIN | {"baseColorTexture": {"index": texture(waves(32, 1), "WEBP")}},
                  "extensions": {"KHR_materials_unlit": {}}},
        "masked": {"pbrMetallicRoughness": PLAIN | {"baseColorTexture": nearest}, "alphaMode": "MASK"},
        "far": {"pbrMetallicRoughness": PLAIN | {"baseColorTexture": {"index": texture(waves(2048, 4))}}},
        "from behind": {"pbrMetallicRoughness": PLAIN | {"baseColorFactor": [0.7, 0.4, 0.9, 1]}, "doubleSided": True},
        "glow alone": {"pbrMetallicRoughness": PLAIN, "emissiveFactor": [0.4, 0.4, 0.1], "emissiveTexture": smooth},
        "culled": {"pbrMetallicRoughness": PLAIN},
    }  # fmt: skip
    return {name: level.add("materials", row | {"name": name}) for name, row in rows.items()}


def frame_of(direction: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    d = direction / np.linalg.norm(direction)
    right = np.cross(d, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return d, right, np.cross(right, d)


def source_level(eye: np.ndarray, direction: np.ndarray, n_objects: int) -> tuple[Gltf, list[str]]:
    """Quads in front of the eye, tilted apart, one a material, and triangles behind it for the rest of the objects."""
    level = Gltf()
    d, right, up = frame_of(direction)
    names = materials(level)
    rng = np.random.default_rng(0)
    for k, (name, material) in enumerate(names.items()):
        middle = eye + DISTANCE_M * d + 3.6 * (k % COLUMNS - 1.5) * right + 3.2 * (1 - k // COLUMNS) * up
        u, v = right + rng.uniform(-0.3, 0.3) * d, up + rng.uniform(-0.3, 0.3) * d
        corners = np.array([middle + 1.4 * (a * u + b * v) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        uv = np.array([[0, 2], [2, 2], [2, 0], [0, 0]], np.float32) * (0.5 if name in ("coloured", "far") else 1)
        index = [0, 2, 1, 0, 3, 2] if name in ("from behind", "culled") else [0, 1, 2, 0, 2, 3]
        color = rng.random((4, 4)).astype(np.float32) if name == "coloured" else np.ones((4, 4), np.float32)
        row = level.primitive(
            corners.astype(np.float32), np.array(index, np.uint16), material=material, TEXCOORD_0=uv, COLOR_0=color,
            TEXCOORD_1=(0.7 * uv[::-1] + 0.1).astype(np.float32),
        )  # fmt: skip
        level.node(name=name, mesh=level.mesh(row))
    hidden = (np.eye(3) * 0.1).astype(np.float32)
    for k in range(n_objects - len(names)):
        row = level.primitive((hidden + eye - (30 + k) * d).astype(np.float32), np.array([0, 1, 2], np.uint16))
        level.node(name=f"hidden {k}", mesh=level.mesh(row))
    level.document["extensionsRequired"] = ["EXT_texture_webp"]
    return level, list(names)


def with_ids(glb: bytes, objects: dict[str, int]) -> bytes:
    """Return the level with `extras.object` by name instead."""
    length = int.from_bytes(glb[12:16], "little")
    document = copy.deepcopy(json.loads(glb[20 : 20 + length]))
    for node in document["nodes"]:
        node["extras"]["object"] = objects[node["name"]]
    return pack_glb(json.dumps(document).encode(), glb[28 + length :])


def in_view(placement: Placement, eye: np.ndarray, direction: np.ndarray, objects: np.ndarray) -> np.ndarray:
    """Return the objects whose box's middle is well inside the picture."""
    d, right, up = frame_of(direction)
    camera = placement.manifest["camera"]
    tan_y = np.tan(np.radians(camera["fov_deg"]) / 2)
    to = placement.index["object_box"][objects].mean(1) + placement.origin_m - eye
    z = to @ d
    return objects[(z > 1) & (np.abs(to @ right) < z * tan_y) & (np.abs(to @ up) < z * tan_y)]


def test_pixels_of_the_viewer_are_what_the_bake_shades(tmp_path: Path, open_page: Any) -> None:
    shutil.copytree(TREE, tmp_path / "placement")
    placement = Placement.open(tmp_path)
    n = len(placement.index["object_box"])
    asked = json.loads((TREE / "lookups.json").read_text())["lookups"]
    views = [
        (np.array(g["position"]), np.array(g["direction"]), np.array(g["objects"])) for g in asked if not g["impostors"]
    ]
    views = [v for v in views if np.abs(v[1]).max() < 1e3 and abs(v[1][1]) < np.linalg.norm(v[1]) / 2]
    eye, direction, objects = max(views, key=lambda v: len(in_view(placement, *v)))
    free = in_view(placement, eye, direction, objects).tolist()
    level, names = source_level(eye, direction, n)
    assert len(free) >= len(names), "the view shows too few objects of the golden placement"
    (tmp_path / "source.glb").write_bytes(level.glb())
    box = ((tuple((eye - 1).tolist()), tuple((eye + 1).tolist())),)
    scene = read_scene(tmp_path / "source.glb", settings=Settings(view_space=ViewSpaceSettings(boxes=box, cell_m=8.0)))
    taken = free[: len(names)]
    rest = [o for o in range(n) if o not in taken]
    hidden = [name for name in scene.object_name if name not in names]
    ids = dict(zip([*names, *hidden], [*taken, *rest], strict=True))
    give_level(tmp_path, with_ids(write_glb(scene), ids))

    page, wrong = open_page()
    with serving({"it": tmp_path}) as url:
        page.goto(f"{url}/viewer/it")
        page.evaluate("farfield.ready()")
        page.evaluate("farfield.setMode({impostors: false, background: [1, 0, 1]})")
        page.evaluate("([p, d]) => farfield.setView(p, d)", [eye.tolist(), direction.tolist()])
        picture = page.evaluate("farfield.capture()").split(",")[1]
    shown = np.asarray(Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")).astype(int)
    assert wrong == []
    compare(scene, names, eye, direction, placement.manifest["camera"], shown)


def compare(
    scene: Any, names: list[str], eye: np.ndarray, direction: np.ndarray, camera: Any, shown: np.ndarray
) -> None:
    width, height = camera["width"], camera["height"]
    d, right, up = frame_of(direction)
    tan = np.tan(np.radians(camera["fov_deg"]) / 2) * np.array([width / height, 1.0])
    one = np.array([DISTANCE_M])
    plan = LayerPlan(
        eye=eye - scene.origin_m, right=right, up=up, back=-d, slope0=-tan, texel=2 * tan / [width, height],
        resolution=np.array([width, height], np.int32), plane=one, near=one - 1, far=one + 1,
        crop=np.array([[width, height]], np.int32), depth=0.0,
    )  # fmt: skip
    pyramids = decode(scene, np.arange(len(scene.material_name)))
    cell = box_cell(tuple(plan.eye - 1e-6), tuple(plan.eye + 1e-6))
    out, uv, texel, color = np.empty(10), np.empty((3, 2)), np.empty(4), np.empty(3)
    counted = {}
    for name in names:
        o = scene.object_name.index(name)
        sources = gather(scene, (o, o + 1), plan, kind=BOX, view_cell=cell)
        if name == "culled":
            assert len(sources.material) == 0
            corner = scene.position[scene.index[scene.primitive_triangle[scene.mesh_primitive[scene.object_mesh[o]]]]]
            at = scene.object_matrix[o, :, :3] @ corner.mean(0) + scene.object_matrix[o, :, 3] - plan.eye
            i = int((at @ right / (at @ d) + tan[0]) / plan.texel[0])
            j = height - 1 - int((at @ up / (at @ d) + tan[1]) / plan.texel[1])
            assert (shown[j, i] == [255, 0, 255]).all()
            continue
        surface = _surface(scene, (o, o + 1), pyramids)
        differences = []
        for s, q in enumerate(sources.snapped.reshape(-1, 3, 2).astype(float) / 256):
            low, high = np.floor(q.min(0)).astype(int), np.ceil(q.max(0)).astype(int)
            for j in range(low[1], high[1], 3):
                for i in range(low[0], high[0], 3):
                    if not all(deep(q, np.array([i + 0.5, j + 0.5]))):
                        continue
                    found = shown[height - 1 - j, i]
                    if surface.masked[sources.material[s]] and not alpha_at(sources, surface, s, i, j):
                        differences.append(np.abs(found - [255, 0, 255]).max())
                        continue
                    shade_at(sources, surface, s, 256 * i + 128.0, 256 * j + 128.0, 1.0, out, uv, texel, color)
                    differences.append(np.abs(encode_srgb(color).astype(int) - found).max())
        counted[name] = np.array(differences)
    for name, difference in counted.items():
        assert len(difference) > 500, name
        # Texels that a nearest filter picks turn over at their very edge: a few pixels lie on one.
        edges = 0.02 if name in ("nearest", "masked") else 0.0
        assert (difference > 1).mean() <= edges, f"{name}: {np.bincount(difference)[:20]} pixels by difference"


def deep(q: np.ndarray, p: np.ndarray) -> list[bool]:
    """Is p inside triangle q, a pixel and a half from its edges?"""
    out = []
    for k in range(3):
        a, b = q[k], q[(k + 1) % 3]
        e = b - a
        out.append(float(e[0] * (p - a)[1] - e[1] * (p - a)[0]) > 1.5 * float(np.hypot(*e)))
    return out
