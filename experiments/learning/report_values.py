"""Numbers in sentences of the report about learning, from the records."""

import itertools
import math
from collections.abc import Callable, Collection, Iterable, Sequence
from statistics import median

from experiments.learning.plans import read_plans, runs_of
from experiments.learning.records import (
    SWEEPS,
    RecordedRun,
    is_whole,
    recorded_runs,
    recorded_settings,
)
from experiments.learning.report_tables import FULL_GOAL
from experiments.learning.setting import NO_MASKS
from experiments.learning.tables import (
    env_steps_to_hold,
    in_order_of_seeds,
    runs_by_setting,
    wall_s_to_hold,
    window_means,
)
from experiments.markdown import NOT_YET, counted, in_words, percent
from experiments.table import read_table


def number_of_trials() -> str:
    """How many trials of settings there are notes of."""
    return str(len(_trials()))


def undecided_trials() -> str:
    """Of trials that never reached 50 %, those stopped before a run like it without the change.

    "11 of 15": a change is compared with the latest 50 % of a run with the same task, networks and
    updates of the actor, and no change; trials without such a run are left out.
    """
    baselines: dict[tuple[str, ...], int] = {}
    alike = ("env", "cgm", "layers", "actor_update_every")
    for row in _trials():
        if row["change"] == "none" and row["env_steps_to_50"]:
            key = tuple(row[name] for name in alike)
            baselines[key] = max(baselines.get(key, 0), int(row["env_steps_to_50"]))
    never = [
        (int(row["stopped_at"]), baselines[key])
        for row in _trials()
        if row["change"] != "none" and not row["env_steps_to_50"]
        if (key := tuple(row[name] for name in alike)) in baselines
    ]
    early = sum(stopped <= baseline for stopped, baseline in never)
    return f"{early} of {len(never)}"


def _trials() -> list[dict[str, str]]:
    return read_table(SWEEPS.parent / "cpu_settings" / "tried.csv")


def records_of(question: str) -> str:
    """Links to the learning curves of a question's sweeps that are on record."""
    sweeps = [
        f"[{sweep}](results/sweeps/{sweep}/learning.csv)"
        for sweep in read_plans().questions[question].sweeps
        if recorded_runs(sweep)
    ]
    return ", ".join(sweeps) or "none yet"


def not_trained(question: str) -> str:
    """The sweeps of a question that are not on record, or not with all of their runs."""
    sweeps = read_plans().questions[question].sweeps
    missing = (
        f"`{sweep}`" + (f" ({len(runs)} of {len(recorded_settings(sweep))} runs are)" * bool(runs))
        for sweep in sweeps
        if not is_whole(sweep)
        for runs in [recorded_runs(sweep)]
    )
    return ", ".join(missing) or "nothing"


def held_by(sweeps: str, level: str) -> str:
    """How many seeds hold a success by the end, such as "five of five seeds", of each sweep.

    Args:
        sweeps: one, or several with commas between them, of which the same is so; "a+b" are two
            sweeps of one setting taken together, as tables do.
        level: in percent.

    Raises:
        ValueError: not the same is so of all, or a run that does not hold it was trained for less
            long than another that does not, or than one took to hold it.
    """
    arms = _arms(sweeps)
    if not all(arms):
        return NOT_YET
    for runs in arms:
        steps = [env_steps_to_hold(run, int(level) / 100) for run in runs]
        ends = {run.budget for run, held in zip(runs, steps, strict=True) if math.isinf(held)}
        last = max((held for held in steps if math.isfinite(held)), default=0)
        if len(ends) > 1 or (ends and min(ends) < last):
            raise ValueError(f"{sweeps}: not all seeds were trained as long for {level} %")
    return _of_each(_held(runs, int(level) / 100) for runs in arms)


def sooner(ones: str, others: str, level: str) -> str:
    """In how many seeds one sweep holds a success before another, "five of five seeds".

    Args:
        ones: the sweep, or several; see `held_by`.
        others: the other, or others alike.
        level: in percent.

    Raises:
        ValueError: it is not known of a seed, since training of the other run ended before.
    """
    first, second = _arms(ones), _arms(others)
    if not all([*first, *second]):
        return NOT_YET
    pairs = itertools.product(first, second)
    return _of_each(_sooner(*pair, int(level) / 100) for pair in pairs)


def _arms(sweeps: str) -> list[list[RecordedRun]]:
    """Runs of sweeps with commas between them; none of one that is planned and not on record."""
    return [_runs(names) for names in sweeps.split(",")]


