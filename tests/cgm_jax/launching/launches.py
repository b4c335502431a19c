"""Whole launches in processes of their own: begun, disturbed, and held against one sweep."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cgm_jax.launching.cores import Cores
from cgm_jax.launching.record import events, position
from tests.cgm_jax.sweeps import POINT_MASS, ROOT, assert_same_results, command, rows

SMOKE = ["--", "--preset", "smoke"]
"""The sweep of a launch that tests do not get to train."""

EPOCHS = 400
SWEEP = ["--preset", "smoke", "--env", POINT_MASS, "--epochs", str(EPOCHS), "--seeds", "2"]
SWEEP += ["--side-by-side", "2", "--checkpoint-seconds", "1"]
"""Four runs, two at a time, so that two parts train what one sweep trains one after the other."""


def launch(on: str, out: Path, *options: str) -> list[str]:
    """The command of a launch of two parts with one core each."""
    words = ["--on", on, "--jobs", "2", "--cores", "1", "--out", str(out), *options]
    return [sys.executable, "-m", "cgm_jax.launch", *words, "--", *SWEEP]


def uninterrupted(out: Path) -> Path:
    """The same in one sweep that nothing disturbs, on one core as a part is."""
    cores = Cores(1)
    with cores.inherited():
        subprocess.run(
            command(*SWEEP[2:], "--out", str(out)), check=True, capture_output=True, cwd=ROOT
        )
    cores.release()
    assert len(rows(out)) == 4 * EPOCHS
    return out


@contextmanager
def begun(arguments: list[str], **variables: str) -> Iterator[subprocess.Popen[str]]:
    """A launch that runs while the block does; its output goes where the test's does."""
    environment = {**os.environ, **variables}
    with subprocess.Popen(arguments, cwd=ROOT, env=environment, text=True) as process:
        try:
            yield process
        finally:
            if process.poll() is None:
                process.terminate()
                process.wait(60)


def wait_until(
    process: subprocess.Popen[str], condition: Callable[[], Any], what: str, seconds: float = 240.0
) -> Any:
    """What a condition returns once it is true, while the launch runs."""
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert process.poll() is None, f"the launch has ended before {what}"
        assert time.monotonic() < deadline, f"{what} has not come in {seconds:.0f} s"
        time.sleep(0.1)
    return found


def epoch_of(out: Path, part: int) -> int:
    """The epoch of a part's last checkpoint."""
    return (position(out / "parts" / str(part)) or [0, 0])[1]


def wait_for_checkpoint(
    process: subprocess.Popen[str], out: Path, part: int, after: int = 0
) -> int:
    """The epoch of a part's first checkpoint after an epoch, well before its end."""

    def later() -> int | None:
        epoch = epoch_of(out, part)
        return epoch if epoch > after else None

    epoch = wait_until(process, later, f"a checkpoint of part {part} after epoch {after}")
    assert epoch < EPOCHS - 50, "too late to disturb it"
    return epoch


def attempts(out: Path, part: int) -> list[tuple[int, int | None]]:
    """The epoch at which each attempt began, and its exit code, None if it was lost."""
    made: list[tuple[int, int | None]] = []
    for entry in events(out / "attempts" / f"{part}.jsonl"):
        if entry["event"] == "started":
            made.append(((entry["position"] or [0, 0])[1], None))
        if entry["event"] == "ended":
            made[-1] = made[-1][0], entry["code"]
    return made


def trainer(out: Path, part: int) -> int | None:
    """The process that trains a part, as its run directory's lock has it."""
    words = f"--out {out}/parts/{part}".split()
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                line = (entry / "cmdline").read_bytes().decode().split("\0")
            except OSError:
                continue
            if words[1] in line and "cgm_jax.sweep" in line:
                return int(entry.name)
    return None


def assert_as_if_never_disturbed(whole: Path, out: Path) -> None:
    """The merged directory has the rows, the policies and the final states of the one sweep."""
    assert_same_results(whole, out)
    found = [(row["run"], row["epoch"]) for row in rows(out)]
    assert len(set(found)) == len(found) == 4 * EPOCHS
    merged, alone = (json.loads((path / "config.json").read_text()) for path in (out, whole))
    assert merged["groups"] == alone["groups"]
    assert len(merged["parts"]) == 2
