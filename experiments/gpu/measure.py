"""Measure a GPU: `python -m experiments.gpu.measure`, or `make gpu`.

Every case is a process of its own, with at most eight minutes, so that it starts with all of the
memory and cannot take the rest with it. OUT/gpu.csv has a row per figure and names the card; a case
that it holds is not measured again, so that the same command resumes. After 25 minutes the program
ends in good order. OUT/gpu.txt is the same for people.

With --rehearse all of it is done in small on a CPU, afresh each time.
"""

import contextlib
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cgm_jax.config.fields import SettingError
from cgm_jax.envs.physics.choose import has_warp
from cgm_jax.host.command_line import parse, run_program
from experiments.table import read_table

RESULTS = Path(__file__).resolve().parents[1] / "results" / "gpu"
REHEARSAL = Path("runs") / "gpu-rehearsal"
CASE_SECONDS, ALL_SECONDS, GRACE_SECONDS = 480, 1500, 20

CASES: dict[str, tuple[str, ...]] = {
    "rate_mjx": ("64", "256", "1024", "4096", "16384"),
    "rate_warp": ("64", "256", "1024", "4096", "16384"),
    "updates": ("all",),
    "start": ("all",),
    "runs": ("1", "8", "32", "90"),
    "memory": ("push", "pick_and_place"),
    "parity_mjx": ("push", "pick_and_place"),
    "parity_warp": ("push", "pick_and_place"),
    "learning": ("push", "pick_and_place"),
}
REHEARSED: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(CASES, ()),
    "rate_mjx": ("4",),
    "rate_warp": ("4",),
    "updates": ("all",),
    "start": ("all",),
    "runs": ("1", "2"),
    "memory": ("push",),
    "parity_mjx": ("push",),
    "parity_warp": ("push",),
    "learning": ("push",),
}
COLUMNS: tuple[str, ...] = ("device", "part", "case", "figure", "value", "unit")


@dataclass(kw_only=True)
class GpuOptions:
    """Measure everything that is to be known about a GPU."""

    rehearse: bool = False
    """Do all of it in small, on a CPU."""

    out: Path | None = None
    """Directory for gpu.csv and gpu.txt (default: experiments/results/gpu; a rehearsal's:
    runs/gpu-rehearsal, which it empties first)."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(GpuOptions, arguments, "python -m experiments.gpu.measure")
    out = options.out or (REHEARSAL if options.rehearse else RESULTS)
    if options.rehearse and options.out is None:
        shutil.rmtree(out, ignore_errors=True)
    device = _device()
    if device.lower().startswith("cpu") and not options.rehearse:
        raise SettingError("rehearse: JAX finds no GPU here; give --rehearse to do it on a CPU")
    out.mkdir(parents=True, exist_ok=True)
    began, missing = time.monotonic(), []
    for part, case in _outstanding(out, device, rehearse=options.rehearse):
        left = ALL_SECONDS - (time.monotonic() - began)
        figures = _measure(part, case, out, options.rehearse, min(CASE_SECONDS, left))
        if isinstance(figures, str):
            missing.append(f"{part} {case}: {figures}")
            print(missing[-1], file=sys.stderr, flush=True)
            continue
        _append(
            out / "gpu.csv",
            [{"device": device, "part": part, "case": case, **row} for row in figures],
        )
        for row in figures:
            print(part, case, row["figure"], row["value"], row["unit"], flush=True)
    _write_text(out, missing)
    print(f"{out / 'gpu.txt'}: {time.monotonic() - began:.0f} s; {len(missing)} cases are missing")
    return 1 if missing else 0


def _outstanding(out: Path, device: str, *, rehearse: bool) -> Iterator[tuple[str, str]]:
    """Cases that OUT/gpu.csv does not hold yet, of this device."""
    rows = read_table(out / "gpu.csv") if (out / "gpu.csv").exists() else []
    done = {(row["part"], row["case"]) for row in rows if row["device"] == device}
    for part, cases in (REHEARSED if rehearse else CASES).items():
        if part not in _left_out():
            yield from ((part, case) for case in cases if (part, case) not in done)


def _left_out() -> list[str]:
    """Parts that this environment has no engine for."""
    return [] if has_warp() else [part for part in CASES if part.endswith("_warp")]


def _measure(
    part: str, case: str, out: Path, rehearse: bool, limit: float
) -> list[dict[str, Any]] | str:
    """The figures of a case, or why there are none."""
    if limit < 10:
        return "the time for all is over; the same command measures it"
    words = [sys.executable, "-m", "experiments.gpu.cases", part, case, str(out)]
    ended = run_within([*words, *(["--rehearse"] if rehearse else [])], limit)
    if ended is None:
        return f"not done within {limit:.0f} s; the same command tries again"
    code, output, errors = ended
    if code:
        return (errors.strip().splitlines() or [f"exit code {code}"])[-1]
    return json.loads(output.splitlines()[-1])


def run_within(words: Sequence[str], limit: float) -> tuple[int, str, str] | None:
    """Exit code, output and errors of a command; None if it takes longer than `limit` seconds.

    Then, or if this process is interrupted, it and all that it started are ended: by SIGTERM, so
    that training writes its checkpoint, and 20 s later by SIGKILL.
    """
    # Some cases have processes of their own on the same GPU, which JAX would keep for itself.
    sharing = {"XLA_PYTHON_CLIENT_PREALLOCATE": "false", **os.environ}
    with subprocess.Popen(
        words,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=sharing,
        start_new_session=True,
    ) as process:
        try:
            output, errors = process.communicate(timeout=limit)
            return process.returncode, output, errors
        except subprocess.TimeoutExpired:
            return None
        finally:
            for number in (signal.SIGTERM, signal.SIGKILL):
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, number)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.communicate(timeout=GRACE_SECONDS)


def _append(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, list(COLUMNS), lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerows(rows)


def _write_text(out: Path, missing: Sequence[str]) -> None:
    """All figures by device, part and case, for people."""
    rows = read_table(out / "gpu.csv") if (out / "gpu.csv").exists() else []
    lines = []
    for device in dict.fromkeys(row["device"] for row in rows):
        lines.append(device)
        lines += [
            "  {part:<11} {case:<15} {figure:<60} {value} {unit}".format(**row)
            for row in rows
            if row["device"] == device
        ]
    lines += [f"left out: {part}, since warp-lang is not installed" for part in _left_out()]
    lines += [f"missing: {line}" for line in missing]
    (out / "gpu.txt").write_text("".join(f"{line.rstrip()}\n" for line in lines))


def _device() -> str:
    """What JAX computes on, asked of another process, so that this one holds no memory of it."""
    ask = "import jax; d = jax.devices(); print(f'{d[0].device_kind} x {len(d)}')"
    process = subprocess.run([sys.executable, "-c", ask], capture_output=True, text=True)
    if process.returncode:
        raise SettingError("JAX_PLATFORMS: JAX finds no such device")
    return process.stdout.strip()


if __name__ == "__main__":
    run_program(main)
