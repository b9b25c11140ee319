"""The table of variables names what the code reads, and nothing else."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
COMPOSED = {"FARFIELD_MAX_BYTES", "FARFIELD_MAX_JOBS", "FARFIELD_MAX_RUNNING"}  # from the fields of Quota


def test_every_variable_is_in_the_table():
    sources = [
        p.read_text() for folder in ("api", "services", "workers", "migrations") for p in (ROOT / folder).rglob("*.py")
    ]
    read = {name for text in sources for name in re.findall(r"\"(FARFIELD_[A-Z_]*[A-Z])\"", text)}
    read |= {f"FARFIELD_{name}" for text in sources for name in re.findall(r"number\(\"([A-Z_]+)\"", text)}
    table = re.findall(r"^\| (`FARFIELD_.*?) \|", (ROOT / "docs" / "deployment.md").read_text(), re.M)
    named = {name for cell in table for name in re.findall(r"FARFIELD_[A-Z_]+", cell)}
    assert read - named <= {"FARFIELD_FD"}
    assert named - read == COMPOSED
