"""Tables of the report about learning, from the records."""

import math
from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import Any

from cgm_jax.config.grid import build_groups
from cgm_jax.results.statistics import first_to_hold
from experiments.learning.calibration_errors import ESTIMATES, MEASURED, calibration_errors
from experiments.learning.paired import comparisons
from experiments.learning.plans import read_plans, runs_of
from experiments.learning.records import (
    SWEEPS,
    RecordedRun,
    is_whole,
    recorded_config,
    recorded_runs,
    recorded_settings,
    settings_of,
    together,
)
from experiments.learning.setting import NO_MASKS
from experiments.learning.tables import (
    LEVELS,
    Runs,
    env_steps_to_hold,
    final_success,
    in_order_of_seeds,
    is_settled,
    left_early,
    quartiles_to_hold,
    runs_by_setting,
    wall_s_to_hold,
    window_means,
)
from experiments.markdown import Table, percent, without_constant_columns
from experiments.table import read_table

EPISODE_STEPS = 50
FULL_GOAL, X_AND_Y, Z = 7, 6, 1
"""Masks of three dimensions, by what they keep."""


def conditions() -> Table:
    """What made the records: commit, cores, how many runs trained side by side."""
    rows = []
    for sweep in read_plans().sweeps:
        config, runs = recorded_config(sweep), recorded_runs(sweep)
        if config and runs:
            cores = config["machine"].rpartition(", ")[2]
            largest = max(together(group) for group in config["groups"])
            numbers = [str(len(runs)), str(largest), f"{max(run.budget for run in runs):,}"]
            rows.append([f"`{sweep}`", _commit(config), cores, *numbers])
    header = ["sweep", "commit", "cores", "runs", "side by side", "environment steps, at most"]
    return Table(header, rows)


def _commit(config: Mapping[str, Any]) -> str:
    """At which commit a sweep began, and whether anything was different then or later."""
    commit = str(config["commit"])
    changed = ", with changes" if commit.endswith("-dirty") else ""
    resumed = ", resumed with changes" if config.get("resumed") else ""
    return f"`{commit[:7]}`{changed}{resumed}"


def planned() -> Table:
    """Questions of which sweeps are planned and not on record, and what they would take."""
    plans = read_plans()
    rows = []
    for name, question in plans.questions.items():
        missing = [sweep for sweep in question.sweeps if not is_whole(sweep)]
        if missing:
            trained = len(question.sweeps) - len(missing)
            of = f"{len(missing)} of {len(question.sweeps)}" if trained else "all"
            rows.append([question.text, f"`{name}`", of])
    return Table(
        ["question", "name", "sweeps not trained"], rows, "All that is planned is trained."
    )


def differences_from_the_paper() -> Table:
    """Settings of the experiments with HER beside the paper's, where they differ."""
    columns: list[dict[str, str]] = []
    for env, sweep in (("push", "push_her_cgm"), ("pick_and_place", "pick_and_place_her_cgm")):
        paper = build_groups("paper", {"env": [env], "seed": [0], "her": [True]})
        of_paper = settings_of(paper[0].runs[0])
        columns += [_described(recorded_settings(sweep)[0][1]), _described(of_paper)]
    header = ["", "push here", "push, paper", "pick-and-place here", "pick-and-place, paper"]
    rows = [[name, *(column[name] for column in columns)] for name in columns[0]]
    return Table(header, [row for row in rows if row[1] != row[2] or row[3] != row[4]])