def _runs(sweeps: str) -> list[RecordedRun]:
    """Runs on record of one setting, which one sweep holds or, such as "a+b", several.

    Raises:
        ValueError: no such sweep is planned, or they hold several settings.
    """
    runs = [run for name in sweeps.split("+") for run in _recorded(name)]
    return in_order_of_seeds(runs) if runs else []


def _recorded(sweep: str) -> list[RecordedRun]:
    """Runs on record of a sweep.

    Raises:
        ValueError: none of that name is planned.
    """
    if sweep not in read_plans().sweeps:
        raise ValueError(f"README.md: no sweep {sweep!r} is planned")
    return recorded_runs(sweep)


def _sooner(one: Sequence[RecordedRun], other: Sequence[RecordedRun], level: float) -> str:
    others = {run.seed: run for run in other}
    pairs = [(run, others[run.seed]) for run in one if run.seed in others]
    return _of_seeds(sum(_is_sooner(*pair, level) for pair in pairs), pairs)


def _is_sooner(one: RecordedRun, other: RecordedRun, level: float) -> bool:
    steps = [env_steps_to_hold(run, level) for run in (one, other)]
    if min(one.budget, other.budget) < min(steps) < math.inf:
        names = f"{one.sweep} and {other.sweep}, seed {one.seed}"
        raise ValueError(f"{names}: which is sooner is not known, as one was not trained so far")
    return steps[0] < steps[1]


def least_ratio(one: str, other: str, level: str) -> str:
    """How many times the environment steps of one sweep another takes, in the seed of the least.

    A run of the other that does not hold the success counts as if it did so where it ended.
    """
    ones, others = _runs(one), {run.seed: run for run in _runs(other)}
    if not ones or not others:
        return NOT_YET
    ratios = [
        min(env_steps_to_hold(others[run.seed], int(level) / 100), others[run.seed].budget) / steps
        for run, steps in zip(ones, _finite_steps(ones, level), strict=True)
        if run.seed in others
    ]
    return f"{math.floor(10 * min(ratios)) / 10:g}"


def saved_less(one: str, than: str, other: str, than_other: str, level: str) -> str:
    """In how many seeds `one` saves fewer steps against `than` than `other` against `than_other`.

    A run of `than_other` that never holds the success counts as if it did so where it ended.
    """
    sweeps = [{run.seed: run for run in _runs(name)} for name in (one, than, other, than_other)]
    if not all(sweeps):
        return NOT_YET
    seeds = [seed for seed in sweeps[0] if all(seed in runs for runs in sweeps)]
    steps = [_finite_steps([runs[seed] for seed in seeds], level) for runs in sweeps[:3]]
    last = [sweeps[3][seed] for seed in seeds]
    steps.append([min(env_steps_to_hold(run, int(level) / 100), run.budget) for run in last])
    rows = zip(*steps, strict=True)
    fewer = [before - now < then_before - then for now, before, then, then_before in rows]
    return _of_seeds(sum(fewer), seeds)


def _held(runs: Sequence[RecordedRun], level: float) -> str:
    return _of_seeds(sum(math.isfinite(env_steps_to_hold(run, level)) for run in runs), runs)


def _of_seeds(number: int, of: Collection[object]) -> str:
    return f"{in_words(number)} of {counted(len(of), 'seed')}"


def _of_each(said: Iterable[str]) -> str:
    """What is said of each alike.

    Raises:
        ValueError: not the same.
    """
    alike = {*said}
    if len(alike) != 1:
        raise ValueError(f"not the same is so of each: {', '.join(sorted(alike))}")
    return alike.pop()


def held_at(question: str, env: str, c_g: str, kappa: str) -> str:
    """How many seeds of a point of a grid hold 50 %, such as "none of three seeds"."""
    (seeds,) = (
        seeds
        for setting, seeds in runs_by_setting(runs_of(question)).items()
        if (setting.env, setting.c_g, setting.kappa) == (env, float(c_g), float(kappa))
    )
    return _held(list(seeds.values()), 0.5)


def points_sooner(question: str, env: str) -> str:
    """At how many points of a grid every seed holds 50 % before its run without masks."""
    settings = {s: runs for s, runs in runs_by_setting(runs_of(question)).items() if s.env == env}
    (plain,) = (runs for setting, runs in settings.items() if setting.masks == NO_MASKS)
    points = [runs for setting, runs in settings.items() if setting.c_g is not None]
    sooner_points = sum(
        all(env_steps_to_hold(runs[i], 0.5) < env_steps_to_hold(plain[i], 0.5) for i in runs)
        for runs in points
    )
    return f"{in_words(sooner_points)} of {counted(len(points), 'point')}"


