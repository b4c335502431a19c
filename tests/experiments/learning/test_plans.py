from pathlib import Path

import pytest

from cgm_jax.config.presets import PRESETS
from experiments.learning.plans import (
    not_written_out,
    options_of,
    planned_settings,
    read_plans,
)
from experiments.learning.records import recorded_settings
from experiments.run import FIGURES

PLANS = read_plans()


@pytest.mark.parametrize("name", PLANS.sweeps)
def test_every_sweep_is_one_that_the_program_takes(name: str) -> None:
    (env,) = {settings["env"] for settings in planned_settings(PLANS.sweeps[name])}
    assert name == "quick" or name.startswith(env)


@pytest.mark.parametrize("name", PLANS.sweeps)
def test_no_preset_or_default_decides_a_sweep(name: str) -> None:
    sweep = PLANS.sweeps[name]
    assert not_written_out(sweep) == set()
    planned = [planned_settings(sweep, preset) for preset in PRESETS]
    assert planned == [planned[0]] * len(PRESETS)


@pytest.mark.parametrize("name", PLANS.sweeps)
def test_what_is_on_record_is_what_is_planned(name: str) -> None:
    recorded = [settings for _, settings in recorded_settings(name)]
    assert recorded in ([], planned_settings(PLANS.sweeps[name]))


def test_settings_build_on_others(tmp_path: Path) -> None:
    (tmp_path / "plans.toml").write_text("""
        settings.first = {epochs = 3, cgm = true, hidden_layers = [8, 4]}
        settings.second = {like = "first", kappa = [1.0, 4.0]}
        sweeps.one = {like = "second", cgm = false, seeds = 2}
        questions.why = {sweeps = ["one"], figures = []}
    """)
    plans = read_plans(tmp_path / "plans.toml")
    assert plans.questions["why"].sweeps == ["one"]
    options = options_of(plans.sweeps["one"], "smoke")
    assert " ".join(options) == (
        "--preset smoke --epochs 3 --cgm off --hidden-layers 8 4 --kappa 1.0 4.0 --seeds 2"
    )
    missing = not_written_out(plans.sweeps["one"])
    assert {"c_g", "batch_size"} <= missing
    assert missing.isdisjoint({"epochs", "kappa", "seed", "leave_at"})  # by default none


@pytest.mark.parametrize("name", PLANS.questions)
def test_every_question_rests_on_sweeps_and_figures_that_there_are(name: str) -> None:
    assert set(PLANS.questions[name].sweeps) <= set(PLANS.sweeps)
    assert set(PLANS.questions[name].figures) <= set(FIGURES)


def test_every_sweep_answers_a_question() -> None:
    used = {sweep for question in PLANS.questions.values() for sweep in question.sweeps}
    assert used == set(PLANS.sweeps)