def _described(settings: Mapping[str, Any]) -> dict[str, str]:
    """Settings as somebody would compare them, whatever they are called."""
    env_steps = settings["environments"] * EPISODE_STEPS
    updates = settings["updates_per_cycle"]
    moves = 40 / settings["target_update_every"]
    return {
        "environment steps per epoch": f"{env_steps * settings['cycles_per_epoch']:,}",
        "episodes per cycle": str(settings["environments"]),
        "updates of the critic per 1,000 environment steps": f"{1000 * updates / env_steps:g}",
        "updates of the critic for each of the actor": str(settings["actor_update_every"]),
        "transitions per update": f"{settings['batch_size']:,}",
        "target networks move, in 40 updates": percent(1 - (1 - settings["target_rate"]) ** moves),
        "hidden layers": " x ".join(map(str, settings["hidden_layers"])),
        "replay buffer, transitions": f"{settings['replay_transitions']:,}",
        "hindsight from": "moved the block" if settings["her_filter"] else "all episodes",
        "a random action lasts, steps": str(settings["random_action_steps"]),
        "evaluated": "target actor" if settings["evaluate_target"] else "actor",
        "episodes per evaluation": str(settings["evaluation_episodes"]),
    }


def speed(question: str) -> Table:
    """When the seeds of a question's settings hold 50 and 90 %, and where they end."""
    rows = []
    for setting, seeds in runs_by_setting(runs_of(question)).items():
        runs = list(seeds.values())
        masks = setting.curriculum + _which(list(seeds))
        row = [setting.task, setting.algorithm, masks]
        for level in LEVELS:
            row += _held(runs, level)
        row.append(", ".join(_end(run) for run in runs))
        row.append(f"{max(run.rows[-1]['env_steps'] for run in runs) / 1000:,g}")
        rows.append(row)
    header = ["task", "algorithm", "masks"]
    for level in LEVELS:
        header += [f"{percent(level)} held, by seed", "median (quartiles)"]
    header += ["end, %, by seed", "trained to"]
    return without_constant_columns(Table(header, rows), 3)


def seconds_to_hold(question: str) -> Table:
    """Seconds since training began until a question's runs hold 50 and 90 %."""
    rows = []
    for setting, seeds in runs_by_setting(runs_of(question)).items():
        row = [setting.task, setting.algorithm, setting.curriculum + _which(list(seeds))]
        for level in LEVELS:
            seconds = [wall_s_to_hold(run, level) for run in seeds.values()]
            row += [", ".join(map(_whole, seconds)), _whole(median(seconds))]
        rows.append(row)
    header = ["task", "algorithm", "masks"]
    for level in LEVELS:
        header += [f"{percent(level)} held, seconds by seed", "median"]
    return without_constant_columns(Table(header, rows), 3)


def trained_twice(first: str, second: str, level: str) -> Table:
    """When two trainings of the same settings, of one question each, hold a level (in percent)."""
    trainings = [runs_by_setting(runs_of(question)) for question in (first, second)]
    rows = []
    for setting in trainings[1]:
        both = [seed for seed in trainings[1][setting] if seed in trainings[0].get(setting, {})]
        if both:
            row = [setting.task, setting.algorithm, setting.curriculum + _which(both)]
            for training in trainings:
                row += _held([training[setting][seed] for seed in both], int(level) / 100)
            rows.append(row)
    header = ["task", "algorithm", "masks"]
    for training in ("first", "second"):
        header += [f"{level} % held, {training} training, by seed", "median (quartiles)"]
    return without_constant_columns(Table(header, rows), 3)


def _which(seeds: Sequence[int]) -> str:
    """Which seeds, where they are not the first ones."""
    if list(seeds) == list(range(len(seeds))):
        return ""
    return f", seeds {', '.join(map(str, seeds))}"


def _end(run: RecordedRun) -> str:
    """Success at the end in percent, of a run that was seen to its end."""
    return "left" if left_early(run) else _number(100 * final_success(run))


def _held(runs: Runs, level: float) -> list[str]:
    """Two cells: thousands of environment steps until a level is held, and their quartiles."""
    if not all(is_settled(run, level) for run in runs):
        return ["not trained for", ""]
    steps = [env_steps_to_hold(run, level) for run in runs]
    low, median, high = (_thousands(value) for value in quartiles_to_hold(runs, level))
    spread = median if low == high else f"{median} ({low} to {high})"
    longest = max(run.budget for run in runs)
    said = [
        f"never by {run.budget / 1000:,g}"
        if math.isinf(number) and run.budget < longest
        else _thousands(number)
        for run, number in zip(runs, steps, strict=True)
    ]
    return [", ".join(said), spread]


