"""What the page shows, as plain values: js/ says what it makes of each."""

import shlex
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import cgm_jax
from cgm_jax.results.figures.runs import TrainedRun, grouped
from cgm_jax.results.page.series import arrays_of, columns_of
from cgm_jax.results.page.settings import (
    Distinction,
    PageRun,
    differences,
    runs_with_settings,
    title_of,
)
from cgm_jax.results.page.success import final_success, success_over_seeds
from cgm_jax.results.page.sweeps import Sweep, is_finite, labels_of
from cgm_jax.results.statistics import HOLDING_EVALUATIONS, ROUNDING


def page_data(sweeps: Sequence[Sweep]) -> dict[str, Any]:
    """Everything that the page's programs read."""
    runs, distinctions = runs_with_settings(sweeps)
    groups = _groups(runs, distinctions)
    differ, common = differences(sweeps)
    plain_runs = [_run(run, sweeps[run.sweep]) for run in runs]
    return {
        "version": cgm_jax.__version__,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "holding": HOLDING_EVALUATIONS,
        "rounding": ROUNDING,
        "sweeps": [
            _sweep(sweep, label)
            for sweep, label in zip(sweeps, labels_of([s.path for s in sweeps]), strict=True)
        ],
        "differences": differ,
        "common": common,
        "settings": [one.to_plain() for one in distinctions],
        "groups": [_group(group, runs, plain_runs, distinctions) for group in groups],
        "runs": plain_runs,
        "measures": _measures(plain_runs),
    }


def _groups(runs: Sequence[PageRun], distinctions: Sequence[Distinction]) -> list[list[int]]:
    """Numbers of runs that differ in the seed only, together.

    Runs of one seed that no setting tells apart are no repetitions: each is a group of its own.
    """
    names = [one.name for one in distinctions]
    found = []
    for same in grouped(
        range(len(runs)), lambda i: tuple(runs[i].settings[name] for name in names)
    ).values():
        seeds = {runs[i].trained.seed for i in same}
        found += [same] if len(seeds) == len(same) else [[i] for i in same]
    return found


def _group(
    group: Sequence[int],
    runs: Sequence[PageRun],
    plain: Sequence[dict[str, Any]],
    distinctions: Sequence[Distinction],
) -> dict[str, Any]:
    settings = runs[group[0]].settings
    values = [
        None if settings[one.name] is None else one.values.index(settings[one.name])
        for one in distinctions
    ]
    final = success_over_seeds([plain[i]["final"]["rate"] for i in group])
    return {"values": values, "runs": group, "final": final}


def _run(run: PageRun, sweep: Sweep) -> dict[str, Any]:
    trained, settings = run.trained, sweep.planned.get(run.trained.name, {})
    return {
        "name": trained.name,
        "seed": trained.seed,
        "sweep": run.sweep,
        "epochs": settings.get("epochs"),
        "leave_at": level if is_finite(level := settings.get("leave_at")) else None,
        "failed": _failure(trained),
        "final": final_success(trained, settings),
        "columns": columns_of(trained),
        "arrays": arrays_of(trained),
    }


def _failure(run: TrainedRun) -> dict[str, Any] | None:
    row = run.failed_row
    if row is None:
        return None
    return {"epoch": row["epoch"], "text": str(row.get("failure") or "it diverged")}


def _sweep(sweep: Sweep, label: str) -> dict[str, Any]:
    config = sweep.config
    return {
        "label": label,
        "path": str(sweep.path),
        "started": _text(config.get("started")),
        "command": _command(config.get("command")),
        "preset": _text(config.get("preset")),
        "commit": _text(config.get("commit")),
        "machine": _text(config.get("machine")),
        "runs": len(sweep.runs),
        "planned": len(sweep.planned),
        "finished": sweep.finished,
        "failed": sum(run.failed_row is not None for run in sweep.runs),
        "env_steps": sum(run.last_steps for run in sweep.runs),
    }


def _measures(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Names of all that was measured, numbers before arrays."""
    found = {}
    for kind in ("columns", "arrays"):
        for name in (name for run in runs for name in run[kind]):
            if name not in ("epoch", "env_steps", "wall_s"):
                found[name] = {"name": name, "title": title_of(name), "array": kind == "arrays"}
    return list(found.values())


def _command(words: Any) -> str | None:
    return shlex.join(map(str, words)) if isinstance(words, list) else _text(words)


def _text(value: Any) -> str | None:
    return None if value is None else str(value)
