"""Random sequences of everything that can happen to a sweep, and what must come of it.

    python -m tests.cgm_jax.faults --sequences 50 --out faults.csv

Each sequence stops, kills, starves, tears and moves one small sweep, as its seed has it. After
every step a copy of the directory is resumed to its end: every bit must be that of a sweep that
nothing has disturbed, and every epoch must be there once.
"""

import argparse
import contextlib
import csv
import itertools
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from unittest import mock

from cgm_jax import sweep
from cgm_jax.host import jobs
from cgm_jax.results import figures
from cgm_jax.storage.checkpoints import damage, finished_checkpoints, manifest_path
from tests.cgm_jax.shared_programs import shared_programs
from tests.cgm_jax.sweeps import POINT_MASS, ROOT, assert_same_results, rows
from tests.examples.point_mass import PointMass

EPOCHS, STEPS = 60, 5
OPTIONS = ["--preset", "smoke", "--env", POINT_MASS, "--epochs", str(EPOCHS)]

SIGNALS = {
    "Ctrl-C": [signal.SIGINT],
    "SIGTERM": [signal.SIGTERM],
    "SIGHUP": [signal.SIGHUP],
    "SIGUSR1, SIGTERM": [signal.SIGUSR1, signal.SIGTERM],
    "SIGUSR2, SIGUSR2": [signal.SIGUSR2, signal.SIGUSR2],
}
TO_PROCESS = [*SIGNALS, "kill -9", "full disk"]
TO_FILES = ["cut checkpoint", "flipped bit", "no manifest", "cut config", "cut metrics", "moved"]


@dataclass(frozen=True)
class Step:
    """What was done to a sweep, and what came of it.

    Attributes:
        seed: of the sequence.
        step: number of the step in it.
        fault: what was done.
        code: exit code of the process that it was done to; None where there was none.
        epoch: whole epochs in metrics.jsonl afterwards.
    """

    seed: int
    step: int
    fault: str
    code: int | None
    epoch: int


@contextlib.contextmanager
def compiled_once() -> Iterator[None]:
    """Let sweeps on the point mass in this process share their programs, and draw no figures."""
    with (
        shared_programs(),
        mock.patch.object(jobs, "make_environment", return_value=PointMass()),
        mock.patch.object(figures, "draw_figures"),
    ):
        yield


def undisturbed(out: Path) -> Path:
    """A sweep that nothing has disturbed."""
    assert sweep.main([*OPTIONS, "--out", str(out)]) == 0
    return out


def run_sequence(seed: int, folder: Path, whole: Path) -> Iterator[Step]:
    """Do to a sweep what the seed says, and check after each step that nothing is lost.

    Raises:
        AssertionError: something is.
    """
    draw, out = random.Random(seed), folder / "sweep 0"
    for step in range(STEPS):
        begun = (out / "config.json").exists()
        fault = draw.choice(_possible(out, draw) if begun and step % 2 else TO_PROCESS)
        code = None
        if fault in TO_PROCESS:
            code = _disturb_process(out, fault, draw)
        elif fault == "moved":
            out = out.rename(out.with_name(f"sweep {step}"))
        else:
            _damage_file(out, fault, draw)
        copy = folder / "copy"
        shutil.copytree(out, copy)
        assert sweep.main(["--resume", str(copy)]) == 0
        written = [(row["run"], row["epoch"]) for row in rows(copy)]
        assert len(set(written)) == len(written) == 2 * EPOCHS
        assert_same_results(whole, copy)
        shutil.rmtree(copy)
        yield Step(seed, step, fault, code, _epochs(out))


def _possible(out: Path, draw: random.Random) -> list[str]:
    """Faults of files from which there is a way back: one whole checkpoint or config stays."""
    whole = sum(damage(path) is None for path in finished_checkpoints(out / "checkpoints"))
    config = out / "config.json"
    possible = [fault for fault in TO_FILES if fault != "cut config" or whole]
    if whole < 2 and not config.read_bytes().endswith(b"}\n"):
        possible = ["cut metrics", "moved"]
    return draw.sample(possible, len(possible))