def _thousands(value: float) -> str:
    return _number(value / 1000)


def _number(value: float) -> str:
    if math.isnan(value):
        return "?"
    return f"{round(value, 1):g}" if math.isfinite(value) else "never"


def _whole(value: float) -> str:
    return f"{value:.0f}" if math.isfinite(value) else "never"


def _by_seed(values: Sequence[float]) -> str:
    return ", ".join(map(_number, values))


def paired(question: str, level: str = "") -> Table:
    """Curricula of a question compared by seed, at both levels or one of them (in percent)."""
    rows = []
    for entry in comparisons(runs_of(question)):
        if level and round(100 * entry["level"]) != int(level):
            continue
        seeds = [int(seed) for seed in entry["seeds"].split()]
        mean = _difference(str(entry["mean_difference"]))
        if entry["low"] != "":
            mean += f" ({_thousands(entry['low'])} to {_thousands(entry['high'])})"
        probability = percent(entry["probability_of_improvement"])
        if entry["improvement_low"] != "":
            low, high = (percent(entry[f"improvement_{end}"]) for end in ("low", "high"))
            probability += f" ({low} to {high})"
        rows.append(
            [
                entry["task"],
                entry["algorithm"],
                f"{entry['setting']} - {entry['baseline']}{_which(seeds)}",
                percent(entry["level"]),
                ", ".join(map(_difference, entry["differences"].split())),
                mean,
                f"{entry['p_value']:.2g}",
                probability,
            ]
        )
    header = ["task", "algorithm", "compared", "held", "differences by seed"]
    header += ["mean (95 % interval)", "exact p", "P(sooner)"]
    return without_constant_columns(Table(header, rows), 2)


def _difference(text: str) -> str:
    """A difference in thousands, such as "> 400" where it is at least that much, if it is known."""
    if not text or text[0] == "?":
        return "?"
    bound, number = (text[0], text[1:]) if text[0] in "<>" else ("", text)
    return f"{bound} {_thousands(int(number))}".strip()


def grid(question: str, env: str) -> Table:
    """Epochs until 50 % is held, by seed, over c_g and kappa."""
    settings = {
        setting: list(seeds.values())
        for setting, seeds in runs_by_setting(runs_of(question)).items()
        if setting.env == env
    }
    rates = sorted({setting.c_g for setting in settings if setting.c_g is not None})
    rows = []
    for kappa in sorted({setting.kappa for setting in settings if setting.kappa is not None}):
        cells = {s.c_g: _epochs(runs) for s, runs in settings.items() if s.kappa == kappa}
        rows.append([f"kappa = {kappa:g}", *(cells.get(rate, "") for rate in rates)])
    for setting, runs in settings.items():
        if setting.masks == NO_MASKS:
            rows.append([f"{NO_MASKS}: {_epochs(runs)}", *[""] * len(rates)])
    return Table(["c_g", *map(percent, rates)], rows)


def _epochs(runs: Runs) -> str:
    rows = [first_to_hold(run.rows, 0.5) for run in runs]
    return _by_seed([row["epoch"] if row else math.inf for row in rows])


def mask_stages(sweep: str, width: str) -> Table:
    """What is practised, and with which success, per so many environment steps; means over runs."""
    runs = recorded_runs(sweep)
    ends = _ends(runs, int(width))
    columns = {
        "evaluations, full goal": window_means(runs, ends, "success_rate"),
        "full goal drawn": window_means(runs, ends, "mask_probability", FULL_GOAL),
        "x and y drawn": window_means(runs, ends, "mask_probability", X_AND_Y),
        "z drawn": window_means(runs, ends, "mask_probability", Z),
        "training, full goal": window_means(runs, ends, "mask_rate_training", FULL_GOAL),
    }
    rows = [
        [_window(end, int(width)), *(_share(column[end]) for column in columns.values())]
        for end in ends
    ]
    return Table(["thousand environment steps", *columns], rows)


