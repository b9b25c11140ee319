"""How much memory a shard may take: an upper estimate from the sizes of what it reads, and what a host has.

Problem  Two shards that fit alone may not fit together. What a process will need is known only afterwards.
Method   need = base + sum of factor * bytes over the stage's inputs (+ pieces, for a merge). Inputs are memory maps, so a
         factor of 1 is what reading them once makes resident. Base and factors are those of `pipeline.STEPS`; the shards
         of a stage are cut to a bounded size, which the base pays for.
Errs     Upward: a host may stand partly idle; where an estimate was too low, the system's own limit is what it was
         before. tests/services/core/test_memory.py and the end-to-end tests hold estimates against measured peaks.
Measured MiB, resident, of which some 200 are Python and the kernels: scene 309 of a file of 7, 4,070 of 23 million vertices;
         visibility 621 of a town of 48 houses (the ray tracer), 2,524 of 10 million triangles; candidates 1,970 and
         placement 1,858 where the candidates are 725; bake 1,164, repair 889, bound 1,011, placementdb 1,230, evaluation
         1,098, proof 921: the largest of 40 levels.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

MIB = 1 << 20
HEADROOM = 0.9  # of a host's memory: the rest is the system's, and the service's own processes


@dataclass(frozen=True, slots=True)
class Need:
    """Memory of a stage's shards."""

    base_mib: int = 700
    factors: Mapping[str, float] = field(default_factory=dict)  # of input stages; "pieces": of a merge; else `other`
    other: float = 2.0
    most_mib: int | None = None  # where a limit of its own holds the shard

    def bytes(self, kind: str, inputs: Mapping[str, int], pieces: int = 0) -> int:
        """Return the estimate for a shard of `kind` (plan, run, merge, report).

        inputs  bytes of the artifacts that it maps, by stage
        pieces  bytes of the shards' artifacts that a merge joins
        """
        mapped = sum(self.factors.get(stage, self.other) * n_bytes for stage, n_bytes in inputs.items())
        joined = self.factors.get("pieces", 3.0) * pieces if kind == "merge" else 0.0
        need = self.base_mib * MIB + int(mapped + joined)
        return need if self.most_mib is None else min(need, self.most_mib * MIB)


def memory_bytes(root: Path = Path("/")) -> int:
    """Return what processes here may use together: the machine's memory, or less where a cgroup says so."""
    limits = [int(1024 * _meminfo(root, "MemTotal"))]
    for folder in _cgroups(root):
        for name in ("memory.max", "memory.limit_in_bytes"):
            text = _read(folder / name)
            if text.isdecimal():
                limits.append(int(text))
    return min(limits)


def free_bytes(root: Path = Path("/")) -> int:
    """Return what could be used now without swapping, by the machine and by every cgroup around us."""
    free = [int(1024 * _meminfo(root, "MemAvailable"))]
    for folder in _cgroups(root):
        for limit, used in (("memory.max", "memory.current"), ("memory.limit_in_bytes", "memory.usage_in_bytes")):
            most, now = _read(folder / limit), _read(folder / used)
            if most.isdecimal() and now.isdecimal():
                free.append(int(most) - int(now) + _reclaimable(folder))
    return max(0, min(free))


def resident_bytes(root: Path = Path("/")) -> int:
    """Return what this process holds by itself: files that it maps can be dropped."""
    for line in _read(root / "proc/self/status").splitlines():
        if line.startswith("RssAnon:"):
            return int(line.split()[1]) * 1024
    return 0


def _meminfo(root: Path, key: str) -> int:
    for line in _read(root / "proc/meminfo").splitlines():
        if line.startswith(key + ":"):
            return int(line.split()[1])
    return 1 << 53  # not Linux: no limit is known


def _reclaimable(folder: Path) -> int:
    """Pages of files, which the kernel drops before it kills anyone."""
    for line in _read(folder / "memory.stat").splitlines():
        name, _, value = line.partition(" ")
        if name in ("inactive_file", "total_inactive_file") and value.isdecimal():
            return int(value)
    return 0


def _cgroups(root: Path) -> list[Path]:
    """Return the folders of our memory cgroup and of those above it."""
    found = []
    for line in _read(root / "proc/self/cgroup").splitlines():
        _, controllers, path = (*line.split(":", 2), "", "")[:3]
        if controllers not in ("", "memory") and "memory" not in controllers.split(","):
            continue
        top = root / "sys/fs/cgroup" / ("memory" if controllers else "")
        at = top / path.strip("/")
        while at != top.parent and (at == top or top in at.parents):
            found.append(at)
            at = at.parent
    return found


def _read(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
