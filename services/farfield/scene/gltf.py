"""glTF 2.0 and GLB -> RawScene.

Own reader over the JSON, because trimesh drops triangle fans silently, ignores texture transforms, reads no sparse or
zero-filled accessors, and trusts sizes it is told. Materials: `gltf_materials.py`; accessors: `accessors.py`.
Points and lines are left out with a warning. What moves (animation, skins, morph targets) stands as it is stored and is
marked, for no impostor can show it: `Scene.object_look`.
After    glTF 2.0 specification; KHR_texture_transform, KHR_mesh_quantization, EXT_meshopt_compression (`meshopt.py`).
"""

import json
import math
from typing import Any

import numpy as np

from farfield.errors import SceneIndexOutOfRange, SceneNotFinite, SceneUnreadable
from farfield.scene.accessors import Accessors, Json
from farfield.scene.files import SceneFiles, data_uri, relative_name
from farfield.scene.gltf_materials import NONE, Materials, TexCoord
from farfield.scene.limits import Limits, need
from farfield.scene.meshopt import view_bytes
from farfield.scene.model import ANIMATED, MORPHED, SKINNED
from farfield.scene.raw import RawNode, RawPrimitive, RawScene, plain_text

READ_EXTENSIONS = frozenset({
    "KHR_texture_transform", "KHR_mesh_quantization", "KHR_materials_emissive_strength", "EXT_texture_webp",
    "KHR_materials_pbrSpecularGlossiness", "KHR_materials_unlit", "EXT_meshopt_compression",
})  # fmt: skip
# They change how light plays on a surface, not where it is: shown without.
IGNORED_EXTENSIONS = frozenset({
    "KHR_materials_clearcoat", "KHR_materials_ior", "KHR_materials_sheen",
    "KHR_materials_specular", "KHR_materials_iridescence", "KHR_materials_anisotropy", "KHR_materials_dispersion",
    "KHR_materials_variants", "KHR_lights_punctual", "KHR_animation_pointer", "KHR_xmp_json_ld",
    "KHR_materials_volume", "KHR_materials_transmission", "KHR_materials_diffuse_transmission",
})  # fmt: skip


