"""Child processes of the launcher: started, watched, restarted, stopped; none outlives its parent."""

import ctypes
import os
import signal
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

PR_SET_PDEATHSIG = 1
LONGEST_PAUSE_S = 30.0
_libc = ctypes.CDLL(None, use_errno=True)


def die_with_parent() -> None:
    """Have the kernel end this process when the thread that started it ends."""
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


@dataclass(kw_only=True)
class Child:
    """One process that is to run as long as the launcher. `died` is told its environment when it ended by itself."""

    name: str
    command: Sequence[str]
    environment: Callable[[], Mapping[str, str]]  # asked at every start
    log: Path
    died: Callable[[Mapping[str, str]], None] = lambda environment: None
    keep_open: tuple[int, ...] = ()
    process: "subprocess.Popen[bytes] | None" = field(default=None, init=False)
    _given: Mapping[str, str] = field(default_factory=dict, init=False)
    _started_at: float = field(default=0.0, init=False)
    _pause_s: float = field(default=0.0, init=False)

    def start(self) -> None:
        self._given, self._started_at = self.environment(), time.monotonic()
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                self.command, env={**os.environ, **self._given}, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                start_new_session=True, preexec_fn=die_with_parent, pass_fds=self.keep_open,
            )  # fmt: skip

    def look(self) -> None:
        """Start the process again if it has ended: at once the first time, then with growing pauses."""
        now = time.monotonic()
        if self.process is not None and self.process.poll() is not None:
            self.process = None
            self.died(self._given)
            lived_s = now - self._started_at
            self._pause_s = 0.0 if lived_s > LONGEST_PAUSE_S else min(max(1.0, 2 * self._pause_s), LONGEST_PAUSE_S)
        if self.process is None and now >= self._started_at + self._pause_s:
            self.start()


def stop_children(children: Sequence[Child], *, seconds: float) -> None:
    """Ask every process to end (SIGTERM), and end those that have not after `seconds`: their shards run again."""
    running = [c.process for c in children if c.process is not None and c.process.poll() is None]
    for process in running:
        process.terminate()
    end = time.monotonic() + seconds
    for process in running:
        try:
            process.wait(max(0.0, end - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