def _disturb_process(out: Path, fault: str, draw: random.Random) -> int:
    """Start or resume the sweep, and do something to it at a random moment; its exit code."""
    again = (out / "config.json").exists() and draw.random() < 0.5
    options = ["--resume", str(out)] if again else [*OPTIONS, "--out", str(out)]
    interval = draw.choice(["0", "0.3", "300"])
    command = [sys.executable, "-m", "cgm_jax.sweep", *options, "--checkpoint-seconds", interval]
    epochs, delay = draw.randint(0, 20), draw.uniform(0, 0.2)
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        said = []
        for line in process.stderr:
            said.append(line)
            if sum(text.startswith("epoch ") for text in said) >= epochs:
                break
        time.sleep(delay)
        _act(process, fault, draw)
        said.append(process.stderr.read())
        code = process.wait(timeout=120)
    allowed = {"kill -9": (-signal.SIGKILL, 0), "full disk": (74, 0)}.get(fault, (75, 0))
    assert code in allowed, (fault, code, "".join(said))
    return code


def _act(process: subprocess.Popen[str], fault: str, draw: random.Random) -> None:
    if fault == "full disk":
        with contextlib.suppress(ProcessLookupError):
            limit = draw.randint(0, 100_000)
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (limit, limit))
    elif fault == "kill -9":
        process.kill()
    else:
        for number in SIGNALS[fault]:
            process.send_signal(number)
            time.sleep(0.05)


def _damage_file(out: Path, fault: str, draw: random.Random) -> None:
    name = {"cut config": "config.json", "cut metrics": "metrics.jsonl"}.get(fault)
    paths = [out / name] if name else finished_checkpoints(out / "checkpoints")[-1:]
    for path in paths:
        if fault == "no manifest":
            manifest_path(path).unlink()
            continue
        if not path.exists():
            continue
        content = bytearray(path.read_bytes())
        place = draw.randrange(max(1, len(content)))
        if fault == "flipped bit":
            content[place] ^= 1 << draw.randrange(8)
        else:
            del content[place:]
        path.write_bytes(content)


def _epochs(out: Path) -> int:
    path = out / "metrics.jsonl"
    return len(path.read_bytes().splitlines()) // 2 if path.exists() else 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run many sequences, and write a line per step as soon as it is done."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--sequences", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("faults.csv"))
    options = parser.parse_args(arguments)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # below nohup children would ignore it, too
    names = [item.name for item in fields(Step)] + ["outcome"]
    failed = 0
    with (
        compiled_once(),
        tempfile.TemporaryDirectory() as name,
        options.out.open("w", newline="") as file,
    ):
        folder = Path(name)
        whole = undisturbed(folder / "whole")
        writer = csv.DictWriter(file, names, lineterminator="\n")
        writer.writeheader()
        for seed in range(options.first, options.first + options.sequences):
            outcome = _record(seed, folder / str(seed), whole, writer.writerow)
            failed += outcome != "same bits"
            print(f"sequence {seed}: {outcome}", file=sys.stderr, flush=True)
            file.flush()
            shutil.rmtree(folder / str(seed))
    return 1 if failed else 0


def _record(
    seed: int, folder: Path, whole: Path, write: Callable[[dict[str, object]], object]
) -> str:
    folder.mkdir()
    done = itertools.count()
    try:
        for step in run_sequence(seed, folder, whole):
            next(done)
            write({**asdict(step), "outcome": "same bits"})
    except AssertionError as error:
        line = " ".join(str(error).split())[:300]
        write({"seed": seed, "step": next(done), "outcome": line})
        return f"step failed: {line}"
    return "same bits"


if __name__ == "__main__":
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    sys.exit(main())
