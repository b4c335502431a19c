"""Tables of learning: how soon runs hold a success, and where they end."""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np

from cgm_jax.results.statistics import HOLDING_EVALUATIONS, first_to_hold, quartiles
from experiments.learning.records import RecordedRun, Row
from experiments.learning.setting import Setting

LEVELS = (0.5, 0.9)

Runs = Sequence[RecordedRun]


def runs_by_setting(runs: Runs) -> dict[Setting, dict[int, RecordedRun]]:
    """Runs by setting and seed, in order of seeds.

    Raises:
        ValueError: two runs share a setting and a seed, or one setting and differ in what it does
            not tell.
    """
    settings: dict[Setting, dict[int, RecordedRun]] = defaultdict(dict)
    for run in sorted(runs, key=lambda run: run.seed):
        same = settings[run.setting]
        for other in list(same.values())[:1]:
            if differing := _apart(run, other):
                names = f"{run.sweep} and {other.sweep}"
                raise ValueError(f"{names} differ in {differing[0]}, which no table would say")
        if run.seed in same:
            names = f"{run.sweep} and {same[run.seed].sweep}"
            raise ValueError(f"{names} hold the same run, seed {run.seed}")
        same[run.seed] = run
    in_order = dict.fromkeys(run.setting for run in runs)
    return {setting: settings[setting] for setting in in_order}


def _apart(one: RecordedRun, other: RecordedRun) -> list[str]:
    """Settings that may not differ between runs of which tables say that they had the same."""
    free = {"seed", "epochs", "leave_at"}
    names = sorted({*one.settings, *other.settings} - free)
    return [name for name in names if one.settings.get(name) != other.settings.get(name)]


def in_order_of_seeds(runs: Runs) -> list[RecordedRun]:
    """Runs of one setting, in order of seeds.

    Raises:
        ValueError: they have several settings.
    """
    settings = runs_by_setting(runs)
    if len(settings) != 1:
        names = ", ".join(dict.fromkeys(run.sweep for run in runs))
        raise ValueError(f"{names}: {len(settings)} settings, not one")
    (seeds,) = settings.values()
    return list(seeds.values())


def env_steps_to_hold(run: RecordedRun, level: float) -> float:
    """Environment steps until a run holds a success; infinite if it never does.

    Raises:
        ValueError: it left before it could.
    """
    if not is_settled(run, level):
        raise ValueError(f"{run.sweep}: runs left before they could hold {level:g}")
    row = first_to_hold(run.rows, level)
    return row["env_steps"] if row else math.inf


def wall_s_to_hold(run: RecordedRun, level: float) -> float:
    """Seconds since a run's training began until it holds a success; infinite if it never does.

    Raises:
        ValueError: it left before it could, or has no seconds of its own.
    """
    if not run.alone:
        raise ValueError(f"{run.sweep}: runs trained side by side have no seconds of their own")
    steps = env_steps_to_hold(run, level)
    return next((row["wall_s"] for row in run.rows if row["env_steps"] == steps), math.inf)


def is_settled(run: RecordedRun, level: float) -> bool:
    """Whether a run was trained far enough to tell if it holds a success."""
    leave_at = run.settings["leave_at"]
    return leave_at is None or level <= leave_at


def left_early(run: RecordedRun) -> bool:
    """Whether a run left before its end, since it held the success that it was trained for."""
    return run.rows[-1]["env_steps"] < run.budget


def left_for_success(run: RecordedRun) -> bool:
    """Whether a run held the success at which it was to leave, so that it ended there."""
    leave_at = run.settings["leave_at"]
    return leave_at is not None and math.isfinite(env_steps_to_hold(run, leave_at))


def final_success(run: RecordedRun) -> float:
    """Mean success of a run's last evaluations, as many as it takes to hold a success."""
    rates = [row["success_rate"] or 0.0 for row in run.rows[-HOLDING_EVALUATIONS:]]
    return round(float(np.mean(rates)), 3)


