"""Tables of the report, from rows of metrics.jsonl."""

import csv
import itertools
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from cgm_jax.statistics import HOLDING_EVALUATIONS, first_to_reach, quartiles

Row = dict[str, Any]
LEVELS = (0.5, 0.9)
ESTIMATES = {"product": "CGM", "joint": "CGM, joint rates", "measured": "CGM, masks measured"}


class Setting(NamedTuple):
    """What the seeds of a line, or of a row of a table, have in common.

    `her_filter` is whether hindsight comes only from episodes that moved the achieved goal.
    Without CGM, c_g and kappa are None; so is c_g where masks are drawn uniformly (kappa = 0).
    `estimate` is how the curriculum knows the success of masks: as the product of sub-goal rates
    (the paper), by joint rates, or measured.
    """

    env: str
    her: bool
    her_filter: bool
    cgm: bool
    c_g: float | None
    kappa: float | None
    estimate: str

    @property
    def algorithm(self) -> str:
        """What learns, in words."""
        if not self.her:
            return "DDPG"
        return "DDPG + HER" if self.her_filter else "DDPG + HER (from all episodes)"

    @property
    def curriculum(self) -> str:
        """Where masks come from, in words."""
        if not self.cgm:
            return "no CGM"
        if self.kappa == 0:
            return "uniform masks"
        return f"{ESTIMATES[self.estimate]} ({100 * (self.c_g or 0.0):g} %, {self.kappa:g})"


def setting_of(row: Row) -> Setting:
    """The setting of a metrics row."""
    c_g = row["c_g"] if row["cgm"] and row["kappa"] else None
    kappa = row["kappa"] if row["cgm"] else None
    estimate = "product" if c_g is None else row["estimate"]
    her_filter = row["her"] and row["her_filter"]
    return Setting(row["env"], row["her"], her_filter, row["cgm"], c_g, kappa, estimate)


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write rows, all with the keys of the first, as CSV."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def runs_by_setting(rows: Sequence[Row]) -> dict[Setting, dict[int, list[Row]]]:
    """Rows in order of epochs, by setting and seed.

    Raises:
        ValueError: two runs share a setting and a seed.
    """
    settings: dict[Setting, dict[int, list[Row]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        run = settings[setting_of(row)][row["seed"]]
        if run and (run[0]["sweep"], run[0]["run"]) != (row["sweep"], row["run"]):
            raise ValueError(f"{run[0]['run']} and {row['run']} are the same run twice")
        run.append(row)
    return {setting: dict(seeds) for setting, seeds in settings.items()}


def learning_speed(rows: Sequence[Row]) -> list[Row]:
    """Per setting: how soon its seeds reach 50 and 90 % success, and where they end.

    A level is reached at the first evaluation that shows it. Medians (of env_steps also the
    quartiles) over seeds; empty where that quartile of the seeds never reaches it. Empty as well:
    seconds of runs that trained side by side, and what lies beyond the success at which runs left.
    """
    table = []
    for setting, seeds in runs_by_setting(rows).items():
        runs = list(seeds.values())
        entry: Row = {**setting._asdict(), "seeds": len(runs)}
        leave_at = min((run[0]["leave_at"] or 1.0) for run in runs)
        for level in LEVELS:
            arrivals = _arrivals(runs, level)
            if level > leave_at:
                arrivals = dict.fromkeys(arrivals, "")
            entry |= {f"{name}_{100 * level:.0f}": value for name, value in arrivals.items()}
        ends = [final_success(run) for run in runs]
        last = (round(float(np.median(ends)), 3), min(ends)) if leave_at == 1.0 else ("", "")
        entry |= dict(zip(("final_success", "worst_seed"), last, strict=True))
        entry["env_steps"] = max(run[-1]["env_steps"] for run in runs)
        table.append(entry)
    return table


def _arrivals(runs: Sequence[Sequence[Row]], level: float) -> Row:
    """How many runs reach a success, and when; the names end where the level goes."""
    reached = [first_to_reach(run, level) for run in runs]
    low, median, high = quartiles([row["env_steps"] if row else np.inf for row in reached])
    seconds = quartiles([row["wall_s"] if row else np.inf for row in reached])[1]
    alone = all(run[0]["alone"] for run in runs)
    return {
        "reach": sum(row is not None for row in reached),
        "env_steps_to": _or_empty(median),
        "low_quartile_to": _or_empty(low),
        "high_quartile_to": _or_empty(high),
        "wall_s_to": _or_empty(seconds) if alone else "",
    }


def _or_empty(value: float) -> int | str:
    return round(value) if np.isfinite(value) else ""


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
    """P(one setting beats another) per task and algorithm, with a 95 % bootstrap interval.

    Every way to draw masks is compared with none, and the paper's CGM with the other ways: masks
    drawn uniformly, or whose success is known otherwise than as a product. Runs are compared by the
    area under their learning curve, as far as all of them got; runs that may leave early are left
    out.
    """
    settings = runs_by_setting([row for row in rows if row["leave_at"] is None])
    table = []
    for one, other in itertools.product(settings, repeat=2):
        alike = (one.env, one.algorithm) == (other.env, other.algorithm)
        if not alike or _rank(one) <= _rank(other):
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
                "env": one.env,
                "algorithm": one.algorithm,
                "setting": one.curriculum,
                "baseline": other.curriculum,
                "env_steps": common,
                "seeds": len(samples[0]),
                "baseline_seeds": len(samples[1]),
                "probability_of_improvement": round(probability, 3),
                "low": round(float(interval.low), 3),
                "high": round(float(interval.high), 3),
            }
        )
    return table


def _rank(setting: Setting) -> int:
    """2 is the paper's CGM, 1 another way to draw masks, 0 no masks."""
    if not setting.cgm:
        return 0
    return 1 if setting.kappa == 0 or setting.estimate != "product" else 2
