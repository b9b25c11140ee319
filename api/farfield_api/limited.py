"""`python -m farfield_api.limited BYTES SECONDS COMMAND...`: become COMMAND, within limits on memory, time, files and output.

A program of its own, because limits set between fork and exec in a process with threads may hang.
"""

import ctypes
import os
import resource
import signal
import sys

PR_SET_PDEATHSIG, CLONE_NEWUSER, CLONE_NEWNET = 1, 0x10000000, 0x40000000


def main() -> None:
    memory_bytes, seconds, *command = sys.argv[1:]
    libc = ctypes.CDLL(None)
    libc.unshare(CLONE_NEWUSER | CLONE_NEWNET)  # no network, where the kernel lets us: an addition to the rest
    libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # after it, because new credentials clear it
    limits = {
        resource.RLIMIT_AS: int(memory_bytes),
        resource.RLIMIT_CPU: int(seconds),
        resource.RLIMIT_FSIZE: int(memory_bytes),
        resource.RLIMIT_NOFILE: 256,
        resource.RLIMIT_CORE: 0,
    }
    for what, limit in limits.items():
        most = resource.getrlimit(what)[1]
        limit = limit if most == resource.RLIM_INFINITY else min(limit, most)
        resource.setrlimit(what, (limit, limit))
    os.execv(command[0], command)


if __name__ == "__main__":
    main()
