"""Settings from files, with options before them."""

import json
import os
from pathlib import Path
from typing import Any

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, build_groups
from cgm_jax.config.presets import PRESETS
from cgm_jax.host.asked import asked_for
from cgm_jax.host.command_line import parse
from cgm_jax.storage.run_directory import RunDirectory
from cgm_jax.sweep import SweepOptions
from cgm_jax.train import TrainOptions
from tests.cgm_jax.sweeps import ROOT

GROWING = f"{ROOT / 'tests/examples/my_curriculum.py'}:Growing"


def groups_of(*words: str, kind: type[Any] = SweepOptions) -> list[Group]:
    groups = asked_for(parse(kind, list(words), "")).groups
    assert groups is not None
    return groups


def written(path: Path, text: str) -> str:
    path.write_text(text)
    return str(path)


def test_a_settings_file_asks_for_what_the_same_options_ask_for(tmp_path: Path) -> None:
    text = """
        preset = "smoke"
        curriculum = ["cgm", "full"]
        c_g = [0, 0.5]
        hidden-layers = [[8, 8], [16]]
        her = [true, false]
        leave_at = 0.9
        seeds = 2
    """
    file = written(tmp_path / "settings.toml", text)
    words = "--curriculum cgm full --c-g 0 0.5 --hidden-layers 8x8 16 --her on off --leave-at 0.9"
    expected = groups_of("--preset", "smoke", *words.split(), "--seeds", "2")
    assert sum(len(group.runs) for group in expected) == 40
    assert groups_of("--config", file) == expected
    assert all(type(run.values["c_g"]) is float for run in expected[0].runs)


def test_options_come_before_the_file(tmp_path: Path) -> None:
    file = written(tmp_path / "a.toml", 'preset = "smoke"\nkappa = 8\nepochs = 3\nher = "off"')
    (group,) = groups_of("--config", file, "--epochs", "5")
    assert group == build_groups("smoke", {"kappa": [8.0], "epochs": [5], "her": [False]})[0]
    (group,) = groups_of("--config", file, "--preset", "cpu", kind=TrainOptions)
    assert group.settings.batch_size == PRESETS["cpu"]["batch_size"][0]
    one = written(tmp_path / "b.toml", 'preset = "smoke"\nhidden_layers = [8, 16]')
    assert groups_of("--config", one)[0].runs[0].values["hidden_layers"] == (8, 16)


def test_a_file_has_settings_of_the_users_own_curriculum(tmp_path: Path) -> None:
    text = f'preset = "smoke"\ncurriculum = "{GROWING}"\ngain = [1, 0.5]'
    file = written(tmp_path / "own.toml", text)
    with pytest.raises(SettingError, match=r"^curriculum: .* was never named by you .*name it: --"):
        groups_of("--config", file)
    (group,) = groups_of("--config", file, "--curriculum", GROWING)
    assert [run.values["gain"] for run in group.runs] == [1.0, 0.5]
    # Named once, it may run from then on; --set replaces what the file says.
    (group,) = groups_of("--config", file, "--set", "gain=0.25")
    assert [run.values["gain"] for run in group.runs] == [0.25]


def test_a_config_json_asks_for_the_same_runs_again(tmp_path: Path) -> None:
    options = {"curriculum": ["cgm", "full"], "seed": [0, 1], "hidden_layers": [(8,), (8, 16)]}
    groups = build_groups("smoke", options)
    with RunDirectory.claimed(tmp_path / "out", fresh=True) as directory:
        directory.config.write(groups, "smoke", "cpu")
    config = str(directory.path / "config.json")
    assert groups_of("--config", config) == groups_of("--config", str(directory.path)) == groups
    copy = written(tmp_path / "copy.json", Path(config).read_text())
    longer = build_groups("smoke", {**options, "epochs": [7]})
    assert groups_of("--config", copy, "--epochs", "7") == longer
    seeds = build_groups("smoke", {**options, "seed": [5, 6, 7]})
    again = groups_of("--config", copy, "--seed", "5", "6", "7")
    for one, other in zip(again, seeds, strict=True):  # in another order
        assert one.settings == other.settings
        assert {run.name: run for run in one.runs} == {run.name: run for run in other.runs}
    only_full = groups_of("--config", copy, "--curriculum", "full")
    assert only_full == build_groups("smoke", {**options, "curriculum": ["full"]})
    with pytest.raises(SettingError, match=r"^config: .* has 12 runs; cgm_jax.sweep takes several"):
        groups_of("--config", copy, kind=TrainOptions)
    with pytest.raises(SettingError, match=r"^preset: .* has all settings; leave preset out$"):
        groups_of("--config", copy, "--preset", "smoke")
    with pytest.raises(SettingError, match=r"^c_g: is no setting of curriculum full, "):
        groups_of("--config", copy, "--curriculum", "full", "--c-g", "0.3")


