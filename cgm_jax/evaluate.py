"""`python -m cgm_jax.evaluate DIR`: success of trained policies, with a confidence interval."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cgm_jax.command_line import parse, run_program
from cgm_jax.settings import SettingError
from cgm_jax.startup import prepare_jax
from cgm_jax.statistics import wilson_interval


@dataclass(kw_only=True)
class EvaluateOptions:
    """Run the policies of a sweep without noise, on full goals, and report their success."""

    directory: Annotated[Path, tyro.conf.Positional]
    """Directory that a sweep or a training run has written."""

    episodes: int = 200
    """Episodes per policy."""

    seed: int = 1000
    """Random seed of starts and goals, the same for every policy."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program on command-line arguments; return its exit code."""
    options = parse(EvaluateOptions, arguments, "python -m cgm_jax.evaluate")
    if not 1 <= options.episodes <= 10**6:
        raise SettingError(f"episodes: {options.episodes} is not within [1, 1000000]")
    if not 0 <= options.seed < 2**31:
        raise SettingError(f"seed: {options.seed} is not within [0, 2147483647]")
    prepare_jax()
    from cgm_jax.evaluation import evaluate_directory
    from cgm_jax.run_directory import RunDirectory

    results = evaluate_directory(
        RunDirectory.open(options.directory), options.episodes, options.seed
    )
    width = max(len(name) for name in results)
    for name, (successes, valid) in results.items():
        if not valid:
            print(f"{name:{width}}  no valid episode")
            continue
        low, high = wilson_interval(successes, valid)
        print(
            f"{name:{width}}  {100 * successes / valid:5.1f} %  "
            f"(95 %: {100 * low:.1f} to {100 * high:.1f}, {valid} episodes)"
        )
    return 0


if __name__ == "__main__":
    run_program(main)