def read_gltf(data: bytes, files: SceneFiles, limits: Limits) -> RawScene:
    """Return the default scene of a glTF (JSON) or GLB file; `files` reads what it names. Raises SceneError."""
    text, binary = _chunks(data) if data[:4] == b"glTF" else (data, None)
    need(len(text), limits.json_bytes, "bytes of JSON")
    try:
        document = json.loads(bytes(text), parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise SceneUnreadable(f"The glTF's JSON does not parse: {error}.") from error
    if not isinstance(document, dict):
        raise SceneUnreadable("The glTF's JSON is not an object.")
    return _Reader(document, binary, files, limits).read()


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON number")


def _chunks(data: bytes) -> tuple[memoryview, memoryview | None]:
    """Return the JSON and the binary chunk of a GLB."""
    view = memoryview(data)
    if len(data) < 20:
        raise SceneUnreadable(f"The GLB is truncated: {len(data)} bytes.")
    version, length = (int.from_bytes(data[i : i + 4], "little") for i in (4, 8))
    if version != 2:
        raise SceneUnreadable(f"The GLB has version {version}; version 2 is read.")
    if length > len(data):
        raise SceneUnreadable(f"The GLB is truncated: {len(data)} of {length} bytes.")
    found: dict[bytes, memoryview] = {}
    at = 12
    while at + 8 <= length:
        size, kind = int.from_bytes(data[at : at + 4], "little"), bytes(data[at + 4 : at + 8])
        if at + 8 + size > length:
            raise SceneUnreadable("A chunk of the GLB ends past its end.")
        found.setdefault(kind, view[at + 8 : at + 8 + size])
        at += 8 + size
    if b"JSON" not in found:
        raise SceneUnreadable("The GLB has no JSON chunk.")
    return found[b"JSON"], found.get(b"BIN\0")


class _Reader:
    def __init__(self, document: dict[str, Any], binary: memoryview | None, files: SceneFiles, limits: Limits) -> None:
        self.document, self.binary, self.files, self.limits = document, binary, files, limits
        self.scene = RawScene()
        self.buffers: dict[int, Any] = {}
        self.nodes = self._rows("nodes")
        self.accessors = Accessors(document, self._buffer, limits, decoded=view_bytes)
        self.materials = Materials(document, self._image_source, self.scene, limits)
        self.n_triangles = self.n_vertices = 0

    def _rows(self, key: str) -> list[Any]:
        return Json.rows(self.document.get(key), key)

    def _warn(self, text: str) -> None:
        self.scene.warn(text)

    def read(self) -> RawScene:
        self._check_head()
        moving = self._moving()
        if moving:
            self._warn("Animations are left out: the level is placed as its nodes stand.")
        mesh_ids: dict[int, int] = {}
        placed = self._placed(moving)
        outside = sum(isinstance(n, dict) and "mesh" in n for n in self.nodes) - len(placed)
        if outside:
            self._warn(f"{outside} nodes with meshes are not part of the default scene; they are left out.")
        for i, matrix, look in placed:
            node = self.nodes[i]
            mesh = Json.integer(node["mesh"], f"nodes[{i}].mesh")
            if mesh not in mesh_ids:
                mesh_ids[mesh] = len(self.scene.meshes)
                self.scene.meshes.append(self._mesh(mesh))
            name = node.get("name") or Json.pick(self._rows("meshes"), mesh, f"nodes[{i}].mesh").get("name")
            if "skin" in node:
                self._warn("Skins are left out: skinned meshes stand as they are stored.")
                look |= SKINNED
            named = name if isinstance(name, str) else f"node {i}"
            self.scene.nodes.append(RawNode(named, mesh_ids[mesh], matrix, look))
        return self.scene

    def _check_head(self) -> None:
        asset = Json.table(self.document.get("asset"), "asset")
        notice = asset.get("copyright", "")
        self.scene.notice = plain_text(notice) if isinstance(notice, str) else ""
        for key in ("version", "minVersion"):
            version = asset.get(key, "2.0")
            if (
                not isinstance(version, str)
                or not version.startswith("2.")
                or (key == "minVersion" and version != "2.0")
            ):
                raise SceneUnreadable(f"asset.{key} is {version!r:.40}; glTF 2.0 is read.")
        for name in self._rows("extensionsRequired"):
            if not isinstance(name, str) or name not in READ_EXTENSIONS | IGNORED_EXTENSIONS:
                raise SceneUnreadable(f"The scene needs the glTF extension {name!s:.80}, which is not read.")
        for name in self._rows("extensionsUsed"):
            if isinstance(name, str) and name in IGNORED_EXTENSIONS and name.startswith("KHR_materials_"):
                self._warn(f"{name} is left out: such materials are shown with their base colour.")

    # nodes

    def _roots(self) -> list[int]:
        scenes = self._rows("scenes")
        if scenes:
            scene = Json.pick(scenes, self.document.get("scene", 0), "scene")
            return [Json.integer(n, "scene.nodes") for n in Json.rows(scene.get("nodes"), "scene.nodes")]
        children = {
            Json.integer(c, f"nodes[{i}].children")
            for i, node in enumerate(self.nodes)
            for c in Json.rows(Json.table(node, f"nodes[{i}]").get("children"), f"nodes[{i}].children")
        }
        return [i for i in range(len(self.nodes)) if i not in children]

    def _moving(self) -> dict[int, int]:
        """Return the nodes that animations move, each with what moves in it."""
        moving: dict[int, int] = {}
        for a, animation in enumerate(self._rows("animations")):
            where = f"animations[{a}].channels"
            for row in Json.rows(Json.table(animation, f"animations[{a}]").get("channels"), where):
                target = Json.table(Json.table(row, where).get("target"), f"{where}.target")
                if "node" in target:
                    node = Json.integer(target["node"], f"{where}.target.node")
                    look = MORPHED if target.get("path") == "weights" else ANIMATED
                    moving[node] = moving.get(node, 0) | look
        return moving

    def _placed(self, moving: dict[int, int]) -> list[tuple[int, np.ndarray, int]]:
        """Return mesh-bearing nodes with their matrices to the scene and their looks, parents first."""
        need(len(self.nodes), self.limits.nodes, "nodes")
        seen: set[int] = set()
        placed = []
        waiting = [(i, np.eye(4), 1, 0) for i in reversed(self._roots())]
        while waiting:
            i, above, depth, look = waiting.pop()
            node = Json.pick(self.nodes, i, "a scene's or node's list of nodes")
            if i in seen:
                raise SceneUnreadable(f"nodes[{i}] has two parents, or is its own ancestor.")
            seen.add(i)
            need(depth, self.limits.node_depth, "levels of nodes")
            matrix = compose(above, _local_matrix(node, f"nodes[{i}]"))
            look |= moving.get(i, 0)
            if "mesh" in node:
                if not np.isfinite(matrix).all():
                    raise SceneNotFinite(f"The transform of nodes[{i}] is not finite.")
                placed.append((i, matrix, look))
            children = Json.rows(node.get("children"), f"nodes[{i}].children")
            below = look & ANIMATED
            waiting += [(Json.integer(c, f"nodes[{i}].children"), matrix, depth + 1, below) for c in reversed(children)]
        return placed

    # meshes

    def _mesh(self, index: int) -> list[RawPrimitive]:
        mesh = Json.pick(self._rows("meshes"), index, "a node's mesh")
        primitives = Json.rows(mesh.get("primitives"), f"meshes[{index}].primitives")
        found = []
        for p, row in enumerate(primitives):
            where = f"meshes[{index}].primitives[{p}]"
            primitive = self._primitive(Json.table(row, where), where)
            if primitive is not None:
                found.append(primitive)
        return found

    def _primitive(self, row: dict[str, Any], where: str) -> RawPrimitive | None:
        mode = Json.integer(row.get("mode", 4), f"{where}.mode")
        attributes = Json.table(row.get("attributes"), f"{where}.attributes")
        if mode not in (4, 5, 6):
            if not 0 <= mode <= 3:
                raise SceneUnreadable(f"{where}.mode is {mode}.")
            self._warn("Points and lines are left out.")
            return None
        if "POSITION" not in attributes:
            self._warn("Primitives without POSITION are left out.")
            return None
        if "targets" in row:
            self._warn("Morph targets are left out: such meshes stand as they are stored.")
        n, index = self._triangles(row, attributes, mode, where)
        self.n_triangles += len(index)
        self.n_vertices += min(n, index.size)
        need(self.n_triangles, self.limits.triangles, "triangles")
        need(self.n_vertices, self.limits.vertices, "vertices")
        if not len(index):
            return None
        used: np.ndarray | slice = slice(None)
        if index.size < n:
            used, flat = np.unique(index, return_inverse=True)
            index = flat.reshape(-1, 3)

        def attribute(name: str, widths: tuple[int, ...]) -> np.ndarray | None:
            if name not in attributes:
                return None
            array = self.accessors.floats(attributes[name], widths, f"{where}.{name}")
            if len(array) != n:
                raise SceneUnreadable(f"{where} has {n} positions but {len(array)} values of {name}.")
            return array[used]

        position = attribute("POSITION", (3,))
        assert position is not None
        if not np.isfinite(position).all():
            raise SceneNotFinite(f"{where} has positions that are not finite.")
        color = attribute("COLOR_0", (3, 4))
        if color is not None and color.shape[1] == 3:
            color = np.concatenate([color, np.ones((len(color), 1), np.float32)], 1)
        material, base, glow = self.materials.index(row.get("material"), where)

        def addressed(way: TexCoord) -> np.ndarray | None:
            tex_coord, transform = way
            uv = attribute(f"TEXCOORD_{tex_coord}", (2,)) if tex_coord >= 0 else None
            if uv is None or transform is None:
                return uv
            linear, offset = transform
            u, v = uv[:, 0].astype(np.float64), uv[:, 1].astype(np.float64)
            return np.stack([linear[k][0] * u + linear[k][1] * v + offset[k] for k in range(2)], 1).astype(np.float32)

        alone = base[0] < 0 or glow in (NONE, base)  # one set of coordinates is enough
        return RawPrimitive(
            position=position, index=index, material=material, normal=attribute("NORMAL", (3,)),
            uv=addressed(glow if base[0] < 0 else base), emissive_uv=None if alone else addressed(glow), color=color,
            look=MORPHED if row.get("targets") else 0,
        )  # fmt: skip

    def _triangles(
        self, row: dict[str, Any], attributes: dict[str, Any], mode: int, where: str
    ) -> tuple[int, np.ndarray]:
        """Return the number of positions and (T,3) int64 corners."""
        n = len(self.accessors.raw(attributes["POSITION"], f"{where}.POSITION")[0])
        if row.get("indices") is None:
            corners = np.arange(n, dtype=np.int64)
        else:
            corners = self.accessors.indices(row["indices"], f"{where}.indices")
            if len(corners) and corners.max() >= n:
                raise SceneIndexOutOfRange(f"{where} has index {corners.max()} but {n} vertices.")
        if mode == 4:
            if len(corners) % 3:
                self._warn(f"{where}: the number of its indices is no multiple of 3; the last ones are left out.")
            return n, corners[: len(corners) // 3 * 3].reshape(-1, 3)
        if len(corners) < 3:
            return n, np.zeros((0, 3), np.int64)
        i = np.arange(len(corners) - 2)
        if mode == 5:
            return n, np.stack([corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2]], 1)
        return n, np.stack([corners[i + 1], corners[i + 2], np.full_like(i, corners[0])], 1)

    # bytes

    def _buffer(self, index: int) -> Any:
        if index not in self.buffers:
            where = f"buffers[{index}]"
            row = Json.pick(self._rows("buffers"), index, where)
            length = Json.count(row.get("byteLength"), f"{where}.byteLength")
            if row.get("uri") is not None:
                data: Any = self._uri_bytes(Json.text(row["uri"], f"{where}.uri"))
            elif index == 0 and self.binary is not None:
                data = self.binary
            else:
                raise SceneUnreadable(f"{where} has no data.")
            if len(data) < length:
                raise SceneUnreadable(f"{where} is truncated: {len(data)} of {length} bytes are there.")
            self.buffers[index] = memoryview(data)[:length]
        return self.buffers[index]

    def _uri_bytes(self, uri: str) -> bytes:
        data = data_uri(uri, limits=self.limits)
        return data if data is not None else self.files.read(relative_name(uri, base=self._base()))

    def _base(self) -> str:
        return self.files.name.rpartition("/")[0]

    def _image_source(self, image: dict[str, Any], where: str) -> bytes:
        if image.get("uri") is not None:
            return self._uri_bytes(Json.text(image["uri"], f"{where}.uri"))
        return bytes(self.accessors.view_bytes(image.get("bufferView"), where))


def compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the 4 x 4 product a b, summed in one fixed order."""
    with np.errstate(over="ignore", invalid="ignore"):
        product = a[:, 0:1] * b[0:1]
        for k in range(1, 4):
            product = product + a[:, k : k + 1] * b[k : k + 1]
    return product


def _local_matrix(node: dict[str, Any], where: str) -> np.ndarray:
    if "matrix" in node:
        matrix = np.array(Json.numbers(node["matrix"], 16, f"{where}.matrix")).reshape(4, 4).T
        if not np.isfinite(matrix).all():
            raise SceneNotFinite(f"{where}.matrix is not finite.")
        if (matrix[3] != (0, 0, 0, 1)).any():
            raise SceneUnreadable(f"{where}.matrix is not affine.")
        return matrix
    x, y, z, w = Json.numbers(node.get("rotation", [0, 0, 0, 1]), 4, f"{where}.rotation")
    scale = Json.numbers(node.get("scale", [1, 1, 1]), 3, f"{where}.scale")
    shift = Json.numbers(node.get("translation", [0, 0, 0]), 3, f"{where}.translation")
    if not all(map(math.isfinite, (x, y, z, w, *scale, *shift))):
        raise SceneNotFinite(f"The transform of {where} is not finite.")
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not 0 < length < math.inf:
        raise SceneUnreadable(f"{where}.rotation has length {length}.")
    # A rotation that is unit up to float32 is taken as stored: exact quarter turns stay exact.
    if abs(length - 1) > 1e-6:
        x, y, z, w = x / length, y / length, z / length, w / length
    s = 2.0 / (x * x + y * y + z * z + w * w)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
        [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
        [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
    ]
    matrix[:3, :3] *= scale
    matrix[:3, 3] = shift
    return matrix
