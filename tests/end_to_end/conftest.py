"""One `farfield place` of the city's cut-out for all tests here."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from cutout import city_cutout, demo_city


@dataclass(frozen=True, slots=True, kw_only=True)
class Ran:
    """One run of the command line."""

    code: int
    out: str
    err: str

    @property
    def document(self) -> Any:
        """What `--json` printed: the whole of stdout is one JSON document."""
        return json.loads(self.out)


def farfield(*words: object, seconds: float = 300) -> Ran:
    """Run `farfield ...` in a process of its own."""
    command = [sys.executable, "-m", "farfield.cli.main", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=seconds, check=False)
    return Ran(code=done.returncode, out=done.stdout, err=done.stderr)


@pytest.fixture(scope="session")
def run() -> Callable[..., Ran]:
    return farfield


@pytest.fixture(scope="session")
def level(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The cut-out, and settings that take seconds: 9 columns, 25 m over the streets so that far houses are in sight."""
    scene, _ = city_cutout()
    demo = demo_city()
    settings = tmp_path_factory.mktemp("level") / "settings.toml"
    boxes = demo.street_boxes(demo.read_city()[0], columns=(3, 3))
    boxes = [[[x, round(y + 25.0, 2), z] for x, y, z in box] for box in boxes]
    settings.write_text(demo.settings_text(boxes, budget="150 calls"))
    return scene, settings


@pytest.fixture(scope="session")
def placed(level: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """The folder and report of the cut-out, placed by two workers."""
    scene, settings = level
    folder = tmp_path_factory.mktemp("placed")
    ran = farfield("place", scene, "--settings", settings, "--workers", 2, "--json", "--out", folder)
    assert ran.code == 0, ran.err
    return folder, ran.document


@pytest.fixture(scope="session")
def files_of() -> Callable[[Path], dict[str, bytes]]:
    """Return what is in a folder: relative path -> content."""
    return lambda folder: {
        str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }
