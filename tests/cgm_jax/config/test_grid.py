import dataclasses
import itertools
import re
from pathlib import Path
from typing import Any

import pytest

from cgm_jax.agents.ddpg import DDPG
from cgm_jax.config.components import ROOMS, builtin
from cgm_jax.config.fields import SettingError, check, declared
from cgm_jax.config.grid import build_groups, run_of, split, structure, swept_settings
from cgm_jax.config.presets import PRESETS
from cgm_jax.config.settings import LOOP_FIELDS
from cgm_jax.curricula.cgm import CGM
from cgm_jax.replay.future import Future

EXAMPLES = Path(__file__).parents[2] / "examples"


def names(options: dict[str, list[Any]]) -> list[str]:
    return [run.name for group in build_groups("smoke", options) for run in group.runs]


def test_a_grid_is_the_product_of_its_axes() -> None:
    (group,) = build_groups("smoke", {"c_g": [0.0, 0.1, 0.4], "kappa": [4.0, 32.0], "seed": [0, 1]})
    curricula = [run.hyper.curriculum for run in group.runs]
    values = [
        (one.c_g, one.kappa, run.hyper.seed) for one, run in zip(curricula, group.runs, strict=True)
    ]
    assert len(values) == len(set(values)) == 12
    assert len({run.name for run in group.runs}) == 12
    assert (0.4, 4.0, 1) in values


def test_runs_that_differ_only_in_what_has_no_effect_are_trained_once() -> None:
    both = names({"curriculum": ["cgm", "full"], "c_g": [0.1, 0.4], "kappa": [32.0]})
    assert both == [
        "reach_ddpg-her_cgm-cg0.1-kappa32_seed0",
        "reach_ddpg-her_cgm-cg0.4-kappa32_seed0",
        "reach_ddpg-her_full_seed0",
    ]
    no_her = names({"her": [False], "her_k": [4.0, 6.0], "kappa": [32.0]})
    assert no_her == ["reach_ddpg_cgm-cg0.1-kappa32_seed0"]
    one = {"c_g": [0.1], "kappa": [32.0]}
    no_noise = {"agent": ["td3"], "target_noise_clip": [0.0, 0.5], "target_noise": [0.1, 0.2]}
    assert names({**one, **no_noise}) == [
        f"reach_td3-her_cgm-cg0.1-kappa32_{noise}_seed0"
        for noise in (
            "targetnoiseclip0",
            "targetnoise0.1_targetnoiseclip0.5",
            "targetnoise0.2_targetnoiseclip0.5",
        )
    ]
    noise = {"action_noise": [0.1, 0.2]}  # not of an agent that explores by itself
    assert names({**one, "agent": ["ddpg", "sac"], **noise}) == [
        "reach_ddpg-her_cgm-cg0.1-kappa32_actionnoise0.1_seed0",
        "reach_ddpg-her_cgm-cg0.1-kappa32_actionnoise0.2_seed0",
        "reach_sac-her_cgm-cg0.1-kappa32_seed0",
    ]
    same_temperature = {"temperature_learning_rate": [0.0], "target_entropy": [-1.0, -2.0]}
    assert names({**one, "agent": ["sac"], **same_temperature}) == [
        "reach_sac-her_cgm-cg0.1-kappa32_seed0"
    ]


def test_values_that_differ_in_the_eighth_digit_are_two_runs() -> None:
    assert len(names({"c_g": [0.1, 0.10000001], "kappa": [32.0]})) == 2


def test_values_too_close_to_be_told_apart_by_name_are_refused() -> None:
    with pytest.raises(SettingError, match=r"^c_g: 0\.1 and 0\.1\d* would give their"):
        build_groups("smoke", {"c_g": [0.1, 0.1 + 1e-13], "kappa": [32.0]})