def test_code_that_a_config_json_names_runs_only_if_the_user_has_named_it(tmp_path: Path) -> None:
    (tmp_path / "theirs.py").write_text("raise SystemExit('it ran')")
    (group,) = build_groups("smoke", {"kappa": [4.0]})
    values = {**group.runs[0].values, "agent": f"{tmp_path / 'theirs.py'}:Agent"}
    config = {"format": 2, "groups": [{"runs": [{"name": "a", **values}]}]}
    file = written(tmp_path / "config.json", json.dumps(config))
    with pytest.raises(SettingError, match=r"^agent: .*theirs.py was never named by you"):
        groups_of("--config", file)
    (again,) = groups_of("--config", file, "--agent", "ddpg")
    assert again.runs[0].values == group.runs[0].values


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.toml", "kappa = ", "config: .*a.toml is no TOML: Invalid value"),
        ("a.toml", "[agent]\nname = 1", "config: .*a.toml has a table 'agent'"),
        ("a.toml", "c_g = 0.1\nc-g = 0.2", "config: .*a.toml holds c_g twice"),
        ("a.toml", 'preset = "huge"', "preset: unknown preset 'huge' in .*a.toml; choose from "),
        ("a.toml", "seeds = 0", "seeds: 0 in .*a.toml is no number within"),
        (
            "a.toml",
            "seeds = [3, 5]",
            "seeds: .*a.toml gives 2 values, not how many seeds; seed = ",
        ),
        ("a.toml", "seeds = []", "seeds: .*a.toml gives 0 values"),
        ("a.toml", "seeds = [0]", "seeds: 0 in .*a.toml is no number within"),
        ("a.toml", "seeds = true", "seeds: True in .*a.toml is no number within"),
        ("a.toml", f"c_g = 1{'0' * 400}", r"c_g: 10* is not within \[0, 1\]"),
        ("a.toml", "seeds = 2\nseed = 1", "seeds: .*a.toml holds seed as well"),
        ("a.toml", "c_g = 3", r"c_g: 3.0 is not within \[0, 1\]"),
        ("a.toml", 'c_g = "much"', "c_g: 'much' is not of type float"),
        ("a.toml", "epochs = [[1]]", r"epochs: \(1,\) is not of type int"),
        ("a.toml", "epochs = []", "epochs: needs at least one value"),
        ("a.toml", "colour = 1", "colour: is no setting of curriculum cgm"),
        ("a.toml", "out = 1", "out: is no setting of curriculum cgm"),
        ("a.toml", "kappa = 2020-01-01", "kappa: .* is not of type float"),
        ("config.json", "{", "config: .*config.json is damaged"),
        ("config.json", '{"groups": []}', "config: .*config.json is damaged"),
        ("config.json", '{"format": 9}', "config: .*config.json is damaged: format: 9"),
        (
            "config.json",
            '{"format": 2, "groups": [{"runs": [{"name": "../a"}]}]}',
            "config: .*is damaged: run: '../a' ",
        ),
    ],
)
def test_what_is_wrong_with_a_file_is_one_line(
    name: str, text: str, message: str, tmp_path: Path
) -> None:
    words = [] if name == "config.json" or "preset" in text else ["--preset", "smoke"]
    with pytest.raises(SettingError, match=f"^{message}"):
        groups_of(*words, "--config", written(tmp_path / name, text))


