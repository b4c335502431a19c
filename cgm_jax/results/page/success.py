"""Final success of runs, with intervals that say how much it can be trusted."""

from collections.abc import Mapping, Sequence
from typing import Any

from cgm_jax.results.figures.runs import TrainedRun
from cgm_jax.results.statistics import (
    HOLDING_EVALUATIONS,
    median_interval,
    quartiles,
    wilson_interval,
)
from cgm_jax.storage.metrics import Row

MAX_EPISODES = 10**6
"""Of an evaluation, as its setting allows; a config from elsewhere may say anything."""


def final_success(run: TrainedRun, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Success over a run's last evaluations taken together, as `holds` judges it.

    Args:
        run: with at least one row.
        settings: its values in config.json, which tell how many episodes an evaluation has.

    Returns:
        `rate`, `evaluations` behind it, whether no evaluation of the run ever had a valid episode,
        `never_valid`, and, where all episodes behind the rate were valid, their number `episodes`
        and Wilson's 95 % interval, `low` to `high`. It tells how well the policies of this run are
        known, not how other seeds would do.
    """
    rows = run.rows[-HOLDING_EVALUATIONS:]
    rate = sum(row["success_rate"] or 0.0 for row in rows) / len(rows)
    found: dict[str, Any] = {
        "rate": rate,
        "evaluations": len(rows),
        "never_valid": run.never_valid,
    }
    each = settings.get("evaluation_episodes")
    if not isinstance(each, int) or not 1 <= each <= MAX_EPISODES:
        return found
    if any(_valid(row, each) != each for row in rows):
        return found
    episodes = each * len(rows)
    low, high = wilson_interval(min(round(rate * episodes), episodes), episodes)
    return found | {"episodes": episodes, "low": low, "high": high}


def _valid(row: Row, each: int) -> int:
    """How many of `each` episodes of an evaluation were valid."""
    if "evaluated_episodes" in row:
        return row["evaluated_episodes"]
    # Versions before counted all that were dropped, in training as well.
    return 0 if row["success_rate"] is None or row.get("physics_warnings") else each


def success_over_seeds(rates: Sequence[float]) -> dict[str, Any]:
    """Median over seeds; and its 95 % interval, `low` to `high`, where seeds suffice for one."""
    interval = median_interval(rates)
    ends = {} if interval is None else {"low": interval[0], "high": interval[1]}
    return {"median": quartiles(rates)[1], **ends}
