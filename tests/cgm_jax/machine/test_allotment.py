"""What a process was given, from the files and variables of made-up machines."""

import os
from pathlib import Path

import pytest

from cgm_jax.machine.allotment import available_cores, free_memory

MEBIBYTE = 2**20


def write(root: Path, **files: str) -> Path:
    """Make files; a name's "__" stands for "/" and its last "_" before a suffix stays."""
    for name, text in files.items():
        path = root / name.replace("__", "/").replace("DOT", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


@pytest.fixture
def many(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that may run on 64 cores."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(64)), raising=False)


@pytest.mark.usefixtures("many")
def test_cores_are_the_least_of_all_that_limit_them(tmp_path: Path) -> None:
    assert available_cores(tmp_path, {}) == 64
    assert available_cores(tmp_path, {"SLURM_CPUS_PER_TASK": "6"}) == 6
    assert available_cores(tmp_path, {"SLURM_CPUS_PER_TASK": "100"}) == 64
    assert available_cores(tmp_path, {"SLURM_CPUS_PER_TASK": "many"}) == 64
    write(
        tmp_path,
        proc__self__cgroup="0::/job/step\n",
        sys__fs__cgroup__job__cpuDOTmax="350000 100000\n",
        sys__fs__cgroup__job__step__cpuDOTmax="max 100000\n",
    )
    assert available_cores(tmp_path, {}) == 4  # three and a half, from the group around its own
    assert available_cores(tmp_path, {"SLURM_CPUS_PER_TASK": "2"}) == 2
    write(tmp_path, sys__fs__cgroup__job__cpuDOTmax="1000 100000\n")
    assert available_cores(tmp_path, {}) == 1


@pytest.mark.usefixtures("many")
def test_cores_of_a_group_of_version_1_in_a_container(tmp_path: Path) -> None:
    folder = "sys__fs__cgroup__cpu__"
    write(
        tmp_path,
        proc__self__cgroup="4:cpuset:/\n3:cpu,cpuacct:/docker/0123/not/seen/here\n",
        **{f"{folder}cpuDOTcfs_quota_us": "200000\n", f"{folder}cpuDOTcfs_period_us": "100000\n"},
    )
    assert available_cores(tmp_path, {}) == 2
    write(tmp_path, **{f"{folder}cpuDOTcfs_quota_us": "-1\n"})
    assert available_cores(tmp_path, {}) == 64


def test_memory_is_the_least_of_all_that_limit_it(tmp_path: Path) -> None:
    write(
        tmp_path,
        proc__meminfo="MemTotal: 9000 kB\nMemAvailable:    8000000 kB\nHugePages_Total: 0\n",
        proc__self__status="Name: python\nVmRSS:\t 102400 kB\n",
    )
    assert free_memory(tmp_path, {}) == 8_000_000 * 1024
    assert free_memory(tmp_path, {"SLURM_MEM_PER_NODE": "4096"}) == (4096 - 100) * MEBIBYTE
    assert free_memory(tmp_path, {"SLURM_MEM_PER_NODE": "0"}) == 8_000_000 * 1024  # all of it
    per_core = {"SLURM_MEM_PER_CPU": "1024", "SLURM_CPUS_ON_NODE": "2"}
    assert free_memory(tmp_path, per_core) == (2048 - 100) * MEBIBYTE
    assert free_memory(tmp_path, {"SLURM_MEM_PER_NODE": "50"}) == 0
    shares = {"SLURM_MEM_PER_NODE": "4096", "CGM_JAX_MEMORY_MIB": "600"}  # of a launcher
    assert free_memory(tmp_path, shares) == (600 - 100) * MEBIBYTE
    write(
        tmp_path,
        proc__self__cgroup="0::/job/step\n",
        sys__fs__cgroup__job__memoryDOTmax=f"{1000 * MEBIBYTE}\n",
        sys__fs__cgroup__job__memoryDOTcurrent=f"{300 * MEBIBYTE}\n",
        sys__fs__cgroup__job__memoryDOTstat=f"anon 5\ninactive_file {50 * MEBIBYTE}\n",
        sys__fs__cgroup__job__step__memoryDOTmax="max\n",
    )
    assert free_memory(tmp_path, {}) == 750 * MEBIBYTE


def test_memory_of_a_group_of_version_1(tmp_path: Path) -> None:
    folder = "sys__fs__cgroup__memory__slurm__memoryDOT"
    write(
        tmp_path,
        proc__meminfo="MemAvailable:    8000000 kB\n",
        proc__self__cgroup="9:memory:/slurm\n0::/\n",
        **{
            f"{folder}limit_in_bytes": f"{1000 * MEBIBYTE}\n",
            f"{folder}usage_in_bytes": f"{300 * MEBIBYTE}\n",
            f"{folder}stat": f"total_inactive_file {100 * MEBIBYTE}\n",
        },
    )
    assert free_memory(tmp_path, {}) == 800 * MEBIBYTE
    write(tmp_path, **{f"{folder}limit_in_bytes": "9223372036854771712\n"})  # none
    assert free_memory(tmp_path, {}) == 8_000_000 * 1024


def test_a_machine_that_tells_nothing_has_what_it_has(tmp_path: Path) -> None:
    assert 2**26 < free_memory(tmp_path, {}) <= 2**63
    assert available_cores(tmp_path, {}) >= 1
