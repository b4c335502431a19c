"""What the start takes, by engine: `python -m experiments.physics.start`, on an idle machine.

From the command to the end of the first training cycle of push with the preset `cpu`, with an empty
compilation cache, each engine in a process of its own. Writes OUT/start.csv, one row an engine:
seconds until the environment is there (Python, libraries, scene), to trace what starts and trains,
to wait until that is compiled, for the first cycle, and of all together.
"""

import itertools
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.host.command_line import parse, refuse, run_program
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.startup import prepare_jax
from cgm_jax.measuring.child import MeasurementError, output_of
from cgm_jax.measuring.workload import choose_cpu
from experiments.table import read_table, write_table

ENGINES = ("native", "mjx")
OUT = Path(__file__).resolve().parents[1] / "results" / "engines"


@dataclass(kw_only=True)
class StartOptions:
    """Time the start on each engine."""

    engines: Annotated[tuple[str, ...], tyro.conf.Positional] = ENGINES
    """Of which engines; the others keep their rows."""

    since: float | None = None
    """Only start one engine, which began at this time in seconds since 1970, and print its row."""

    out: Path = OUT
    """Directory for the table."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(StartOptions, arguments, "python -m experiments.physics.start")
    for engine in options.engines:
        if engine not in ENGINES:
            raise SettingError(f"engines: {engine!r} is none of {', '.join(ENGINES)}")
    if options.since is not None:
        print(json.dumps(_phases(options.engines[0], options.since)))
        return 0
    choose_cpu()
    path = options.out / "start.csv"
    kept = read_table(path) if path.exists() else []
    rows: list[Any] = [row for row in kept if row["engine"] not in options.engines]
    for engine in options.engines:
        try:
            rows.append(_started(engine))
        except MeasurementError as error:
            refuse(str(error), ExitCode.FAILED)
        print(rows[-1], flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    write_table(path, rows)
    return 0


def _started(engine: str) -> dict[str, Any]:
    """The row of an engine, from a process of its own."""
    with tempfile.TemporaryDirectory() as cache:
        words = [engine, "--since", repr(time.time())]
        command = [sys.executable, "-m", "experiments.physics.start", *words]
        output = output_of(command, {"JAX_COMPILATION_CACHE_DIR": cache})
    return json.loads(output.splitlines()[-1])


def _phases(engine: str, since: float) -> dict[str, Any]:
    """Start training on an engine; seconds of each phase."""
    prepare_jax()
    import jax

    from cgm_jax.host.devices import describe_devices
    from cgm_jax.loop.compiler import Compiler, wait_for
    from cgm_jax.loop.environment import make_environment
    from cgm_jax.loop.training import make_programs, make_trainer
    from cgm_jax.storage.provenance import provenance

    group = build_groups("cpu", {"env": ["push"], "engine": [engine]})[0]
    env, hyper = make_environment(group.settings), group.hyper()
    marks = [since, time.time()]
    with Compiler() as compiler:
        programs = compiler.programs(make_programs(make_trainer(env, group.settings)), hyper)
        marks.append(time.time())
        states = programs.start(hyper)
        wait_for(programs.train)
        marks.append(time.time())
        whole_cycle = programs.trainer.parts(group.runs[0].hyper).total
        jax.block_until_ready(programs.train(states, hyper, whole_cycle))
        marks.append(time.time())
    names = ("libraries_s", "tracing_s", "compiling_s", "first_cycle_s")
    spans = itertools.pairwise(marks)
    where = provenance(describe_devices(), [])
    return {
        "engine": engine,
        **{name: round(end - begin, 1) for name, (begin, end) in zip(names, spans, strict=True)},
        "together_s": round(marks[-1] - since, 1),
        "commit": where["commit"],
        "machine": where["machine"],
    }


if __name__ == "__main__":
    run_program(main)
