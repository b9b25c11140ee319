"""A level in which one object stands elsewhere: the same GLB, one node moved."""

import json
import struct
from pathlib import Path


def move_node(scene: Path, out: Path, *, node: int, by: tuple[float, float, float]) -> str:
    """Write the GLB `scene` to `out` with the mesh-bearing node of this number moved (file units); return its name."""
    data = scene.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    told, rest = json.loads(data[20 : 20 + length]), data[20 + length :]
    moved = [n for n in told["nodes"] if "mesh" in n][node]
    if "matrix" in moved:
        moved["matrix"][12:15] = [a + b for a, b in zip(moved["matrix"][12:15], by, strict=True)]
    else:
        moved["translation"] = [a + b for a, b in zip(moved.get("translation", (0, 0, 0)), by, strict=True)]
    text = json.dumps(told, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = data[:8] + struct.pack("<III", 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    out.write_bytes(head + text + rest)
    return str(moved.get("name", ""))