def budget(sweep: str) -> str:
    """Environment steps that runs of a sweep were to train for."""
    runs = _recorded(sweep)
    return f"{max(run.budget for run in runs):,}" if runs else NOT_YET


def latest(sweep: str, level: str) -> str:
    """Environment steps until the last seed holds a success."""
    runs = _runs(sweep)
    return f"{max(_finite_steps(runs, level)):,.0f}" if runs else NOT_YET


def held_in(sweep: str, level: str, seed: str, c_g: str = "", kappa: str = "") -> str:
    """Environment steps until a seed holds a success; of a grid, at the point that is named."""
    runs = _at(_recorded(sweep), float(c_g), float(kappa)) if c_g else _runs(sweep)
    if not runs:
        return NOT_YET
    (run,) = (run for run in runs if run.seed == int(seed))
    return f"{_finite_steps([run], level)[0]:,.0f}"


def _at(runs: Sequence[RecordedRun], c_g: float, kappa: float) -> list[RecordedRun]:
    return [run for run in runs if (run.setting.c_g, run.setting.kappa) == (c_g, kappa)]


def _finite_steps(runs: Sequence[RecordedRun], level: str) -> list[float]:
    steps = [env_steps_to_hold(run, int(level) / 100) for run in runs]
    if not all(map(math.isfinite, steps)):
        raise ValueError(f"{runs[0].sweep}: not all seeds hold {level} %")
    return steps


def seconds(sweep: str, level: str) -> str:
    """From when to when seeds hold a success, in seconds since training began."""
    runs = _runs(sweep)
    if not runs:
        return NOT_YET
    _finite_steps(runs, level)
    walls = [wall_s_to_hold(run, int(level) / 100) for run in runs]
    return f"{min(walls):.0f} to {max(walls):.0f}"


def pace(question: str) -> str:
    """Seconds of an epoch in the median, of the run with the least and of that with the most."""
    medians = []
    for run in runs_of(question):
        walls = [row["wall_s"] for row in run.rows]
        medians.append(median(after - before for before, after in itertools.pairwise(walls)))
    return f"{min(medians):.1f} to {max(medians):.1f}" if medians else NOT_YET


def probability_of_full_goal(sweep: str) -> str:
    """How often the full goal is drawn when all estimates are 100 %."""
    drawn = {
        row["mask_probability"][FULL_GOAL]
        for run in _recorded(sweep)
        for row in run.rows
        if row["mask_rate_estimated"] and set(row["mask_rate_estimated"]) == {1.0}
    }
    if not drawn:
        return NOT_YET
    return _from_to(drawn, 1)


def moved(sweep: str, end: str) -> str:
    """In which share of a run's training episodes the achieved goal moved, from seed to seed.

    Args:
        sweep: of one setting.
        end: environment steps up to which episodes are counted.
    """
    ends = [int(end)]
    shares = [window_means([run], ends, "moved_share")[ends[0]] for run in _runs(sweep)]
    return _from_to(shares) if shares else NOT_YET


def _from_to(shares: Collection[float], decimals: int = 0) -> str:
    low, high = percent(min(shares), decimals), percent(max(shares), decimals)
    return high if low == high else f"{low} to {high}"


def commits_of(table: str) -> str:
    """The commits that made the rows of a table, such as "commit `0123456` (with changes)".

    Args:
        table: its path in results/.
    """
    rows = read_table(SWEEPS.parent / table)
    commits = sorted({row["commit"] for row in rows})
    named = [
        f"`{commit[:7]}`" + " (with changes)" * commit.endswith("-dirty") for commit in commits
    ]
    return f"commit{'s' * (len(named) > 1)} {', '.join(named)}"


def smallest_p(pairs: str) -> str:
    """The smallest p-value that an exact two-sided test of so many pairs can give."""
    return f"{2 / 2 ** int(pairs):.2g}"


def standard_error(episodes: str) -> str:
    """Of a success rate of 50 % from so many episodes, in points."""
    return f"{100 * math.sqrt(0.25 / int(episodes)):.0f}"


VALUES: dict[str, Callable[..., str]] = {
    "records_of": records_of,
    "not_trained": not_trained,
    "held_by": held_by,
    "sooner": sooner,
    "least_ratio": least_ratio,
    "saved_less": saved_less,
    "held_at": held_at,
    "points_sooner": points_sooner,
    "budget": budget,
    "latest": latest,
    "held_in": held_in,
    "seconds": seconds,
    "pace": pace,
    "probability_of_full_goal": probability_of_full_goal,
    "moved": moved,
    "commits_of": commits_of,
    "smallest_p": smallest_p,
    "standard_error": standard_error,
    "number_of_trials": number_of_trials,
    "undecided_trials": undecided_trials,
}
