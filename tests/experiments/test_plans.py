import tomllib

import pytest

from experiments.run import FIGURES, PLANS, planned_groups

PLAN = tomllib.loads(PLANS.read_text())


@pytest.mark.parametrize("name", PLAN["sweeps"])
def test_every_sweep_is_one_that_the_program_takes(name: str) -> None:
    (group,) = planned_groups(PLAN["sweeps"][name])
    assert name == "quick" or name.startswith(group.settings.env)


@pytest.mark.parametrize("name", PLAN["questions"])
def test_every_question_rests_on_sweeps_and_figures_that_there_are(name: str) -> None:
    assert set(PLAN["questions"][name]["sweeps"]) <= set(PLAN["sweeps"])
    assert set(PLAN["questions"][name]["figures"]) <= set(FIGURES)


def test_every_sweep_answers_a_question() -> None:
    used = {sweep for plan in PLAN["questions"].values() for sweep in plan["sweeps"]}
    assert used == set(PLAN["sweeps"])
