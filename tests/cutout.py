"""A cut-out of the demo city for tests: the buildings of its middle and the terrain under them, some 400 objects.

Built once from the scene files of the `sionna-rt` wheel and kept under `.cache/tests`; tests skip where it is missing.
"""

import hashlib
import importlib.util
import os
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
_SCRIPT = ROOT / "infra" / "demo" / "san_francisco.py"
SIDE_M = 322.0  # of the square, 14 columns of 23 m
COLUMNS = (6, 6)
BUDGET = "110 calls"


@cache
def demo_city() -> ModuleType:
    """Return the demo's script as a module."""
    spec = importlib.util.spec_from_file_location("farfield_demo_san_francisco", _SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def city_cutout() -> tuple[Path, Path]:
    """Return the paths of the cut-out's GLB and of its settings (TOML). Skips the test where the wheel is missing."""
    demo = demo_city()
    try:
        demo.folder()
    except demo.WheelMissing as error:
        pytest.skip(str(error))
    digest = hashlib.sha256(_SCRIPT.read_bytes() + Path(__file__).read_bytes()).hexdigest()[:16]
    cached = ROOT / ".cache" / "tests"
    scene, settings = cached / f"cutout-{digest}.glb", cached / f"cutout-{digest}.toml"
    if scene.exists() and settings.exists():
        return scene, settings
    cached.mkdir(parents=True, exist_ok=True)
    city, materials = demo.read_city()
    middle = np.rint(demo.center(city)[[0, 2]] / demo.CELL_M) * demo.CELL_M
    low, high = middle - SIDE_M / 2, middle + SIDE_M / 2
    boxes = demo.street_boxes(city, columns=COLUMNS)
    terrain = city.meshes[next(n for n in city.nodes if n.name == "Terrain").mesh][0]
    centers = terrain.position[terrain.index][:, :, [0, 2]].astype(np.float64).mean(1)
    used, index = np.unique(
        terrain.index[((centers >= low) & (centers <= high)).all(1)].reshape(-1), return_inverse=True
    )
    terrain.position, terrain.index = terrain.position[used], index.reshape(-1, 3)

    def keep(name: str, box: np.ndarray) -> bool:
        return name == "Terrain" or bool((box[0, [0, 2]] >= low).all() and (box[1, [0, 2]] <= high).all())

    # Several test processes may come here at once: each writes its own file, the last rename wins, all are equal.
    temporary = scene.with_suffix(f".{os.getpid()}")
    demo.write_city(temporary, city, materials, keep)
    temporary.replace(scene)
    temporary.write_text(demo.settings_text(boxes, budget=BUDGET), encoding="utf-8")
    temporary.replace(settings)
    return scene, settings