@pytest.mark.parametrize(("kind", "made"), [("env", "PointMass"), ("curriculum", "Growing")])
def test_own_code_whose_runs_would_have_the_same_names_is_refused(
    kind: str, made: str, tmp_path: Path
) -> None:
    source = EXAMPLES / {"env": "point_mass.py", "curriculum": "my_curriculum.py"}[kind]
    for folder, setting in (("one", "gain"), ("other", "growth")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mine.py").write_text(source.read_text().replace("gain", setting))
    both = [f"{tmp_path / folder / 'mine.py'}:{made}" for folder in ("one", "other")]
    said = f"{kind}: {both[0]} and {both[1]} would give their runs the same names"
    with pytest.raises(SettingError, match=f"^{re.escape(said)}"):
        build_groups("smoke", {kind: both})


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("curriculum", "seed"),
        ("curriculum", "action_noise"),
        ("curriculum", "epochs"),
        ("curriculum", "agent"),
        ("curriculum", "name"),
        ("curriculum", "success_rate"),
        ("agent", "environments"),
    ],
)
def test_a_component_cannot_take_a_name_of_training_itself(
    kind: str, name: str, tmp_path: Path
) -> None:
    source = EXAMPLES / f"my_{kind}.py"
    setting, made = {"curriculum": ("gain", "Growing"), "agent": ("step_size", "MyAgent")}[kind]
    code = source.read_text()
    assert setting in code
    (tmp_path / "mine.py").write_text(code.replace(setting, name))
    chosen = f"{tmp_path / 'mine.py'}:{made}"
    said = f"{kind}: {chosen} has a setting called {name}, a name that is taken"
    with pytest.raises(SettingError, match=f"^{re.escape(said)}$"):
        build_groups("smoke", {kind: [chosen]})


def other_values(item: Any) -> list[Any]:
    """Two values of a setting, neither of which any other test depends on."""
    if item.name in OTHERS:
        return OTHERS[item.name]
    if isinstance(item.default, bool):
        return [True, False]
    return [3, 4] if type(item.default) is int else [0.25, 0.5]


OTHERS = {
    "env": ["reach", "push"],
    "engine": ["native", "mjx"],
    "hidden_layers": [(8, 8), (8, 16)],
}
FIELDS = LOOP_FIELDS | {item.name: item for kind in (CGM, DDPG, Future) for item in declared(kind)}


@pytest.mark.parametrize("name", FIELDS)
def test_every_setting_can_be_swept_and_tells_its_runs_apart(name: str) -> None:
    item = FIELDS[name]
    groups = build_groups("smoke", {"kappa": [32.0], name: other_values(item)})
    runs = [run for group in groups for run in group.runs]
    assert len({run.name for run in runs}) == len(runs) == 2
    assert len({repr(run.values[name]) for run in runs}) == 2
    assert len(groups) == (1 if item.metadata["traced"] else 2)  # a program per static value
    assert swept_settings(groups) == ([name] if name != "seed" else [])


def test_runs_of_one_program_are_one_group_whatever_lies_between_them() -> None:
    groups = build_groups("smoke", {"curriculum": ["cgm", "full"], "seed": [0, 1], "c_g": [0.1]})
    assert [len(group.runs) for group in groups] == [4, 2]
    assert {run.values["curriculum"] for run in groups[1].runs} == {"full"}


def test_each_curriculum_agent_and_relabelling_has_a_program_of_its_own() -> None:
    for kind in ROOMS:
        groups = build_groups("smoke", {kind: [*builtin(kind)], "kappa": [4.0]})
        programs = [structure(group.settings, group.runs[0].hyper) for group in groups]
        assert len(groups) == len(builtin(kind))
        for one, other in itertools.combinations(programs, 2):  # by comparison, not by hash
            assert one != other


def test_a_run_is_the_same_from_all_its_values() -> None:
    for group in build_groups("smoke", {"curriculum": ["cgm", "full"], "epochs": [2, 3]}):
        for run in group.runs:
            assert run_of(run.name, run.values) == (group.settings, run)


def test_of_a_presets_lists_a_single_run_takes_the_first_value() -> None:
    (group,) = build_groups("paper", {"env": ["push"]}, single=True)
    (run,) = group.runs
    assert (run.values["c_g"], run.values["kappa"], run.values["her"]) == (0.0, 1.0, True)