@pytest.mark.parametrize(
    "value", ["3", "true", "0.5", '["cgm", 3]', '[["x"]]', "[{a = 1}]", "2020-01-01", "[[]]"]
)
@pytest.mark.parametrize("name", ["env", "curriculum", "agent", "relabelling"])
@pytest.mark.parametrize("words", [[], ["--curriculum", "full", "--env", "push"]])
def test_a_settings_file_whose_names_are_none_is_refused(
    name: str, value: str, words: list[str], tmp_path: Path
) -> None:
    file = written(tmp_path / "a.toml", f"{name} = {value}")
    with pytest.raises(SettingError, match=rf"^{name}: .* in {file} is not of type str$"):
        groups_of("--preset", "smoke", "--config", file, *words)


def test_neither_pipes_nor_links_of_a_run_directory_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "config.json")
    for path in (tmp_path, tmp_path / "config.json"):
        with pytest.raises(SettingError, match=r"config.json is .*no ordinary file"):
            groups_of("--config", str(path))
    (tmp_path / "config.json").unlink()
    (group,) = build_groups("smoke", {"kappa": [4.0]})
    config = {"groups": [{"runs": [{"name": "a", **group.runs[0].values}]}], "from": "x"}
    written(tmp_path / "config.json", json.dumps({"format": 2, **config}))
    (tmp_path / "start.npz").symlink_to(tmp_path / "config.json")
    for path in (tmp_path, tmp_path / "config.json"):
        with pytest.raises(SettingError, match=r"^config: .*start.npz is a symbolic link"):
            groups_of("--config", str(path))


@pytest.mark.parametrize("value", [{}, 5, ["x"], [["x"]], None, True, [[[0]]]])
@pytest.mark.parametrize("name", ["env", "curriculum", "relabelling"])
@pytest.mark.parametrize("words", [[], ["--kappa", "4"]])
def test_a_config_json_whose_names_are_none_is_refused(
    name: str, value: Any, words: list[str], tmp_path: Path
) -> None:
    (group,) = build_groups("smoke", {"kappa": [4.0]})
    run = {"name": "a", **group.runs[0].values, name: value}
    config = {"format": 2, "groups": [{"runs": [run]}]}
    written(tmp_path / "config.json", json.dumps(config))
    with pytest.raises(
        SettingError, match=rf"^config: .*config.json is damaged: {name}: .* not of"
    ):
        groups_of("--config", str(tmp_path), *words)


@pytest.mark.parametrize(
    "change",
    [
        {"hidden_layers": {}},
        {"hidden_layers": [["x"]]},
        {"epochs": [1]},
        {"seed": {"a": 1}},
        {"seed": 10**400},
        {"c_g": 10**400},
        {"c_g": "x"},
        {"batch_size": None},
        {"her": [[]]},
    ],
)
@pytest.mark.parametrize("words", [[], ["--kappa", "4"]])
def test_a_config_json_with_values_of_other_types_is_refused(
    change: dict[str, Any], words: list[str], tmp_path: Path
) -> None:
    (group,) = build_groups("smoke", {"kappa": [4.0]})
    config = {"format": 2, "groups": [{"runs": [{"name": "a", **group.runs[0].values, **change}]}]}
    file = written(tmp_path / "config.json", json.dumps(config))
    with pytest.raises(SettingError):
        groups_of("--config", file, *words)


@pytest.mark.parametrize("text", ["seeds = 3", "seeds = [3]"])
def test_seeds_are_as_many_as_a_file_says(text: str, tmp_path: Path) -> None:
    file = written(tmp_path / "a.toml", f"{text}\nkappa = 4")
    (group,) = groups_of("--preset", "smoke", "--config", file)
    assert [run.values["seed"] for run in group.runs] == [0, 1, 2]


@pytest.mark.parametrize("name", ["nowhere.toml", "nowhere.json"])
def test_a_file_that_is_not_there_is_named(name: str, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match=rf"^config: .*{name}"):
        groups_of("--config", str(tmp_path / name))
