"""What a shard may need, held against what was measured; and what a host has, read as the kernel writes it."""

import pytest
from farfield.memory import MIB, Need, free_bytes, memory_bytes, resident_bytes
from farfield.pipeline import STEPS
from farfield.stages import Stage

# Measured: MiB resident at most in the demo city (4,735 buildings), and MiB of what its stages wrote.
CITY = {
    "file": 7,
    "scene": 16,
    "hierarchy": 1,
    "rendertime": 0,
    "viewspace": 30,
    "candidates": 725,
    "placement": 27,
    "bake": 120,
}
PEAKS = {"scene": 313, "hierarchy": 284, "rendertime": 284, "viewspace": 348, "candidates": 1970, "placement": 1858, "bake": 930,
         "repair": 679, "placementdb": 1136}  # fmt: skip


@pytest.mark.parametrize("stage", PEAKS)
def test_estimates_are_above_what_the_demo_city_took(stage):
    step = STEPS[Stage(stage)]
    inputs = {str(s): CITY.get(str(s), 0) * MIB for s in step.inputs} or {"file": CITY["file"] * MIB}
    kind = "merge" if stage == "candidates" else "run"
    need = step.need.bytes(kind, inputs, CITY["candidates"] * MIB if kind == "merge" else 0)
    assert PEAKS[stage] * MIB <= need <= 8 * PEAKS[stage] * MIB


def test_a_need_grows_with_what_is_read_and_with_the_pieces_of_a_merge_only():
    need = Need(base_mib=100, factors={"scene": 3.0}, most_mib=1000)
    assert need.bytes("run", {}) == 100 * MIB
    assert need.bytes("run", {"scene": 10 * MIB, "views": 10 * MIB}) == (100 + 30 + 20) * MIB
    assert need.bytes("run", {}, 50 * MIB) == 100 * MIB
    assert need.bytes("merge", {}, 50 * MIB) == 250 * MIB
    assert need.bytes("merge", {}, 5000 * MIB) == 1000 * MIB


def _machine(root, *, total_kib=8_000_000, free_kib=6_000_000, cgroup="0::/"):
    (root / "proc/self").mkdir(parents=True)
    (root / "proc/meminfo").write_text(f"MemTotal: {total_kib} kB\nMemFree: 1 kB\nMemAvailable: {free_kib} kB\n")
    (root / "proc/self/cgroup").write_text(cgroup + "\n")
    return root


def test_without_a_cgroup_the_machine_is_the_limit(tmp_path):
    root = _machine(tmp_path)
    assert memory_bytes(root) == 8_000_000 * 1024
    assert free_bytes(root) == 6_000_000 * 1024


def test_a_container_has_what_the_smallest_cgroup_above_it_has(tmp_path):
    root = _machine(tmp_path, cgroup="0::/pods/ours")
    ours = root / "sys/fs/cgroup/pods/ours"
    ours.mkdir(parents=True)
    (ours / "memory.max").write_text("max\n")
    (ours.parent / "memory.max").write_text(f"{3 * 1024 * MIB}\n")
    (ours.parent / "memory.current").write_text(f"{2 * 1024 * MIB}\n")
    (ours.parent / "memory.stat").write_text(f"anon 1\ninactive_file {512 * MIB}\n")
    assert memory_bytes(root) == 3 * 1024 * MIB
    assert free_bytes(root) == (1024 + 512) * MIB  # the kernel drops pages of files first


def test_version_1_of_cgroups_is_read_too(tmp_path):
    root = _machine(tmp_path, cgroup="5:cpu:/x\n4:memory:/docker/abc")
    ours = root / "sys/fs/cgroup/memory/docker/abc"
    ours.mkdir(parents=True)
    (ours / "memory.limit_in_bytes").write_text(str(1024 * MIB))
    (ours / "memory.usage_in_bytes").write_text(str(1000 * MIB))
    assert memory_bytes(root) == 1024 * MIB
    assert free_bytes(root) == 24 * MIB


def test_this_machine_has_memory():
    assert 0 < resident_bytes() < memory_bytes()
    assert free_bytes() > 0
