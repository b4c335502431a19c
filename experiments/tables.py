"""Tables of the report, from rows of metrics.jsonl."""

import csv
import itertools
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from cgm_jax.statistics import HOLDING_EVALUATIONS, first_to_reach

Row = dict[str, Any]
LEVELS = (0.5, 0.9)
SETTING = ("env", "her", "cgm", "c_g", "kappa")


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write rows, all with the keys of the first, as CSV."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def runs_by_setting(rows: Sequence[Row]) -> dict[tuple[Any, ...], dict[int, list[Row]]]:
    """Rows in order of epochs, by setting and seed. Without CGM c_g and kappa are None."""
    settings: dict[tuple[Any, ...], dict[int, list[Row]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        curriculum = (row["c_g"], row["kappa"]) if row["cgm"] else (None, None)
        setting = (row["env"], row["her"], row["cgm"], *curriculum)
        settings[setting][row["seed"]].append(row)
    return {setting: dict(seeds) for setting, seeds in settings.items()}


def learning_speed(rows: Sequence[Row]) -> list[Row]:
    """Per setting: how soon its seeds reach 50 and 90 % success, and where they end.

    A level is reached at the first evaluation that shows it. Medians over seeds; empty where
    half of the seeds or more never reach it.
    """
    table = []
    for setting, seeds in runs_by_setting(rows).items():
        runs = list(seeds.values())
        entry: Row = {**dict(zip(SETTING, setting, strict=True)), "seeds": len(runs)}
        for level in LEVELS:
            reached = [first_to_reach(run, level) for run in runs]
            name = f"{100 * level:.0f}"
            entry[f"reach_{name}"] = sum(row is not None for row in reached)
            for measure in ("env_steps", "wall_s"):
                values = [row[measure] if row else np.inf for row in reached]
                median = float(np.median(values))
                entry[f"{measure}_to_{name}"] = round(median) if np.isfinite(median) else ""
        ends = [final_success(run) for run in runs]
        entry |= {"final_success": round(float(np.median(ends)), 3), "worst_seed": min(ends)}
        entry["env_steps"] = max(run[-1]["env_steps"] for run in runs)
        table.append(entry)
    return table


def final_success(run: Sequence[Row]) -> float:
    """Mean success of a run's last evaluations, as many as it takes to hold a success."""
    rates = [row["success_rate"] or 0.0 for row in run[-HOLDING_EVALUATIONS:]]
    return round(float(np.mean(rates)), 3)


def area_under_curve(run: Sequence[Row], env_steps: int) -> float:
    """Mean success over a run's evaluations up to `env_steps`: high where learning is early."""
    return float(
        np.mean([row["success_rate"] or 0.0 for row in run if row["env_steps"] <= env_steps])
    )


def probability_of_improvement(x: np.ndarray, y: np.ndarray, axis: int = -1) -> np.ndarray:
    """P(x > y) for a random pair of runs, ties counted half (Agarwal et al. 2021).

    Args:
        x: scores of one setting's runs, along `axis`.
        y: scores of the other's.
        axis: must be the last one; what `scipy.stats.bootstrap` passes.
    """
    assert axis == -1
    difference = x[..., :, None] - y[..., None, :]
    return np.mean((difference > 0) + 0.5 * (difference == 0), axis=(-2, -1))


def improvement(rows: Sequence[Row], resamples: int = 10_000) -> list[Row]:
    """P(with CGM beats without) per task and algorithm, with a 95 % bootstrap interval.

    Runs are compared by the area under their learning curve, as far as all of them got.
    """
    settings = runs_by_setting(rows)
    table = []
    for one, other in itertools.product(settings, repeat=2):
        if one[:2] != other[:2] or not one[2] or other[2]:
            continue
        pair = [list(settings[key].values()) for key in (one, other)]
        if min(map(len, pair)) < 2:
            continue
        common = min(run[-1]["env_steps"] for runs in pair for run in runs)
        samples = [np.array([area_under_curve(run, common) for run in runs]) for runs in pair]
        probability = float(probability_of_improvement(samples[0], samples[1]))
        interval = stats.bootstrap(
            samples,
            probability_of_improvement,
            n_resamples=resamples,
            method="percentile",
            vectorized=True,
            rng=np.random.default_rng(0),
        ).confidence_interval
        table.append(
            {
                **dict(zip(SETTING, one, strict=True)),
                "seeds_with": len(samples[0]),
                "seeds_without": len(samples[1]),
                "probability_of_improvement": round(probability, 3),
                "low": round(float(interval.low), 3),
                "high": round(float(interval.high), 3),
            }
        )
    return table
