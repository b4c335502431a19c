"""Nonsense, generated: every input is a valid plan or is refused with one line that names it."""

import dataclasses
import json
import math
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from cgm_jax import sweep, train
from cgm_jax.config.components import ROOMS, builtin_fields
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Group, build_groups
from cgm_jax.config.presets import PRESETS
from cgm_jax.config.settings import LOOP_FIELDS
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.host.in_process import outcome
from tests.cgm_jax.sweeps import ROOT

WORDS = [
    *("nan", "inf", "-inf", "-1", "0", "-0.0", "1", "2", "0.5", "1.0", "1e400", "1e-400", "1e30"),
    *("9" * 25, "1_0", "0x10", "٣", "½", "", " ", "None", "on", "off", "true", "reach"),
    *(
        "native",
        "a.py:",
        ":",
        ".py:X",
        "ä💥\u202e",
        "a\nb",
        "'",
        "--",
        "-",
        "x" * 5000,
        "../..",
        "/",
    ),
]
FIELDS = LOOP_FIELDS | builtin_fields()
OPTIONS = [
    *FIELDS,
    *ROOMS,
    "set",
    "preset",
    "out",
    "resume",
    "seeds",
    "checkpoint_seconds",
    "no_such_option",
]
VALUES = [
    *(math.nan, math.inf, -math.inf, -1, 0, 1, 2, 0.5, 1e30, 10**400, 2**31, True, False, None),
    *("", "reach", "ä💥", "nan", b"1", 1j, [], {}, (), (1,), (64, 64), (0,), (math.nan,), ("8",)),
    *((True,), [1], {"a": 1}, object, "x" * 5000, "a.py:F", "native"),
]


def quick(seeds: int, of: int) -> list[Any]:
    """Seeds, of which the first are quick tests; what the others find is the same at every call."""
    slow = [pytest.param(seed, marks=pytest.mark.slow) for seed in range(seeds, of)]
    return [*range(seeds), *slow]


def assert_sound(groups: list[Group]) -> None:
    """All values are within their documented ranges, by another route than the checks'."""
    assert groups
    assert len({run.name for group in groups for run in group.runs}) >= 1
    for group in groups:
        for values in (run.values for run in group.runs[:50]):
            json.dumps(values, allow_nan=False)
            for name, value in values.items():
                if name in ROOMS:
                    continue
                numbers = value if isinstance(value, tuple) else (value,)
                for number in numbers:
                    if isinstance(number, int | float) and not isinstance(number, bool):
                        metadata = FIELDS[name].metadata
                        assert (
                            max(number, metadata["low"]) == number == min(number, metadata["high"])
                        )


@pytest.mark.parametrize("seed", quick(2, of=4))
def test_100_generated_configurations(seed: int) -> None:
    draw, valid = random.Random(seed), 0
    for _ in range(100):
        names = draw.sample([*FIELDS, "no_such_setting"], draw.randint(1, 3))
        grid: dict[str, Any] = {}
        for name in names:
            count = draw.choice([0, 1, 1, 1, 1, 2])
            sane = [getattr(FIELDS.get(name), "default", 1)] if draw.random() < 0.5 else VALUES
            grid[name] = [draw.choice(sane) for _ in range(count)]
            if draw.random() < 0.05:
                grid[name] = draw.choice(VALUES)
        groups, complaint = [], ""
        try:
            groups = build_groups(draw.choice(list(PRESETS)), grid)
        except SettingError as error:
            complaint = str(error)
        if groups:
            valid += 1
            assert_sound(groups)
        else:
            assert complaint.partition(":")[0] in names, grid
    assert 0 < valid < 80  # both happen