def test_environments_become_groups_with_the_papers_settings_for_each() -> None:
    push, pick = build_groups("paper", {})
    assert [group.settings.env for group in (push, pick)] == ["push", "pick_and_place"]
    assert [group.settings.environments for group in (push, pick)] == [16, 64]
    assert [group.settings.batch_size for group in (push, pick)] == [1024, 4096]
    for group in (push, pick):
        points = {tuple(run.values[name] for name in ("c_g", "kappa", "her")) for run in group.runs}
        assert len(points) == 18 * 2
        assert len(group.runs) == 18 * 2 * 5
    for group, env_steps in ((push, 51_200), (pick, 204_800)):
        assert group.settings.cycles_per_epoch * group.settings.environments * 50 == env_steps


@pytest.mark.parametrize(
    ("largest", "sizes"), [(7, [7]), (6, [4, 3]), (3, [3, 2, 2]), (1, [1] * 7)]
)
def test_groups_split_evenly_and_lose_no_run(largest: int, sizes: list[int]) -> None:
    (group,) = build_groups("smoke", {"seed": list(range(7)), "kappa": [1.0]})
    parts = split(group, largest)
    assert [len(part.runs) for part in parts] == sizes
    assert [run for part in parts for run in part.runs] == list(group.runs)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"c_g": [1.5]}, "c_g: 1.5 is not within"),
        ({"c_g": [-0.1]}, "c_g: -0.1 is not within"),
        ({"kappa": [float("nan")]}, "kappa: nan is not a finite number"),
        ({"kappa": [float("inf")]}, "kappa: inf is not a finite number"),
        ({"c_g": []}, "c_g: needs at least one value"),
        ({"c_g": [0.1, 0.1]}, "c_g: holds a value twice"),
        ({"env": ["a.py:E", "./a.py:E"]}, "env: holds a value twice"),
        ({"batch_size": [0]}, "batch_size: 0 is not within"),
        ({"hidden_layers": [()]}, "hidden_layers: needs at least one value"),
        ({"hidden_layers": [(64, 0)]}, "hidden_layers: 0 is not within"),
        ({"seed": [-1]}, "seed: -1 is not within"),
        ({"env": []}, "env: needs at least one value"),
        (
            {"curriculum": ["nothing"]},
            "curriculum: unknown curriculum 'nothing'; choose from",
        ),
        ({"agent": ["x.py:A"]}, "agent: 'x.py:A' is not FILE.py:NAME with a file that exists"),
        ({"no_such": [1]}, "no_such: is no setting of curriculum cgm, agent ddpg"),
        (
            {"curriculum": ["full", "uniform"], "c_g": [0.1]},
            "c_g: is no setting of curriculum full or uniform, agent ddpg, relabelling future; "
            "it is one of curriculum cgm$",
        ),
        (
            {"curriculum": ["full"], "agent": ["sac", "td3"], "success_history": [5]},
            "success_history: is no setting of curriculum full, agent sac or td3, .*; "
            "it is one of curriculum cgm or curriculum learnability$",
        ),
    ],
)
def test_bad_values_are_refused_by_name(options: dict[str, list[Any]], message: str) -> None:
    with pytest.raises(SettingError, match=message):
        build_groups("smoke", options)


@pytest.mark.parametrize(
    ("env", "updates", "environment_steps"),
    [("push", 640, 819_200), ("pick_and_place", 800, 1_536_000)],
)
def test_the_gpu_preset_is_the_cpu_preset_with_many_environments(
    env: str, updates: int, environment_steps: int
) -> None:
    (gpu,) = build_groups("gpu", {"env": [env]}, single=True)
    (cpu,) = build_groups("cpu", {"env": [env]}, single=True)
    settings = gpu.settings
    assert settings.environments * 50 * settings.cycles_per_epoch * settings.epochs == (
        environment_steps
    )
    # Eleven cycles' episodes stay in replay.
    assert settings.replay_transitions // (50 * settings.environments) == 11
    many = {
        "environments": 1024,
        "batch_size": 1024,
        "updates_per_cycle": updates,
        "cycles_per_epoch": 1,
        "epochs": settings.epochs,
    }
    assert settings == dataclasses.replace(cpu.settings, **many)
    assert gpu.runs[0].hyper == cpu.runs[0].hyper


def test_presets_name_only_settings_and_their_values_are_valid() -> None:
    for preset in PRESETS:
        for group in build_groups(preset, {}):
            for run in group.runs:
                check(run.hyper)
