"""What every run writes while it learns. Needs no packages."""

import csv
import os
import resource
from pathlib import Path

PARENT = os.getppid()
COLUMNS = ("env_steps", "cpu_s", "success_rate")


def cpu_seconds() -> float:
    """Of this process and those that it has waited for, since it began."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def is_wanted() -> bool:
    """Whether the program that started this one is still there to take the curve."""
    return os.getppid() == PARENT


def begin(path: Path) -> None:
    """Begin the table anew."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(COLUMNS)


def add(path: Path, env_steps: int, success_rate: float) -> None:
    """Add an evaluation, as of now."""
    row = env_steps, f"{cpu_seconds():.1f}", round(success_rate, 4)
    with path.open("a", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(row)
