"""The cores and the memory that this process was given, which may be less than the machine has.

A machine is shared: a container, a batch system or an affinity mask gives a process a part of it.
Whoever plans with the whole machine is slow (more threads than cores) or killed (more memory than
allowed). Only the standard library is imported here.
"""

import math
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

ROOT = Path("/")
UNLIMITED = 2**63
MEBIBYTE = 2**20

MEMORY_VARIABLE = "CGM_JAX_MEMORY_MIB"
"""Variable by which a launcher tells a process its share of the machine's memory."""


_teams = [1]


def share_cores(teams: int) -> None:
    """Say that so many devices of this process compute at the same time."""
    _teams[0] = teams


def cores_each() -> int:
    """Cores for each of the devices that compute at the same time, rounded up."""
    return -(-available_cores() // _teams[0])


def available_cores(root: Path = ROOT, environment: Mapping[str, str] = os.environ) -> int:
    """Cores that this process may keep busy: the least of all that limit it.

    Those limits are its affinity, the bandwidth of its control groups (rounded up), and
    SLURM_CPUS_PER_TASK, which SLURM itself enforces only where it is set up to.

    Args:
        root: where /proc and /sys lie.
        environment: environment variables.
    """
    has_affinity = hasattr(os, "sched_getaffinity")
    limits = [len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1]
    limits += [math.ceil(quota) for quota in _read_each(root, "cpu", _cores_of_group)]
    limits += _numbers(environment, "SLURM_CPUS_PER_TASK")
    return max(1, min(limits))


def free_memory(root: Path = ROOT, environment: Mapping[str, str] = os.environ) -> int:
    """Bytes of host memory that this process may still take: the least of all that limit it.

    Those limits are what the machine has free, its control groups, and what the job was given, less
    what this process holds already: by SLURM (SLURM_MEM_PER_NODE or SLURM_MEM_PER_CPU), or by
    cgm_jax.launch (CGM_JAX_MEMORY_MIB).

    Args:
        root: where /proc and /sys lie.
        environment: environment variables.
    """
    limits = [_free_on_host(root), *_read_each(root, "memory", _left_in_group)]
    given = _numbers(environment, "SLURM_MEM_PER_NODE")
    given += _numbers(environment, MEMORY_VARIABLE)
    for per_core in _numbers(environment, "SLURM_MEM_PER_CPU"):
        cores = _numbers(environment, "SLURM_CPUS_ON_NODE") or [available_cores(root, environment)]
        given.append(per_core * cores[0])
    limits += [mebibytes * MEBIBYTE - _resident(root) for mebibytes in given]
    return max(0, min(limits))


def _numbers(environment: Mapping[str, str], name: str) -> list[int]:
    """The positive number in an environment variable; none where there is no such number.

    SLURM_MEM_PER_NODE=0, for one, is the whole node.
    """
    text = environment.get(name, "")
    return [int(text)] if text.isascii() and text.isdigit() and int(text) > 0 else []


def _read_each(
    root: Path, controller: str, read: Callable[[Path], float | None]
) -> Iterator[int | float]:
    """What `read` finds in each of the control groups around this process."""
    for folder in _control_groups(root, controller):
        try:
            found = read(folder)
        except (OSError, ValueError, IndexError, ZeroDivisionError):
            continue
        if found is not None:
            yield found


def _control_groups(root: Path, controller: str) -> Iterator[Path]:
    """This process's control group with all around it, of version 2 and of version 1.

    Each may have a limit. Inside a container the path that /proc names is often not there, but
    the container's own group then is the mounted root.
    """
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            mount = root / "sys/fs/cgroup"
        elif controller in controllers.split(","):
            mount = root / "sys/fs/cgroup" / controller
        else:
            continue
        own = mount / path.lstrip("/")
        yield from (
            folder for folder in (own, *own.parents) if folder == mount or mount in folder.parents
        )


def _cores_of_group(folder: Path) -> float | None:
    """Cores' worth of time that a group gets; None if it has no limit."""
    if (folder / "cpu.max").exists():
        quota, period = (folder / "cpu.max").read_text().split()
        return None if quota == "max" else int(quota) / int(period)
    quota, period = (
        int((folder / f"cpu.cfs_{part}_us").read_text()) for part in ("quota", "period")
    )
    return None if quota < 0 else quota / period


def _left_in_group(folder: Path) -> int | None:
    """Bytes that a group may still take; None if it has no limit."""
    limit_name, used_name, cache_name = (
        ("memory.max", "memory.current", "inactive_file")
        if (folder / "memory.max").exists()
        else ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
    )
    limit = (folder / limit_name).read_text().strip()
    if limit == "max" or int(limit) >= UNLIMITED // 2:  # version 1 has no word for none
        return None
    used = int((folder / used_name).read_text())
    entries = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
    return int(limit) - used + int(entries.get(cache_name, 0))  # file cache makes way


def _free_on_host(root: Path) -> int:
    entries = _entries(root / "proc/meminfo")
    if "MemAvailable" in entries:
        return entries["MemAvailable"]
    try:  # neither Linux nor a system that tells what is free: all that is there
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return UNLIMITED


def _resident(root: Path) -> int:
    """Bytes that this process holds; 0 where the system does not tell."""
    return _entries(root / "proc/self/status").get("VmRSS", 0)


def _entries(path: Path) -> dict[str, int]:
    """Bytes by name, of a file of /proc with lines such as `MemAvailable:  123 kB`."""
    try:
        lines = [line.split() for line in path.read_text().splitlines()]
    except OSError:
        return {}
    return {
        words[0].rstrip(":"): int(words[1]) * 1024
        for words in lines
        if len(words) == 3 and words[2] == "kB"
    }
