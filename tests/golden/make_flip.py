"""Write tests/golden/flip/flip.json: small pictures and what the flip-evaluator package says of them.

.venv/bin/python tests/golden/make_flip.py
"""

import base64
import json
from pathlib import Path

import flip_evaluator
import numpy as np

OUT = Path(__file__).parent / "flip" / "flip.json"


def pattern(width: int, height: int, seed: int) -> np.ndarray:
    """Return (height,width,3) u1, busy in every channel."""
    y, x, c = np.indices((height, width, 3))
    return ((x * (7 + c) + y * (13 - 2 * c) + seed * 31 * (c + 1)) ^ ((x // 5) * (y // 4) * (3 + c))).astype(np.uint8)


def pairs() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return truth and shown by name."""
    busy = pattern(48, 32, 1)
    block = busy.copy()
    block[10:20, 12:30] = 255 - block[10:20, 12:30] // 2
    grey = np.full((24, 40, 3), 128, np.uint8)
    dot = grey.copy()
    dot[11:13, 18:22] = (255, 0, 0)
    ramp = np.repeat(np.linspace(0, 255, 44).astype(np.uint8)[None, :, None], 20, 0).repeat(3, 2)
    return {
        "a block that differs": (busy, block),
        "a red dot on grey": (grey, dot),
        "two patterns": (busy, pattern(48, 32, 2)),
        "a ramp moved by a pixel": (ramp, np.roll(ramp, 1, 1)),
        "equal pictures": (busy, busy),
        "a picture smaller than the filters": (busy[:3, :5], block[12:15, 14:19]),
    }


def main() -> None:
    told = []
    for name, (truth, shown) in pairs().items():
        as_floats = [(p / 255).astype(np.float32) for p in (truth, shown)]
        error, mean, _ = flip_evaluator.evaluate(*as_floats, "LDR", applyMagma=False)
        height, width = truth.shape[:2]
        told.append({
            "name": name, "width": width, "height": height,
            "truth": base64.b64encode(np.ascontiguousarray(truth).tobytes()).decode(),
            "shown": base64.b64encode(np.ascontiguousarray(shown).tobytes()).decode(),
            "mean": round(float(mean), 7), "error": [round(float(e), 5) for e in error.reshape(-1)],
        })  # fmt: skip
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text("[\n" + ",\n".join(json.dumps(t, separators=(",", ":")) for t in told) + "\n]\n")


if __name__ == "__main__":
    main()
