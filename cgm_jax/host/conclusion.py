"""What a finished sweep has come to: lines, figures, a tracker's last word, and the exit code."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cgm_jax.config.spelling import counted
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.host.progress import physics_lines, summary_lines
from cgm_jax.results.tracking import Tracking
from cgm_jax.storage.metrics import Row
from cgm_jax.storage.run_directory import RunDirectory


def conclude(directory: RunDirectory, rows: Sequence[Mapping[str, Any]]) -> int:
    """Say what a finished sweep has come to, draw its figures, and return its exit code.

    Args:
        directory: of the sweep.
        rows: all rows of its metrics.
    """
    last = list({row["run"]: row for row in rows}.values())
    print("\n".join(summary_lines(last) + physics_lines(rows)))
    try_to_draw_figures(directory)
    print(f"{counted(len(last), 'run')}; figures in {directory.path / 'figures'}")
    return exit_code_of(last)


def try_to_draw_figures(directory: RunDirectory) -> list[Path]:
    """Draw what can be drawn; training is done, and its outcome does not depend on it."""
    try:
        from cgm_jax.results.figures import draw_figures

        return draw_figures(directory)
    except Exception as error:
        line = str(error).partition("\n")[0]
        print(f"no figures drawn: {type(error).__name__}: {line}", file=sys.stderr)
        return []


def show_results(
    directory: RunDirectory,
    rows: Sequence[Row],
    figures: Sequence[Path],
    tracking: Tracking,
) -> None:
    """Send figures and a video of the best policy to the tracker, where it can be made."""
    shown = {f"figures/{path.stem}": path for path in figures}
    try:
        from cgm_jax.results.best_policy import video_of_best_policy

        shown["best_policy"] = video_of_best_policy(directory, rows)
    except Exception as error:
        line = str(error).partition("\n")[0]
        print(f"no video of the best policy: {line}", file=sys.stderr)
    tracking.show(shown, max(row["epoch"] for row in rows))


def exit_code_of(rows: Sequence[Mapping[str, Any]]) -> int:
    """The exit code for the last row of every run; says which is not as it should be."""
    diverged = sum(row["failure"] is not None for row in rows)
    if diverged:
        print(f"{diverged} of {len(rows)} runs diverged", file=sys.stderr)
    dropped = sum(row["success_rate"] is None for row in rows)
    if dropped:
        print(
            f"{dropped} of {len(rows)} runs had no valid episode in their last evaluation",
            file=sys.stderr,
        )
    return ExitCode.DIVERGED if diverged or dropped else ExitCode.DONE
