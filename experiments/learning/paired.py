"""Curricula compared by seed: which holds a success sooner, and how sure that is.

The same seed means the same resets and evaluation starts in every arm, and the same first networks
where they have the same shapes. So arms are compared by the differences between runs of a seed.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from experiments.learning.records import RecordedRun, Row
from experiments.learning.setting import CGM, NO_MASKS, Setting
from experiments.learning.tables import (
    LEVELS,
    Runs,
    env_steps_to_hold,
    is_settled,
    left_for_success,
    runs_by_setting,
)

SEEDS_OF_A_CLAIM = 10
"""With fewer pairs a comparison is a screen; below, the bootstrap's interval covers too little."""

CONFIDENCE = 0.95
RESAMPLES = 10_000


class PairedDifference(NamedTuple):
    """Differences between the runs of two settings by seed.

    Attributes:
        differences: one minus the other, in order of seeds.
        mean: their mean.
        low: lower end of Student's 95 % interval of the mean.
        high: upper end.
        p_value: exact, two-sided, of the test that exchanges the two runs of a seed.
    """

    differences: tuple[float, ...]
    mean: float
    low: float
    high: float
    p_value: float


def paired_difference(one: Sequence[float], other: Sequence[float]) -> PairedDifference:
    """Compare two settings by seed; the values of a seed have the same place in both.

    Raises:
        ValueError: fewer than two pairs.
    """
    if len(one) < 2:
        raise ValueError("an interval needs at least two pairs")
    difference = np.subtract(one, other)
    mean, count = float(difference.mean()), len(difference)
    spread = difference.std(ddof=1) / math.sqrt(count)
    reach = float(stats.t.ppf((1 + CONFIDENCE) / 2, count - 1) * spread)
    test = stats.permutation_test(
        (np.asarray(one, float), np.asarray(other, float)),
        lambda x, y, axis: np.mean(x - y, axis=axis),
        permutation_type="samples",
        n_resamples=2 ** len(difference),  # all exchanges: exact
        batch=100_000,
        vectorized=True,
    )
    return PairedDifference(
        tuple(float(value) for value in difference),
        mean,
        mean - reach,
        mean + reach,
        float(test.pvalue),
    )


def probability_of_improvement(x: np.ndarray, y: np.ndarray, axis: int = -1) -> np.ndarray:
    """P(x < y), that a random run of x is the sooner one, ties counted half (Agarwal et al. 2021).

    Args:
        x: environment steps of one setting's runs, along `axis`.
        y: environment steps of the other's.
        axis: must be the last one; what `scipy.stats.bootstrap` passes.
    """
    assert axis == -1
    difference = y[..., None, :] - x[..., :, None]
    return np.mean((difference > 0) + 0.5 * (difference == 0), axis=(-2, -1))


