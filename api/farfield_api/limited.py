"""`python -m farfield_api.limited BYTES SECONDS COMMAND...`: become COMMAND, within limits on memory, time and output.

A program of its own, because limits set between fork and exec in a process with threads may hang.
"""

import os
import resource
import sys


def main() -> None:
    memory_bytes, seconds, *command = sys.argv[1:]
    limits = {
        resource.RLIMIT_AS: int(memory_bytes),
        resource.RLIMIT_CPU: int(seconds),
        resource.RLIMIT_FSIZE: int(memory_bytes),
        resource.RLIMIT_CORE: 0,
    }
    for what, limit in limits.items():
        resource.setrlimit(what, (limit, limit))
    os.execv(command[0], command)


if __name__ == "__main__":
    main()
