"""Train sweeps, one after the other or several at a time."""

import os
import queue
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path


def train(sweeps: Mapping[str, Sequence[str]], directory: Path, at_once: int = 1) -> None:
    """Train what is missing of sweeps; one that is stopped or fails ends this program as it ended.

    A single run gains little from a second core, so that two sweeps on a core each are done
    sooner than one after the other on both. Their seconds are those of their cores.

    Args:
        sweeps: options of `cgm_jax.sweep` by name.
        directory: where each sweep has its run directory.
        at_once: how many train at a time; if above 1, each on cores of its own, with what it
            prints in a file NAME.log.
    """
    shares: queue.SimpleQueue[set[int]] = queue.SimpleQueue()
    for share in shares_of_cores(at_once):
        shares.put(share)

    def bind() -> None:
        # Of this thread alone; the processes that it starts inherit it.
        if share := shares.get():
            os.sched_setaffinity(0, share)

    ended = threading.Event()

    def run(name: str) -> int:
        if ended.is_set():
            return 0
        code = _sweep(sweeps[name], directory / name, quiet=at_once > 1)
        if code:
            ended.set()  # before this thread takes the next one
        return code

    directory.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(at_once, initializer=bind) as pool:
        codes = {name: pool.submit(run, name) for name in sweeps}
        try:
            for name, code in codes.items():
                if code.result():
                    print(f"{name} ended with exit code {code.result()}", file=sys.stderr)
                    sys.exit(code.result())
        finally:
            ended.set()  # sweeps that have begun are waited for


def shares_of_cores(count: int) -> list[set[int]]:
    """The cores that this process may use, dealt out; empty where processes cannot be bound."""
    if not hasattr(os, "sched_getaffinity"):
        return [set() for _ in range(count)]
    cores = sorted(os.sched_getaffinity(0))
    return [set(cores[i::count]) or {cores[i % len(cores)]} for i in range(count)]


def _sweep(options: Sequence[str], out: Path, *, quiet: bool) -> int:
    """Train one sweep in a process of its own; return its exit code."""
    command = [sys.executable, "-m", "cgm_jax.sweep", *options, "--out", str(out)]
    if not quiet:
        return subprocess.run(command, check=False).returncode
    with Path(f"{out}.log").open("a") as log:
        return subprocess.run(command, stdout=log, stderr=log, check=False).returncode