def improvement_interval(x: Sequence[float], y: Sequence[float]) -> tuple[float, float] | None:
    """95 % percentile bootstrap of P(x < y); None below ten seeds, where it covers too little."""
    if min(len(x), len(y)) < SEEDS_OF_A_CLAIM:
        return None
    interval = stats.bootstrap(
        (np.asarray(x), np.asarray(y)),
        probability_of_improvement,
        n_resamples=RESAMPLES,
        method="percentile",
        vectorized=True,
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(interval.low), float(interval.high)


def comparisons(runs: Runs) -> list[Row]:
    """Settings compared by seed, where one thing tells them apart.

    Every curriculum against no masks and against the paper's CGM (10 %, 32); CGM with another
    estimate against the paper's at the same point; agents, what networks see, and stages before the
    goal, against DDPG that sees no masks and pursues no stages.

    Compared are environment steps until a success is held, by the seeds that both have. A run that
    does not hold it by the end of the shorter training of its pair counts as holding it there; an
    arm of which all runs left, since they held the success, counts as trained for as long as the
    other, as longer training would have left it the same. The difference to a run that does not
    hold it is larger than shown, and marked with < or >, and with ? where neither run holds it. The
    mean is marked likewise if all marks agree, and has no interval then; nor where all differences
    are equal, since times are known to one evaluation only. The test is exact since it counts each
    pair to an end that was planned, that of the shorter training whoever left. For P(sooner) all
    runs are counted to one point, `counted_to`. Left out are pairs with fewer than two seeds in
    common, of which no run holds the success, or that left before it.
    """
    settings = runs_by_setting(runs)
    table = []
    for one, other in _pairs(list(settings)):
        seeds = sorted(settings[one].keys() & settings[other].keys())
        for level in LEVELS:
            arms = [[settings[key][seed] for seed in seeds] for key in (one, other)]
            if entry := _comparison(arms, level):
                names = {"task": one.task, "algorithm": one.algorithm}
                names |= {"setting": one.curriculum, "baseline": other.curriculum}
                if one.algorithm != other.algorithm:
                    names |= {"algorithm": "", "setting": _whole(one), "baseline": _whole(other)}
                table.append({**names, "seeds": " ".join(map(str, seeds)), **entry})
    return table


def _whole(setting: Setting) -> str:
    return f"{setting.algorithm}, {setting.curriculum}"


def _pairs(settings: Sequence[Setting]) -> list[tuple[Setting, Setting]]:
    """What is compared with what, and in which order."""
    return [
        (one, other)
        for one in settings
        for other in settings
        if (one.differs_in_masks_alone(other) and _is_baseline_of_masks(other, one))
        or (one.differs_in_learning_alone(other) and _learns_as_the_paper(other))
    ]


def _is_baseline_of_masks(baseline: Setting, setting: Setting) -> bool:
    if setting.masks == NO_MASKS:
        return False
    best = (baseline.masks, baseline.c_g, baseline.kappa) == (CGM, 0.1, 32.0)
    return baseline.masks == NO_MASKS or best or baseline == setting._replace(masks=CGM)


def _learns_as_the_paper(setting: Setting) -> bool:
    further = setting.her_masks or setting.mask_input or setting.stages
    return setting.agent == "ddpg" and not further


def _comparison(arms: Sequence[Sequence[RecordedRun]], level: float) -> Row | None:
    together = [run for arm in arms for run in arm]
    if len(together) < 4 or not all(is_settled(run, level) for run in together):
        return None
    steps = [[env_steps_to_hold(run, level) for run in arm] for arm in arms]
    if np.isinf(steps).all():
        return None
    known = np.min([_known_to(arm) for arm in arms], axis=0)  # of each pair
    planned = np.min([[run.budget for run in arm] for arm in arms], axis=0)
    exact = paired_difference(*np.minimum(steps, planned)).p_value
    paired = paired_difference(*np.minimum(steps, known))
    marks = [_mark(*pair) for pair in zip(*steps, known, strict=True)]
    shortest = min(known.min(), max(run.budget for run in together))
    one, other = np.minimum(steps, shortest)
    improvement = improvement_interval(one, other) or ("", "")
    return {
        "level": level,
        "counted_to": int(shortest),
        "differences": " ".join(
            f"{mark}{difference:.0f}"
            for mark, difference in zip(marks, paired.differences, strict=True)
        ),
        **_mean(paired, {*marks} - {""}),
        "p_value": round(exact, 4),
        "probability_of_improvement": round(float(probability_of_improvement(one, other)), 3),
        "improvement_low": improvement[0],
        "improvement_high": improvement[1],
    }


def _known_to(arm: Sequence[RecordedRun]) -> list[float]:
    """Environment steps up to which it is known of each run of an arm when it holds a success."""
    if all(left_for_success(run) for run in arm):
        return [math.inf] * len(arm)
    return [run.budget for run in arm]


def _mark(one: float, other: float, known: float) -> str:
    """What is known of a difference: nothing to add, a bound, or nothing at all."""
    late = (one > known, other > known)
    return {(True, False): ">", (False, True): "<", (True, True): "?"}.get(late, "")


def _mean(paired: PairedDifference, marks: set[str]) -> Row:
    """The mean difference; its interval where all differences are known and not all are equal."""
    if not marks and paired.low == paired.high:
        return {"mean_difference": round(paired.mean), "low": "", "high": ""}
    if not marks:
        ends = {"low": round(paired.low), "high": round(paired.high)}
        return {"mean_difference": round(paired.mean), **ends}
    bound = next(iter(marks)) if len(marks) == 1 else "?"
    mean = "" if bound == "?" else f"{bound}{paired.mean:.0f}"
    return {"mean_difference": mean, "low": "", "high": ""}