@pytest.fixture
def planned(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Instead of training: what would be trained."""
    plans: list[Any] = []

    def plan(options: Any, asked: Any, command: Any) -> int:
        del command
        groups = asked.groups
        if groups is None:
            groups = RunDirectory.open(options.resume).config.groups()
        plans.append(groups)
        return 0

    monkeypatch.setattr(sweep, "train_groups", plan)
    monkeypatch.setattr(train, "train_groups", plan)
    return plans


@pytest.mark.parametrize("seed", quick(2, of=4))
def test_60_generated_command_lines(
    seed: int, planned: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    draw, valid = random.Random(seed), 0
    for _ in range(60):
        arguments, names = [], draw.sample(OPTIONS, draw.randint(1, 3))
        for name in names:
            count = draw.choice([0, 1, 1, 1, 1, 2])
            sane = draw.random() < 0.4 and name in FIELDS
            words = [_spelled(FIELDS[name].default)] if sane else WORDS
            arguments += [
                f"--{name.replace('_', '-')}",
                *(draw.choice(words) for _ in range(count)),
            ]
        planned.clear()
        code, out, text = outcome(draw.choice([sweep.main, train.main]), arguments, capsys)
        assert out == ""
        if code == 0:
            valid += 1
            assert text == ""
            assert_sound(planned[0])
            continue
        assert code == 2, arguments
        assert text.startswith("error: ")
        assert text.count("\n") == 1
        given = [*names, *(word for word in arguments if not word.startswith("--"))]
        # Long words are wrapped and cut, and line ends in words become spaces.
        message, *shown = (_on_one_line(word) for word in (text, *given))
        told = any(word[:500] in message for word in shown if word)
        assert "" in arguments or told, (arguments, text)
    assert 2 < valid < 58


def _on_one_line(text: str) -> str:
    """As messages show it, but for spaces."""
    shown = "".join(text.replace("-", "_").split())
    return "".join(letter if letter.isprintable() else "?" for letter in shown)


def _spelled(value: Any) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return "8" if isinstance(value, tuple) else str(0.5 if value is None else value)


@pytest.mark.parametrize("seed", quick(1, of=2))
def test_50_generated_config_files(
    seed: int, tmp_path: Path, planned: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    (group,) = build_groups("smoke", {})
    written = {
        "format": 2,
        "groups": [{"runs": [{"name": run.name, **run.values} for run in group.runs]}],
        "versions": {},
    }
    text, draw = json.dumps(written), random.Random(seed)
    path = tmp_path / "config.json"
    for trial in range(50):
        start, end = sorted(draw.sample(range(len(text)), 2))
        word = draw.choice([*WORDS, "null", "[]", "{}", "[[" * 1000, "NaN", '"x"', "1e999"])
        end = end if trial % 5 == 0 else min(start + draw.randint(1, 9), len(text))
        path.write_text(text[:start] + word + text[end:])
        planned.clear()
        code, out, message = outcome(sweep.main, ["--resume", str(tmp_path)], capsys)
        assert out == ""
        if code == 0:
            assert_sound(planned[0])
        else:
            assert code == 2
            assert message.startswith(f"error: {path} is damaged: ")
            assert message.count("\n") == 1


CONTRADICTIONS = {
    "--resume {} --out x": "resume: a sweep resumes as it was begun, without out",
    "--resume {} --preset smoke": "resume: a sweep resumes as it was begun, without preset",
    "--resume {} --config x": "resume: a sweep resumes as it was begun, without config",
    "--resume {}": "holds no sweep: config.json is missing",
    "--resume {}/nowhere": "error: there is no directory /",
    "--checkpoint-seconds -1": "checkpoint_seconds: -1.0 is not a finite number of at least 0",
    "--checkpoint-seconds nan": "checkpoint_seconds: nan is not a finite number of at least 0",
    "--seeds 1000000": "seed: more than 100,000 runs in one sweep",
    "--preset ": "--preset",
}


@pytest.mark.parametrize("line", CONTRADICTIONS)
def test_contradictions_are_refused_by_name(
    line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = line.format(tmp_path).split()
    code, out, text = outcome(sweep.main, arguments, capsys)
    assert out == ""
    assert code == 2
    assert CONTRADICTIONS[line] in text


def test_a_name_too_long_for_a_file_is_cut_and_stays_its_own() -> None:
    environments = [f"/tmp/{'é' * 120}.py:{factory}" for factory in ("One", "Other")]
    groups = build_groups("smoke", {"env": environments, "seed": [0, 12]})
    names = [run.name for group in groups for run in group.runs]
    assert len(set(names)) == len(names) == 8
    assert all(190 < len(name.encode()) <= 200 for name in names)
    assert {name.rpartition("_")[2] for name in names} == {"seed0", "seed12"}


def test_numpys_numbers_are_numbers() -> None:
    import numpy as np

    groups = build_groups("smoke", {"c_g": [np.float64(0.3)], "epochs": [np.int64(3)]})
    assert dataclasses.asdict(groups[0].settings)["epochs"] == 3


EACH_WITHOUT_A_DEVICE = """
import json, sys
from cgm_jax import sweep
from cgm_jax.host.command_line import run_program

for words in json.loads(sys.argv[1]):
    try:
        run_program(lambda: sweep.main(words))
    except SystemExit as end:
        from jax._src.xla_bridge import backends_are_initialized
        print(end.code, backends_are_initialized(), "mujoco" in sys.modules)
"""


def test_bad_input_is_refused_before_a_device_is_touched() -> None:
    refused = [["--c-g", "nan"], ["--resume", "/nowhere"], ["--x"]]
    result = subprocess.run(
        [sys.executable, "-c", EACH_WITHOUT_A_DEVICE, json.dumps(refused)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    assert result.stdout.splitlines() == ["2 False False"] * len(refused)
    lines = result.stderr.splitlines()
    assert len(lines) == len(refused), result.stderr
    assert all(line.startswith("error: ") for line in lines)
