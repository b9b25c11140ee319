"""What one process holds while it bakes a cluster of millions of triangles: `python -m benchmarks.bake_memory KIND ...`.

    field N [RENDERER [MOST]]         a made-up rough field of N million triangles, one object
    artifact FILE [RENDERER [MOST]]   all objects of a scene artifact
    read LEVEL FILE                   write the artifact of a level (a process of its own: reading takes more)

The scene is a memory map, as for a shard. Prints one line of JSON: triangles, layers, seconds of CPU, and peaks in MiB:
`resident` (VmHWM: mapped files count), `own` (largest anonymous memory seen, every 20 ms), of the process and of its child
that draws.
"""

import json
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from farfield.bake import beside, thin
from farfield.bake.bake import bake_batch
from farfield.bake.gl.apart import child
from farfield.candidates.model import BOX
from farfield.columns import dataclass_parts, release, unpack_dataclass
from farfield.executor import map_file, reset_peak, write_parts
from farfield.hierarchy.build import build_hierarchy
from farfield.rendertime.cost import build_cost_model
from farfield.scene.model import Scene
from farfield.scene.read import read_scene
from farfield.settings import Settings
from panels import box_cell, chosen, field

MIB = 1 << 20


def main(kind: str, what: str, *more: str) -> None:
    if kind == "read":
        write_parts(dataclass_parts(read_scene(Path(what), settings=Settings())), Path(more[0]))
        return
    renderer, most = (more[0] if more else "egl"), int(more[1]) if len(more) > 1 else thin.MOST
    thin.MOST, beside.BATCH = most, min(most, beside.BATCH)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(what)
        if kind == "field":
            path = Path(folder) / "scene.ffc"
            write_parts(dataclass_parts(field(round((float(what) * 5e5) ** 0.5))), path)
        scene = unpack_dataclass(Scene, map_file(path))
        low, high = scene.object_box[:, 0].min(0), scene.object_box[:, 1].max(0)
        far = float((high - low).max())
        middle = np.array([(low[0] + high[0]) / 2, high[1] + far, high[2] + 2 * far])
        cell = box_cell(tuple(middle - far / 50), tuple(middle + far / 50))
        settings = Settings()
        model, hierarchy = build_cost_model(scene, settings=settings), build_hierarchy(scene)
        release(scene.position)
        reset_peak()  # of the model and the hierarchy, which other stages make
        seen: dict[str, int] = {}
        over = threading.Event()
        watch = threading.Thread(target=_watch, args=(over, seen))
        watch.start()
        begin = time.process_time()
        baked = bake_batch(
            scene, hierarchy, model, chosen([0], BOX, cell), settings=settings, impostors=(0, 1), renderer=renderer
        )
        seconds = time.process_time() - begin
        over.set()
        watch.join()
    print(json.dumps({
        "triangles": int(scene.object_triangles.sum()), "objects": scene.n_objects, "layers": len(baked.plane),
        "texels": baked.tile_data.size // 4, "renderer": renderer, "most": most, "cpu_s": round(seconds, 1),
        **{f"{key}_mib": value // MIB for key, value in sorted(seen.items())},
    }))  # fmt: skip


def _watch(over: threading.Event, seen: dict[str, int]) -> None:
    while not over.wait(0.02):
        drawing = child()._process
        for name, process in (("", "self"), ("child_", None if drawing is None else drawing.pid)):
            try:
                lines = Path(f"/proc/{process}/status").read_text().splitlines()
            except OSError:
                continue
            held = {key: int(value.split()[0]) * 1024 for key, value in (line.split(":", 1) for line in lines)
                    if key in ("VmHWM", "RssAnon")}  # fmt: skip
            for key, row in (("resident", "VmHWM"), ("own", "RssAnon")):
                seen[name + key] = max(seen.get(name + key, 0), held.get(row, 0))


if __name__ == "__main__":
    main(*sys.argv[1:])
