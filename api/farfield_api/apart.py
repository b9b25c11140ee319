"""Files of strangers, read in a process with limits: what crashes or stalls there costs one request.

Limits   memory, processor seconds, wall clock, files and their size (`limited.py`); the answer's own size, here.
         The process has no network, a temporary folder of its own, and none of our environment but what Python needs: it
         learns no secret and no address. It is ended with its group, and by the kernel when we are.
Slots    Two processes at a time for scenes, and one for samples: a long level holds up no calibration.
"""

import asyncio
import json
import os
import re
import signal
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from farfield import errors
from farfield.errors import FarfieldError, SceneOverLimit, SceneUnreadable

from farfield_api.errors import InputRefused
from farfield_api.settings import ApiSettings

ANSWER_BYTES = 16 << 20
TOLD_BYTES = 1 << 16  # of what it says of a refusal
KEPT = re.compile(r"(PATH|HOME|LANG|TZ|LC_\w+|LD_LIBRARY_PATH|PYTHON\w+|NUMBA_\w+|VIRTUAL_ENV|COVERAGE_\w+)")
SCENES, SAMPLES = asyncio.Semaphore(2), asyncio.Semaphore(1)


async def read_apart(reader: Sequence[str], path: Path, shown: str, settings: ApiSettings) -> dict[str, Any]:
    """Return what the command `reader` says of the file, as JSON. Raises InputRefused with its error's name,
    SceneOverLimit. Whoever asks holds a slot of the semaphore for what is read.

    path   alone in its folder, which is the process's temporary folder, too
    shown  what to call the file
    """
    limits = [str(settings.inspect_memory_bytes), str(settings.inspect_seconds)]
    command = [reader[0], "-m", "farfield_api.limited", *limits, *reader, str(path)]
    kept = {name: value for name, value in os.environ.items() if KEPT.fullmatch(name)}
    said, told = path.with_name("said.json"), path.with_name("told.txt")
    with said.open("wb") as out, told.open("wb") as err:
        child = await asyncio.create_subprocess_exec(
            *command, stdin=asyncio.subprocess.DEVNULL, stdout=out, stderr=err, start_new_session=True,
            env={**kept, "TMPDIR": str(path.parent), "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
    try:
        await asyncio.wait_for(child.wait(), settings.inspect_seconds)
    except TimeoutError:
        raise SceneOverLimit(f"reading {shown} took more than {settings.inspect_seconds} s") from None
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        await child.wait()
    if child.returncode == 0:
        if said.stat().st_size > ANSWER_BYTES:
            raise SceneOverLimit(f"what there is to say of {shown} takes more than {ANSWER_BYTES} bytes")
        found = json.loads(said.read_bytes())
        assert isinstance(found, dict)
        return found
    with told.open("rb") as file:
        raise _refusal(file.read(TOLD_BYTES).decode(errors="replace"), path, shown)


def _refusal(text: str, path: Path, shown: str) -> FarfieldError:
    """Return the named error in the text. What has no name was a crash, or the end by a limit."""
    replaced = text.replace(str(path), shown).replace(str(path.parent) + "/", "").replace(path.name, shown)
    lines = replaced.splitlines()
    for i, line in enumerate(lines):
        match = re.fullmatch(r"(\w+): (.+)", line)
        known = getattr(errors, match[1], None) if match else None
        if match and isinstance(known, type) and issubclass(known, FarfieldError):
            return InputRefused(match[1], match[2], known.advice or "\n".join(lines[i + 1 :]))
    if "MemoryError" in text or not text.strip():
        return SceneOverLimit(f"reading {shown} needs more memory or time than is allowed")
    return SceneUnreadable(f"{shown} cannot be read")
