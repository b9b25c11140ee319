"""Small made-up scene files for tests of the readers: a glTF document that is easy to break on purpose."""

import base64
import copy
import io
import json
from typing import Any

import numpy as np
from PIL import Image

BOX_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float32)
BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]], dtype=np.uint16)  # fmt: skip


def png(color: tuple[int, ...] = (255, 0, 0, 255), size: int = 4) -> bytes:
    """Return a plain PNG."""
    out = io.BytesIO()
    Image.new("RGBA", (size, size), color).save(out, "PNG")
    return out.getvalue()


class Gltf:
    """A glTF document under construction; `document` may be edited at will before it is written."""

    def __init__(self) -> None:
        self.body = bytearray()
        self.document: dict[str, Any] = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": []}], "nodes": [], "meshes": [],
            "accessors": [], "bufferViews": [],
        }  # fmt: skip

    def view(self, data: bytes, **more: Any) -> int:
        """Add a buffer view; return its index."""
        self.document["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.body), "byteLength": len(data), **more}
        )
        self.body += data + bytes(-len(data) % 4)
        return len(self.document["bufferViews"]) - 1

    def accessor(self, array: np.ndarray, **more: Any) -> int:
        """Add an accessor with a view of its own; return its index."""
        component = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}[array.dtype.str[1:]]
        kind = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[array.shape[1] if array.ndim == 2 else 1]
        row = {"componentType": component, "type": kind, "count": len(array)}
        if "bufferView" not in more:
            row["bufferView"] = self.view(np.ascontiguousarray(array).tobytes())
        self.document["accessors"].append(row | more)
        return len(self.document["accessors"]) - 1

    def primitive(self, position: np.ndarray, index: np.ndarray | None = None, **more: Any) -> dict[str, Any]:
        """Return a primitive; arrays in `more` with attribute names become attributes, everything else keys."""
        attributes = {"POSITION": self.accessor(np.asarray(position, dtype=np.float32))}
        attributes |= {k: self.accessor(v) for k, v in more.items() if isinstance(v, np.ndarray)}
        row = {"attributes": attributes} | {k: v for k, v in more.items() if not isinstance(v, np.ndarray)}
        if index is not None:
            row["indices"] = self.accessor(np.asarray(index).reshape(-1))
        return row

    def mesh(self, *primitives: dict[str, Any]) -> int:
        """Add a mesh; return its index."""
        self.document["meshes"].append({"primitives": list(primitives)})
        return len(self.document["meshes"]) - 1

    def node(self, *, root: bool = True, **more: Any) -> int:
        """Add a node; return its index."""
        self.document["nodes"].append(more)
        i = len(self.document["nodes"]) - 1
        if root:
            self.document["scenes"][0]["nodes"].append(i)
        return i

    def add(self, kind: str, row: dict[str, Any]) -> int:
        """Add a row to any list of the document; return its index."""
        self.document.setdefault(kind, []).append(row)
        return len(self.document[kind]) - 1

    def glb(self) -> bytes:
        """Return the document as GLB."""
        document = copy.deepcopy(self.document)
        document.setdefault("buffers", [{"byteLength": len(self.body)}])
        return pack_glb(json.dumps(document).encode(), bytes(self.body))

    def gltf(self, uri: str | None = None) -> bytes:
        """Return the document as JSON, its buffer at `uri` or in a data: address."""
        document = copy.deepcopy(self.document)
        uri = uri or "data:application/octet-stream;base64," + base64.b64encode(self.body).decode()
        document.setdefault("buffers", [{"byteLength": len(self.body), "uri": uri}])
        return json.dumps(document).encode()


def pack_glb(text: bytes, body: bytes) -> bytes:
    """Return a GLB of a JSON and a binary chunk."""
    text += b" " * (-len(text) % 4)
    body += bytes(-len(body) % 4)
    word = lambda n: n.to_bytes(4, "little")  # noqa: E731
    head = b"glTF" + word(2) + word(28 + len(text) + len(body)) + word(len(text)) + b"JSON" + text
    return head + word(len(body)) + b"BIN\0" + body


def box_level() -> Gltf:
    """A textured box and an instance of it under a nested, mirrored transform, and a coloured triangle fan."""
    level = Gltf()
    image = level.view(png())
    level.add("images", {"bufferView": image, "mimeType": "image/png"})
    level.add("samplers", {"wrapS": 33071, "wrapT": 33648, "magFilter": 9728})
    level.add("textures", {"source": 0, "sampler": 0})
    level.add("materials", {"name": "brick", "pbrMetallicRoughness": {
        "baseColorFactor": [0.5, 0.25, 0.125, 1], "baseColorTexture": {"index": 0}}})  # fmt: skip
    level.add("materials", {"name": "leaf", "alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": True})
    uv = BOX_CORNERS[:, :2].copy()
    box = level.mesh(level.primitive(BOX_CORNERS, BOX_FACES, TEXCOORD_0=uv, material=0))
    level.node(name="house", mesh=box, translation=[3, 0, 0])
    child = level.node(root=False, name="mirror", mesh=box, scale=[-1, 2, 1])
    level.node(name="group", children=[child], rotation=[0, 0.7071067811865476, 0, 0.7071067811865476])
    ring = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
    color = np.array([[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 255, 255]], dtype=np.uint8)
    fan = level.primitive(ring, None, mode=6, material=1)
    fan["attributes"]["COLOR_0"] = level.accessor(color, normalized=True)
    level.node(name="leaf", mesh=level.mesh(fan), translation=[-4, 0, 2])
    return level