def moved_episodes(question: str, width: str) -> Table:
    """Share of training episodes that moved the achieved goal, by setting and seed."""
    runs = [run for run in runs_of(question) if "moved_share" in run.rows[0]]
    ends = _ends(runs, int(width)) if runs else []
    rows = []
    for setting, seeds in runs_by_setting(runs).items():
        for seed, run in seeds.items():
            means = window_means([run], ends, "moved_share")
            held = [env_steps_to_hold(run, level) / 1000 for level in LEVELS]
            shares = [_share(means[end]) for end in ends]
            names = [setting.task, setting.algorithm, setting.curriculum, str(seed)]
            rows.append([*names, *map(_number, held), *shares])
    header = ["task", "algorithm", "masks", "seed"]
    header += [f"{percent(level)} held at" for level in LEVELS]
    header += [f"moved, {_window(end, int(width))}" for end in ends]
    table = Table(header, rows, "How many episodes moved the block is not on record yet.")
    return without_constant_columns(table, 2) if rows else table


def _ends(runs: Runs, width: int) -> list[int]:
    last = max(run.rows[-1]["env_steps"] for run in runs)
    return list(range(width, last + width, width))


def _window(end: int, width: int) -> str:
    return f"{(end - width) // 1000} to {end // 1000}"


def _share(value: float) -> str:
    return percent(value) if math.isfinite(value) else ""


def evaluations(sweep: str) -> Table:
    """Every evaluation of a short sweep."""
    rows = [
        [f"{row['env_steps']:,}", f"{row['wall_s']:.0f}", _share(row["success_rate"])]
        for run in in_order_of_seeds(recorded_runs(sweep))
        for row in run.rows
    ]
    header = ["environment steps", "seconds after training began", "success"]
    return Table(header, rows)


def calibration() -> Table:
    """How far estimates of masked success are off, in percentage points."""
    errors = calibration_errors(read_table(SWEEPS.parent / "calibration" / "calibration.csv"))
    rows = [
        [ESTIMATES[estimate], MEASURED[measured], f"{100 * mean:.1f}", f"{100 * bias:+.1f}"]
        for (estimate, measured), (mean, bias) in errors.items()
    ]
    return Table(["estimate", "measured", "mean error, points", "bias, points"], rows)


def seconds() -> Table:
    """How long the preset `cpu` takes to hold 90 %, by seed and in the median."""
    by_task: dict[str, list[dict[str, str]]] = {}
    for row in read_table(SWEEPS.parent / "seconds" / "seconds.csv"):
        by_task.setdefault(row["task"], []).append(row)

    def column(runs: list[dict[str, str]], name: str) -> list[float]:
        return [float(run[name]) for run in runs]

    rows = [
        [
            task.replace("_", "-"),
            ", ".join(map(_thousands, column(runs, "env_steps"))),
            _by_seed(column(runs, "held_s")),
            *(_number(median(column(runs, name))) for name in ("held_s", "cpu_s", "ratio")),
            _by_seed([100 * rate for rate in column(runs, "success_rate")]),
        ]
        for task, runs in by_task.items()
    ]
    columns = ["task", "environment steps, thousands", "seconds, by seed", "seconds, median"]
    columns += ["CPU seconds, median", "times those at raw rates, median", "success then, %"]
    return Table(columns, rows)


TABLES: dict[str, Callable[..., Table]] = {
    "seconds": seconds,
    "conditions": conditions,
    "planned": planned,
    "differences_from_the_paper": differences_from_the_paper,
    "speed": speed,
    "seconds_to_hold": seconds_to_hold,
    "trained_twice": trained_twice,
    "paired": paired,
    "grid": grid,
    "mask_stages": mask_stages,
    "moved_episodes": moved_episodes,
    "evaluations": evaluations,
    "calibration": calibration,
}
