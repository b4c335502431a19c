import functools
from pathlib import Path
from typing import Any

import pytest

from cgm_jax.config.named import is_own
from cgm_jax.config.presets import PRESETS, Grid
from experiments.learning.plans import (
    grid_of,
    not_written_out,
    options_of,
    read_plans,
    settings_of_grid,
)
from experiments.learning.records import RecordedRun, recorded_settings, same_runs
from experiments.learning.tables import runs_by_setting
from experiments.report import README, SCREENS, SCREENS_OF_QUESTIONS
from experiments.run import FIGURES

PLANS = read_plans()


@functools.cache
def grid(name: str) -> Grid:
    """What a sweep asks for."""
    return grid_of(PLANS.sweeps[name])


@functools.cache
def planned(name: str) -> list[dict[str, Any]]:
    """The settings of its runs."""
    return settings_of_grid(grid(name))


@pytest.mark.parametrize("name", PLANS.sweeps)
def test_every_sweep_is_one_that_the_program_takes(name: str) -> None:
    (env,) = {settings["env"] for settings in planned(name)}
    assert name == "quick" or name.startswith(Path(env.partition(".py:")[0]).name)


@pytest.mark.parametrize("name", PLANS.sweeps)
def test_every_sweep_names_its_engine_where_it_may(name: str) -> None:
    settings = PLANS.sweeps[name]
    assert (settings["engine"] == "auto") == is_own(settings["env"])


@pytest.mark.parametrize("name", PLANS.sweeps)
def test_no_preset_or_default_decides_a_sweep(name: str) -> None:
    settings = PLANS.sweeps[name]
    assert not_written_out(settings) == set()
    assert [settings_of_grid(grid(name), preset) for preset in PRESETS] == [planned(name)] * len(
        PRESETS
    )


@pytest.mark.parametrize("name", PLANS.sweeps)
def test_what_is_on_record_is_what_is_planned(name: str) -> None:
    recorded = [settings for _, settings in recorded_settings(name)]
    assert not recorded or same_runs(recorded, planned(name))


def test_settings_build_on_others(tmp_path: Path) -> None:
    (tmp_path / "plans.toml").write_text("""
        settings.first = {epochs = 3, her = true, hidden_layers = [8, 4]}
        settings.second = {like = "first", kappa = [1.0, 4.0]}
        settings.third = {epochs = 5, curriculum = "cgm"}
        sweeps.one = {like = ["second", "third"], her = false, seeds = 2}
        questions.why = {text = "Why?", sweeps = ["one"], figures = []}
    """)
    plans = read_plans(tmp_path / "plans.toml")
    assert plans.questions["why"].sweeps == ["one"]
    options = options_of(plans.sweeps["one"], "smoke")
    assert " ".join(options) == (
        "--preset smoke --epochs 5 --her off --hidden-layers 8 4 --kappa 1.0 4.0 "
        "--curriculum cgm --seeds 2"
    )
    missing = not_written_out(plans.sweeps["one"])
    assert {"c_g", "batch_size", "agent"} <= missing
    assert missing.isdisjoint({"epochs", "kappa", "seed", "leave_at"})  # by default none
    assert "c_g" not in not_written_out({**plans.sweeps["one"], "curriculum": "full"})


@pytest.mark.parametrize("name", PLANS.questions)
def test_every_question_rests_on_sweeps_and_figures_that_there_are(name: str) -> None:
    assert set(PLANS.questions[name].sweeps) <= set(PLANS.sweeps)
    assert set(PLANS.questions[name].figures) <= set(FIGURES)


@pytest.mark.parametrize("name", PLANS.questions)
def test_every_question_has_a_screen(name: str) -> None:
    own = SCREENS_OF_QUESTIONS / f"{name}.md"
    text = own.read_text() if own.is_file() else SCREENS.sub("", README.read_text())
    assert f"## {PLANS.questions[name].text}\n" in text


@pytest.mark.parametrize("name", PLANS.questions)
def test_runs_of_a_question_can_be_told_apart(name: str) -> None:
    runs = [
        RecordedRun(sweep, f"run {number}", settings, [], alone=True)
        for sweep in PLANS.questions[name].sweeps
        for number, settings in enumerate(planned(sweep))
    ]
    seeds = runs_by_setting(runs)  # refuses a run that is planned twice
    assert sum(map(len, seeds.values())) == len(runs)


def test_every_sweep_answers_a_question() -> None:
    used = {sweep for question in PLANS.questions.values() for sweep in question.sweeps}
    assert used == set(PLANS.sweeps)