def learning_speed(runs: Runs) -> list[Row]:
    """Per setting: how soon its seeds hold 50 and 90 % success, and where they end.

    Of every seed the environment steps, and the seconds where it trained alone; a dash where it
    never holds the level. Medians and quartiles are interpolated; a dash where they lie between a
    run that arrived and one that did not, a question mark where a run was trained for too short to
    tell. Empty is what lies beyond the success at which runs stopped early.
    """
    table = []
    by_setting = runs_by_setting(runs)
    # Stages have a column in tables of runs of which some have them.
    without = set() if any(setting.stages for setting in by_setting) else {"stages"}
    for setting, seeds in by_setting.items():
        same = list(seeds.values())
        told = {name: value for name, value in setting._asdict().items() if name not in without}
        entry: Row = {**told, "seeds": " ".join(map(str, seeds))}
        for level in LEVELS:
            settled = all(is_settled(run, level) for run in same)
            arrivals = _arrivals(same, level) if settled else dict.fromkeys(ARRIVALS, "")
            entry |= {f"{name}_{100 * level:.0f}": value for name, value in arrivals.items()}
        entry["final_success"] = " ".join(
            "left" if left_early(run) else str(final_success(run)) for run in same
        )
        entry["trained_to"] = max(run.rows[-1]["env_steps"] for run in same)
        table.append(entry)
    return table


ARRIVALS = (
    *("held_by", "env_steps_to", "median_to", "low_quartile_to", "high_quartile_to"),
    "wall_s_to",
)
"""What there is to say of a level; the level's name follows."""


def quartiles_to_hold(runs: Runs, level: float) -> list[float]:
    """Quartiles of the environment steps until runs hold a success, see `statistics.quartiles`.

    NaN is one that is not known: a run was trained for less long than another took to hold it, and
    might have held it in between.

    Raises:
        ValueError: a run left before it could hold it.
    """
    steps = [env_steps_to_hold(run, level) for run in runs]
    last = max((number for number in steps if math.isfinite(number)), default=0)
    soonest = [
        run.budget if math.isinf(number) and run.budget < last else number
        for run, number in zip(runs, steps, strict=True)
    ]
    ends = zip(quartiles(soonest), quartiles(steps), strict=True)
    return [early if early == late else math.nan for early, late in ends]


def _arrivals(runs: Runs, level: float) -> Row:
    """When runs hold a success; the names end where the level goes."""
    steps = [env_steps_to_hold(run, level) for run in runs]
    alone = all(run.alone for run in runs)
    seconds = [wall_s_to_hold(run, level) for run in runs] if alone else []
    low, median, high = quartiles_to_hold(runs, level)
    values = (
        sum(map(math.isfinite, steps)),
        " ".join(map(dash_or_number, steps)),
        *map(dash_or_number, (median, low, high)),
        " ".join(map(dash_or_number, seconds)),
    )
    return dict(zip(ARRIVALS, values, strict=True))


def dash_or_number(value: float) -> str:
    """A whole number, a dash for what never came, or a question mark for what is not known."""
    return "?" if math.isnan(value) else f"{value:.0f}" if math.isfinite(value) else "-"


def metrics_of(runs: Runs) -> list[Row]:
    """The metrics rows of all runs, as figures take them."""
    return [row for run in runs for row in run.rows]


def window_means(
    runs: Runs, ends: Sequence[int], value: str, mask: int | None = None
) -> Mapping[int, float]:
    """Mean of a metric over the epochs of all runs up to each end and beyond the one before.

    Args:
        runs: of one setting.
        ends: environment steps.
        value: name of the metric; epochs where it is unknown are left out.
        mask: which mask, of a metric per mask.

    Returns:
        Mean by end, NaN where the metric is unknown throughout.
    """
    known: dict[int, list[float]] = {end: [] for end in ends}
    for row in metrics_of(runs):
        number = row.get(value)
        if isinstance(number, list):
            number = number[mask if mask is not None else -1] if number else None
        end = next((end for end in ends if row["env_steps"] <= end), None)
        if number is not None and end is not None:
            known[end].append(number)
    return {end: float(np.mean(values)) if values else math.nan for end, values in known.items()}
