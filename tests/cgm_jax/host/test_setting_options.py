"""What --help says of each setting, and how words become values."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from cgm_jax import sweep, train
from cgm_jax.config.components import ROOMS, builtin_fields
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.config.settings import LOOP_FIELDS
from cgm_jax.host.command_line import parse
from cgm_jax.host.training_options import chosen_values
from cgm_jax.storage.run_directory import RunDirectory
from cgm_jax.sweep import SweepOptions

FIELDS = LOOP_FIELDS | builtin_fields()


def shown(
    main: Callable[[list[str]], int], words: str, capsys: pytest.CaptureFixture[str]
) -> dict[str, dict[str, str]]:
    """What --help says: by the title of each group, by option, on one line."""
    with pytest.raises(SystemExit) as end:
        main([*words.split(), "--help"])
    assert end.value.code == 0
    groups: dict[str, dict[str, str]] = {}
    title = option = ""
    for line in capsys.readouterr().out.splitlines():
        if found := re.match(r"(?:╭─)? (\S.*?) options[ ─╮]*$", line):
            title, option = found[1], ""
        text = line.strip("│ ")
        if found := re.match(r"--([a-z-]+) ", text):
            option = found[1].replace("-", "_")
            # Where the metavar is short, the help begins on the same line.
            groups.setdefault(title, {})[option] = re.sub(r"^\S+ \S+ *", "", text)
        elif title and option:
            entry = groups[title].get(option, "")
            groups[title][option] = f"{entry} {text}".strip()
    return groups


@pytest.fixture
def groups(capsys: pytest.CaptureFixture[str]) -> dict[str, dict[str, str]]:
    return shown(sweep.main, "", capsys)


def test_every_setting_is_in_the_group_of_all_that_have_it(
    groups: dict[str, dict[str, str]],
) -> None:
    where = {name: title for title, options in groups.items() for name in options}
    assert set(where) >= {*FIELDS, *ROOMS}
    assert sum(len(options) for options in groups.values()) == len(where)
    assert where["env"] == where["air_probability"] == "environment"
    assert where["epochs"] == where["seed"] == "loop"
    assert where["c_g"] == "curriculum cgm"
    assert where["success_history"] == "curriculum cgm, learnability"
    assert where["target_noise"] == "agent td3"
    assert where["hidden_layers"] == "agent ddpg, sac, td3"
    assert where["discount"] == "curriculum mega, agent ddpg, sac, td3"
    assert where["her"] == "relabelling future, relay"
    assert where["relay_share"] == "relabelling relay"


def test_help_says_which_settings_split_programs(groups: dict[str, dict[str, str]]) -> None:
    for options in groups.values():
        for name, text in options.items():
            if name in FIELDS:
                assert ("splits programs" in text) is not FIELDS[name].metadata["traced"], name
            assert name not in ROOMS or "splits programs" in text


@pytest.mark.parametrize(
    ("program", "words", "option", "expected"),
    [
        ("sweep", "", "c_g", "(default 0.1; quick: 0 0.1 0.2 0.4 0.6 0.8)"),
        ("sweep", "--preset cpu", "c_g", "(default 0.1)"),
        ("sweep", "--preset cpu", "epochs", "(default 100; cpu: 20; splits programs)"),
        ("sweep", "--preset=cpu --env reach", "epochs", "(default 100; cpu: 3; splits programs)"),
        ("train", "--preset paper", "kappa", "(default 32; paper: 1)"),  # the first of three
        (
            "sweep",
            "--preset paper",
            "batch_size",
            "(default 1024; paper: 1024 for push; 4096 for pick_and_place; splits programs)",
        ),
        (
            "train",
            "",
            "target_rate",
            "(default 0.05 for ddpg; 0.005 for sac, td3; cpu: 0.005)",
        ),
        ("train", "--preset nothing", "kappa", "(default 32)"),
    ],
)
def test_help_gives_defaults_and_values_of_the_chosen_preset(
    program: str, words: str, option: str, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    groups = shown({"sweep": sweep.main, "train": train.main}[program], words, capsys)
    (text,) = (options[option] for options in groups.values() if option in options)
    assert text.endswith(expected)


WIDE = """
from cgm_jax.agents.ddpg import DDPG
from cgm_jax.config.fields import settings, static, traced

@settings
class Wide(DDPG):
    widths: tuple[int, ...] = static((8,), "widths", 1, 100)
    text: str = static("a", "any")
    gain: float = traced(1.0, "any")
    early: bool = static(False, "any")
"""


@pytest.fixture
def own(tmp_path: Path) -> list[str]:
    (tmp_path / "wide.py").write_text(WIDE)
    return ["--agent", f"{tmp_path / 'wide.py'}:Wide", "--kappa", "4", "--preset", "smoke"]


def test_settings_of_an_agent_of_the_users_own_are_read_as_it_declares_them(
    own: list[str], tmp_path: Path
) -> None:
    words = ["--set", "widths=8x16,32", "text=1", "gain=2", "early=on"]
    options = parse(SweepOptions, [*own, *words], "")
    grid = chosen_values(options)
    assert grid["widths"] == [(8, 16), (32,)]
    assert (grid["text"], grid["gain"], grid["early"]) == (["1"], [2.0], [True])
    groups = build_groups("smoke", grid)
    names = [run.name for group in groups for run in group.runs]
    assert [name.partition("kappa4_")[2] for name in names] == [
        "widths8x16_seed0",
        "widths32_seed0",
    ]
    with RunDirectory.claimed(tmp_path / "out", fresh=True) as directory:
        directory.config.write(groups, "smoke", "cpu")
        assert directory.config.groups() == groups  # tuples come back from lists


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("widths=8xx", "widths: '8xx' is not of a form such as 64x64"),
        ("early=1", "early: '1' is not on or off"),
        ("gain=much", "gain: 'much' is not of type float"),
    ],
)
def test_a_word_that_is_no_value_of_its_setting_is_refused_by_name(
    own: list[str], word: str, message: str
) -> None:
    options = parse(SweepOptions, [*own, "--set", word], "")
    with pytest.raises(SettingError, match=message):
        chosen_values(options)


def test_a_setting_that_is_an_option_too_is_refused() -> None:
    options = parse(SweepOptions, ["--set", "c_g=0.9", "--c-g", "0.2"], "")
    with pytest.raises(SettingError, match=r"^set: c_g is given as an option, too$"):
        chosen_values(options)
