"""Stands where `farfield inspect` stands, for scenes that are JSON: prints what was read, or a named error."""

import json
import sys
import time
from pathlib import Path

text = Path(sys.argv[-1]).read_text(encoding="utf-8")
try:
    scene = json.loads(text)
except ValueError:
    print(f"SceneUnreadable: {sys.argv[-1]} is not a scene", file=sys.stderr)
    sys.exit(3)
if scene.get("greedy"):
    bytearray(1 << 40)
time.sleep(scene.get("slow", 0.0))
described = {"objects": [{"id": 0}], "triangles": 12, "warnings": []}
folder = Path(sys.argv[sys.argv.index("--out") + 1])
(folder / "inspect.json").write_text(json.dumps(described))
(folder / "picture.png").write_bytes(b"\x89PNG toy")
print(json.dumps({**described, "objects": 1}))
