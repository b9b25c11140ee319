"""Run a command and measure what its whole tree of processes takes."""

import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

EVERY_S = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """`peak_bytes` is the largest sum over the tree of what each process holds: a page shared by n counts 1/n each."""

    code: int
    out: str
    err: str
    seconds: float  # wall clock
    peak_bytes: int


def run(command: Sequence[str], *, timeout_s: float) -> Measured:
    """Run the command to its end; raises subprocess.TimeoutExpired, and ends it then."""
    began = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    peak, ended = [0], threading.Event()

    def watch() -> None:
        while not ended.wait(EVERY_S):
            peak[0] = max(peak[0], sum(map(held_bytes, tree(process.pid))))

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        out, err = process.communicate(timeout=timeout_s)
    finally:
        ended.set()
        watcher.join()
        process.kill()
    seconds = time.monotonic() - began
    return Measured(code=process.returncode, out=out, err=err, seconds=seconds, peak_bytes=peak[0])


def farfield(*words: str) -> Measured:
    """Run a command of farfield with this Python."""
    return run([sys.executable, "-m", "farfield.cli.main", *words], timeout_s=1800)


def tree(pid: int) -> list[int]:
    """Return the process and all that descend from it."""
    found = [pid]
    for parent in found:
        for task in Path(f"/proc/{parent}/task").glob("*/children"):
            try:
                found += map(int, task.read_text().split())
            except OSError:  # it has ended
                continue
    return found


def held_bytes(pid: int) -> int:
    """Return the proportional set size of a process, 0 once it has ended."""
    try:
        rows = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return next((int(row.split()[1]) * 1024 for row in rows if row.startswith("Pss:")), 0)
