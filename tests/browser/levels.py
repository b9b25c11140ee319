"""A scene.glb for tests: one box an object, its id in extras, as `farfield place` writes it but by hand."""

import hashlib
import itertools
import json
import struct
from pathlib import Path

import numpy as np
from farfield.bake.shade import LIGHTING

_FACES = [(0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1)]


def _box() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return positions (24,3) in [0,1], normals (24,3), indices (36,)."""
    position, normal, index = [], [], []
    for axis, sign in _FACES:
        u, v = (axis + 1) % 3, (axis + 2) % 3
        if sign < 0:
            u, v = v, u
        first = len(position)
        for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
            p = np.zeros(3)
            p[axis], p[u], p[v] = sign > 0, a, b
            position.append(p)
            normal.append(np.eye(3)[axis] * sign)
        index += [first, first + 1, first + 2, first, first + 2, first + 3]
    return np.array(position, "<f4"), np.array(normal, "<f4"), np.array(index, "<u2")


def box_level(boxes: np.ndarray, *, notice: str = "") -> bytes:
    """Return a GLB with boxes (N,2,3), scene metres, in three materials."""
    position, normal, index = _box()
    parts = [position.tobytes(), normal.tobytes(), index.tobytes()]
    starts = np.cumsum([0, *[len(p) for p in parts]])
    nodes = []
    for i, (low, high) in enumerate(np.asarray(boxes, dtype=np.float64)):
        matrix = np.diag([*np.maximum(high - low, 1e-6), 1.0])
        matrix[:3, 3] = low
        nodes.append(
            {"name": f"house {i}", "mesh": i % 3, "extras": {"object": i}, "matrix": matrix.T.reshape(-1).tolist()}
        )
    colors = [[0.8, 0.7, 0.6, 1.0], [0.6, 0.3, 0.2, 1.0], [0.5, 0.5, 0.55, 1.0]]
    document = {
        "asset": {"version": "2.0", "copyright": notice},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes,
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "material": k}]}
            for k in range(3)
        ],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": c, "metallicFactor": 0.0}} for c in colors],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 24, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 1]},
            {"bufferView": 1, "componentType": 5126, "count": 24, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": int(a), "byteLength": int(b - a)} for a, b in itertools.pairwise(starts)
        ],
        "buffers": [{"byteLength": int(starts[-1])}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = b"".join(parts)
    body += b"\0" * (-len(body) % 4)
    total = 12 + 8 + len(text) + 8 + len(body)
    return (
        struct.pack("<4sII", b"glTF", 2, total) + struct.pack("<I4s", len(text), b"JSON") + text
        + struct.pack("<I4s", len(body), b"BIN\0") + body
    )  # fmt: skip


def give_level(folder: Path, level: bytes) -> None:
    """Write `scene.glb` beside a placement, and its digest and the bake's lighting into the manifest, sealed again."""
    (folder / "scene.glb").write_bytes(level)
    path = folder / "placement" / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["scene"] = {"file": "scene.glb", "sha256": hashlib.sha256(level).hexdigest()}
    manifest["lighting"] = LIGHTING
    manifest["geometry"] = None  # the viewer then takes the level from scene.glb
    manifest["manifest_sha256"] = "0" * 64
    text = json.dumps(manifest, sort_keys=True, separators=(",", ":")) + "\n"
    key = '"manifest_sha256":"'
    path.write_text(text.replace(key + "0" * 64, key + hashlib.sha256(text.encode()).hexdigest()))
