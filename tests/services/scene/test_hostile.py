"""Hostile and broken files: each loads or is refused by name, within 10 s of a processor and 1 GiB; none crashes or leaks.

`--hostile` adds the files that take seconds each, and hundreds of mutants of every format.
"""

import os
from pathlib import Path

import farfield.errors
import numpy as np
import pytest
from hostile import BYTES, Judge, bases, mutants
from hostile_files import heavy_files, hostile_files

BAD = Path(os.environ.get("FARFIELD_SCENES", Path(__file__).resolve().parents[4] / "shared" / "scenes"))
NAMED = {name for name, value in vars(farfield.errors).items() if isinstance(value, type)} | {"loaded", "MemoryError"}


@pytest.fixture(scope="module")
def judge():
    made = Judge()
    yield made
    made.close()


@pytest.fixture
def judged(judge, tmp_path):
    """Judge the files; return {name: what became of it}, and fail with all that is wrong."""

    def run(files):
        found, wrong = {}, []
        for name, data in files:
            path = data if isinstance(data, Path) else tmp_path / name
            if path is not data:
                path.write_bytes(data)
            what, seconds, n_bytes = judge.verdict(path)
            if path is not data:
                path.unlink()
            found[name] = what
            if what not in NAMED or n_bytes > BYTES + (256 << 20):  # what the process has before it reads
                wrong.append(f"{name}: {what}, {seconds:.1f} s, {n_bytes >> 20} MiB")
        assert not wrong, "\n".join(wrong)
        return found

    return run


def test_files_made_to_hurt(judged):
    found = judged(hostile_files())
    assert len(found) > 180
    for name, what in {
        "laughs.glb": "SceneUnreadable", "cycle.glb": "SceneUnreadable", "deep.glb": "SceneOverLimit",
        "buffer-0.gltf": "SceneUriRefused", "buffer-1.gltf": "SceneUriRefused", "buffer-5.gltf": "SceneUriRefused",
        "lying-0.glb": "SceneOverLimit", "overlapping.zip": "SceneOverLimit", "in-zip.zip": "SceneUnreadable",
        "link.zip": "SceneUnreadable", "position-0.glb": "SceneNotFinite", "index-0.glb": "SceneIndexOutOfRange",
        "sparse-0.glb": "SceneIndexOutOfRange", "name-0.glb": "loaded", "name-1.glb": "loaded", "svg.glb": "loaded",
    }.items():  # fmt: skip
        assert found[name] == what, (name, found[name])


@pytest.mark.parametrize("name", bases())
def test_mutants(judged, request, name):
    n = 300 if request.config.getoption("--hostile") else 8
    mutant = mutants(bases()[name], np.random.default_rng(len(name)))
    found = judged([(name, bases()[name]), *((f"{i}-{name}", next(mutant)) for i in range(n))])
    assert found[name] == "loaded"


def test_files_made_to_take_long(judged, request):
    if not request.config.getoption("--hostile"):
        pytest.skip("takes minutes: --hostile")
    judged(heavy_files())


def test_bad_files_of_other_projects(judged, request):
    folder = BAD / "bad-input-examples"
    if not folder.is_dir():
        pytest.skip("the bad input examples are not there (FARFIELD_SCENES)")
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    if not request.config.getoption("--hostile"):
        files = files[::4]
    assert len(judged((str(p.relative_to(folder)), p) for p in files)) == len(files)
