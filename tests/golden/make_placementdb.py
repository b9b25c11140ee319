"""Write tests/golden/placementdb, placementdb-visible, placementdb-detail and placementdb-ktx2:

    PYTHONPATH=tests .venv/bin/python tests/golden/make_placementdb.py

Run it after a change of the format (raise VERSION in farfield/placementdb/layout.py, change the TypeScript reader). The
expected answers come from tests/naive/placementdb.py, not from either reader.

    manifest.json, index-*, chunks/, pages/    a placement database (geometry/ and textures/ but for -detail)
    lookups.json    "lookups": [{position, direction, cell, interval, problem_view, hopeless, objects, levels,
                    impostors, cost_bound}], "columns": {file: {column: SHA-256}} of squeezed files,
                    "outside": [positions to refuse], "bad_directions": [directions to refuse]
"""

import hashlib
import json
import shutil
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from farfield.placementdb.squeeze import expand
from farfield.placementdb.write import build_files
from naive.placementdb import lookup
from placements import made_up

HERE = Path(__file__).parent
# Two boxes that share a face, one that stands apart, and one that is flat.
BOXES = np.array([
    [[-32.0, 1.0, -32.0], [32.0, 3.0, 32.0]], [[32.0, 1.0, -8.0], [48.0, 3.0, 8.0]],
    [[-80.0, 1.0, 40.0], [-56.0, 5.0, 48.0]], [[-48.0, 2.0, -48.0], [-40.0, 2.0, -36.0]],
])  # fmt: skip
GOLDEN: dict[str, dict[str, Any]] = {
    "placementdb": {"n_objects": 24, "budget": 21, "view_boxes": BOXES, "share": 0.03, "seed": 3},
    "placementdb-visible": {
        "n_objects": 17, "n_impostors": 6, "budget": 16, "view_boxes": BOXES, "visible": True, "wide": False, "seed": 5,
        "origin_m": (1e6 + 0.1, 5.3, -2e6 - 0.7),
    },
    "placementdb-detail": {
        "n_objects": 20, "n_impostors": 5, "budget": 18, "view_boxes": BOXES, "detail": True, "wide": False, "seed": 8,
    },
    "placementdb-ktx2": {
        "n_objects": 12, "n_impostors": 4, "budget": 10, "view_boxes": BOXES, "wide": False, "seed": 9,
        "page_format": "ktx2",
    },
}  # fmt: skip


def make(name: str) -> tuple[dict[str, bytes], dict[str, Any]]:
    """Return (files of the tree, content of lookups.json) of one golden placement."""
    made = made_up(**GOLDEN[name])
    files = build_files(**made)
    return files, {
        "columns": _columns(files),
        "lookups": [
            {"position": p.tolist(), "direction": d.tolist(), **answer}
            for p, d in _questions(made)
            if (answer := lookup(made, p, d)) is not None
        ],
        "outside": [p.tolist() for p, d in _questions(made) if lookup(made, p, d) is None],
        "bad_directions": [[0, 0, 0], [0.0, -0.0, 0.0]],
    }


def _columns(files: dict[str, bytes]) -> dict[str, dict[str, str]]:
    """Return the SHA-256 of every column of every squeezed file, as it is when put together again."""
    out = {}
    for name in sorted(n for n in files if n.endswith(".ffz")):
        plain = zlib.decompress(files[name])
        columns = expand(files[name], len(plain))[1]
        out[name] = {key: hashlib.sha256(a.tobytes()).hexdigest() for key, a in sorted(columns.items())}
    return out


def _questions(made: dict[str, Any]) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(11)
    scene, cells, views = made["scene"], made["cells"], made["views"]
    boxes = scene.view_boxes + scene.origin_m
    out = []
    for v in rng.permutation(len(views.cell))[:40]:  # inside problem views
        low, high = cells.cell_box[views.cell[v]] + scene.origin_m
        out.append((low + (high - low) * rng.uniform(0.05, 0.95, 3), _direction(int(views.interval[v]), rng)))
    for low, high in boxes:
        out += [(low + (high - low) * rng.random(3), rng.normal(size=3)) for _ in range(8)]
        corners = [np.where([k & 1, k & 2, k & 4], high, low) for k in range(8)]
        out += [(corner, rng.normal(size=3) * 10.0 ** rng.integers(-3, 4)) for corner in corners]
        out += [(corner + np.array([0.0, 9.0, 0.0]), np.array([1.0, 0.0, 0.0])) for corner in corners[:2]]
    middle = boxes[0].mean(0)
    for d in (
        [1, 1, 1],
        [-1, 1, -1],
        [0, 1, 0],
        [0, -2, 0],
        [1, 0, 0],
        [0, 0, -1e-30],
        [1, 0, 1],
        [-3, -3, 0],
        [1e200, -1e200, 5],
    ):
        out.append((middle, np.array(d, dtype=np.float64)))
    for plane in cells.plane[cells.axis == 0]:  # on the planes of the tree
        out.append((np.array([plane + scene.origin_m[0], middle[1], middle[2]]), rng.normal(size=3)))
    return out


def _direction(interval: int, rng: np.random.Generator) -> np.ndarray:
    face, i, j = interval // 64, interval % 8, interval // 8 % 8
    angle = (np.array([i, j]) + rng.uniform(0.1, 0.9, 2)) * (np.pi / 16) - np.pi / 4
    d = np.empty(3)
    m = face // 2
    d[m], d[(m + 1) % 3], d[(m + 2) % 3] = (1, -1)[face % 2], *np.tan(angle)
    return d * rng.uniform(0.5, 20)


if __name__ == "__main__":
    for golden in GOLDEN:
        files, lookups = make(golden)
        shutil.rmtree(HERE / golden, ignore_errors=True)
        for file, content in files.items():
            (HERE / golden / file).parent.mkdir(parents=True, exist_ok=True)
            (HERE / golden / file).write_bytes(content)
        (HERE / golden / "lookups.json").write_text(json.dumps(lookups, sort_keys=True, separators=(",", ":")) + "\n")
        print(golden, sum(map(len, files.values())), len(lookups["lookups"]), len(lookups["outside"]))
