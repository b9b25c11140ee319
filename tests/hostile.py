"""A corpus of broken and hostile levels, and a judge that reads each in a process of its own.

`python hostile.py` reads one path a line on stdin and prints what became of it as JSON: a name of `farfield.errors`, "loaded",
or what must not be: "crash ...", "hang", "leak ...". The process forks for each file, after it has loaded what reading needs.
"""

import io
import json
import os
import resource
import select
import signal
import socket
import struct
import subprocess
import sys
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

SECONDS, BYTES = 10, 1 << 30  # of a processor; and beyond what the process has before it reads
WALL_S = 120.0  # a machine may be busy


class Judge:
    """Asks the process; `verdict` says what became of one file, in how many processor seconds and bytes."""

    def __init__(self) -> None:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, str(Path(__file__).resolve())]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    def verdict(self, path: Path) -> tuple[str, float, int]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(path, file=self._process.stdin, flush=True)
        what, seconds, n_bytes = json.loads(self._process.stdout.readline())
        return what, seconds, n_bytes

    def close(self) -> None:
        self._process.communicate()


def _serve() -> None:
    from farfield.cli.place import load_settings
    from farfield.scene.describe import describe, summary
    from farfield.scene.picture import picture_from_above
    from farfield.scene.read import inspect_scene
    from levels import box_level

    settings = load_settings(None, None)

    def read(path: Path) -> None:
        scene, suggestion = inspect_scene(path, settings=settings)
        document = describe(scene, suggestion)
        json.dumps(summary(document), allow_nan=False, ensure_ascii=False).encode()
        json.dumps(document, allow_nan=False, ensure_ascii=False).encode()
        picture_from_above(scene)
        assert np.isfinite(scene.object_box).all()
        assert 0 <= scene.index.min() <= scene.index.max() < len(scene.position)

    warm = Path(os.environ.get("TMPDIR", "/tmp")) / f"hostile-{os.getpid()}.glb"
    warm.write_bytes(box_level().glb())
    read(warm)
    warm.unlink()
    print("ready", flush=True)
    for line in sys.stdin:
        print(json.dumps(_forked(read, Path(line.rstrip("\n")))), flush=True)


def _forked(read: Callable[[Path], None], path: Path) -> tuple[str, float, int]:
    before = sorted(p.name for p in path.parent.iterdir())
    ours, theirs = os.pipe()
    started = time.monotonic()
    child = os.fork()
    if child == 0:
        os.close(ours)
        _judge(read, path, theirs)
    os.close(theirs)
    answer = b""
    while select.select([ours], [], [], max(0.0, started + WALL_S - time.monotonic()))[0]:
        if not (piece := os.read(ours, 65536)):
            break
        answer += piece
    else:
        os.kill(child, signal.SIGKILL)
        answer = b"hang"
    os.close(ours)
    _, status, usage = os.wait4(child, 0)
    timed_out = os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL)
    what = answer.decode() or ("hang" if timed_out else f"crash by status {status}")
    if sorted(p.name for p in path.parent.iterdir()) != before:
        what = "leak of a file"
    return what, usage.ru_utime + usage.ru_stime, usage.ru_maxrss << 10


def _judge(read: Callable[[Path], None], path: Path, answer: int) -> None:
    from farfield.errors import FarfieldError

    pages = [int(n) << 12 for n in Path("/proc/self/statm").read_text().split()[:2]]
    limit = pages[0] - pages[1] + BYTES  # what is mapped but never touched is not ours
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    socket.socket = socket.create_connection = None  # type: ignore[assignment, misc]
    try:
        read(path)
        what = "loaded"
    except FarfieldError as error:
        what = error.code
        if str(path.parent) in str(error) or "Traceback" in str(error) or len(str(error)) > 2000 or "\n" in str(error):
            what = f"leak by {error.code}: {str(error)[:300]}"
    except MemoryError:
        what = "MemoryError"  # `farfield inspect` and the workers give it its name
    except BaseException as error:
        import traceback

        what = f"crash by {error!r:.200} {traceback.format_exc(limit=-2)[-400:]}"
    os.write(answer, what.encode("utf-8", "replace"))
    os._exit(0)


def mutants(base: bytes, rng: np.random.Generator) -> Iterator[bytes]:
    """Yield `base` cut, flipped, with a number made huge, a part doubled, dropped, zeroed, or swapped."""
    n = len(base)
    at = lambda: int(rng.integers(n))  # noqa: E731
    while True:
        data = bytearray(base)
        for _ in range(int(rng.integers(1, 4))):
            a, b = sorted((at(), at()))
            b = min(b, a + int(rng.integers(1, 200)))
            match int(rng.integers(8)):
                case 0:
                    del data[at() :]
                case 1 | 2:
                    for _ in range(int(rng.integers(1, 10))):
                        if data:
                            data[at() % len(data)] ^= 1 << int(rng.integers(8))
                case 3:
                    extremes = [2**32 - 1, 2**31, 2**31 - 1, 0, 0x7FC00000, 0x7F800000]
                    data[a : a + 4] = struct.pack("<I", int(rng.choice(extremes)))
                case 4:
                    data[a:a] = data[a:b] * int(rng.integers(1, 50))
                case 5:
                    del data[a:b]
                case 6:
                    data[a:b] = bytes(b - a)
                case 7:
                    data[a:b] = rng.choice(
                        [b"-1", b"1e999", b"9" * 30, b"nan", b'"../../x"', b"[[", b"\xff\xfe", b"\0"]
                    )
        yield bytes(data)


def bases() -> dict[str, bytes]:
    """Return whole small levels, one of each format, by file name."""
    from levels import box_level, png

    obj = (
        b"mtllib a.mtl\no box\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0.5\nvt 0 0\nvn 0 0 1\nusemtl m\nf 1/1/1 2/1/1 3/1/1 4/1/1\n"
        * 3
    )
    mtl = b"newmtl m\nKd 1 0 0\nd 0.5\nmap_Kd -s 2 2 a.png\n"
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype="<f4")
    head = (
        "ply\nformat {} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    faces = b"\3" + np.arange(3, dtype="<i4").tobytes() + b"\4" + np.arange(4, dtype="<i4").tobytes()
    stl = bytes(80) + struct.pack("<I", 2) + 2 * (bytes(12) + corners[:3].tobytes() + bytes(2))
    ascii_stl = (
        b"solid a\n"
        + 2 * b"facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    )
    return {
        "a.glb": box_level().glb(),
        "a.gltf": box_level().gltf(),
        "a.obj": obj,
        "binary.ply": head.format("binary_little_endian").encode() + corners.tobytes() + faces,
        "ascii.ply": (head.format("ascii") + "0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n4 0 1 2 3\n").encode(),
        "binary.stl": stl,
        "ascii.stl": ascii_stl + b"endsolid a\n",
        "a.zip": zipped({"in/a.obj": obj, "in/a.mtl": mtl, "in/a.png": png()}),
        "b.zip": zipped({"a.glb": box_level().glb()}),
    }


def zipped(entries: dict[str, bytes], *, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """Return a zip of these entries."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as z:
        for name, data in entries.items():
            z.writestr(name, data)
    return out.getvalue()


def lying_png(width: int, height: int, *, rows: bytes = b"") -> bytes:
    """Return a PNG that claims a size and has other data."""
    chunk = lambda kind, body: struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))  # noqa: E731
    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


if __name__ == "__main__":
    _serve()
