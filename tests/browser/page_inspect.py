"""Stands where `farfield inspect` stands: a level that is JSON is described as a street of houses, or refused."""

import json
import sys
import time
from pathlib import Path

from PIL import Image

try:
    wish = json.loads(Path(sys.argv[-1]).read_text(encoding="utf-8"))
except ValueError:
    print("SceneUnreadable: the level is not a scene", file=sys.stderr)
    sys.exit(3)
time.sleep(wish.get("slow", 0.0))
houses = [
    {"id": i, "name": f"house_{i}", "calls": 1, "triangles": 120 + i, "replaceable": True,
     "box": [[x := 40.0 * (i % 15), 0.0, z := 60.0 * (i // 15)], [x + 28.0, 12.0 + i % 7, z + 20.0 + 20 * (i % 2)]]}
    for i in range(120)
]  # fmt: skip
described = {
    "objects": houses, "triangles": sum(h["triangles"] for h in houses), "calls": 120, "meshes": 31, "vertices": 9000,
    "bounds": [[0.0, 0.0, 0.0], [588.0, 18.0, 460.0]], "materials": [], "textures": [{"bytes": 120_000}] * 3,
    "dropped_triangles": 118, "warnings": ["ground_all is larger than two cells and was split into 12 objects"],
    "suggested": {
        "view_space": {"boxes": [[[20.0, 1.5, 20.0], [560.0, 1.8, 440.0]]], "cell_m": 16.0, "interval_deg": 11.25},
        "work": {"cells": 910, "directions": 1536, "views": 1_397_760, "seconds": 620.0},
        "budgets": ["48 calls", "8000 triangles", "16 ms"],
        "why": {
            "view_space.boxes": "a band 1.5 to 1.8 m above the ground, which lies under 98% of the level",
            "view_space.cell_m": "about a 48th of 520 m, the root of the ground's area",
            "view_space.interval_deg": "the smallest direction interval of the published method",
            "budgets": "two fifths of the fullest of 512 sampled views (120 calls)",
        },
    },
}  # fmt: skip
folder = Path(sys.argv[sys.argv.index("--out") + 1])
(folder / "inspect.json").write_text(json.dumps(described))
if wish.get("picture"):
    Image.new("RGB", (512, 401), (150, 160, 140)).save(folder / "picture.png")
counts = {key: len(described[key]) for key in ("objects", "materials", "textures")}
print(json.dumps({**described, **counts}))
