"""The programs as a user runs them, each in a process of its own."""

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import cgm_jax.evaluate
import cgm_jax.sweep
import cgm_jax.train
from cgm_jax import curricula
from cgm_jax.config.fields import SettingError
from cgm_jax.host.asked import asked_for
from cgm_jax.host.command_line import parse, remark_on_repeated
from cgm_jax.loop.compiler import Compiler
from cgm_jax.sweep import SweepOptions
from tests.cgm_jax.host.in_process import outcome
from tests.cgm_jax.sweeps import ROOT

SMOKE = ["--preset", "smoke", "--engine", "native"]


def run(program: str, *arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", f"cgm_jax.{program}", *arguments],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=cwd,
        check=False,
    )


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A smoke sweep over c_g and CGM on and off."""
    out = tmp_path_factory.mktemp("sweep") / "out"
    grid = ["--c-g", "0.1", "0.6", "--kappa", "4", "--curriculum", "cgm", "full", "--seeds", "1"]
    result = run("sweep", *SMOKE, *grid, "--out", str(out))
    assert result.returncode == 0, result.stderr
    assert (
        "memory for 2 runs: " in result.stderr
    )  # how much memory a program takes, said beforehand
    assert "epoch 2:" in result.stderr
    return out


def test_the_guide_names_all_columns(sweep: Path) -> None:
    guide = (Path(__file__).parents[3] / "docs" / "sweeps.md").read_text()
    table = guide.partition("Columns of `metrics.jsonl`")[2].partition("\n\nThe rows")[0]
    named = {
        name
        for line in table.splitlines()
        if line.startswith("| `")
        for name in re.findall(r"`(\w+)`", line.split(" | ")[0])
    }
    row = json.loads((sweep / "metrics.jsonl").read_text().splitlines()[0])
    assert {*row} | reported_by_curricula() == named


def reported_by_curricula() -> set[str]:
    """Names in what any curriculum's `report` returns."""
    folder = Path(curricula.__file__).parent
    functions = [
        node
        for path in folder.glob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef) and node.name == "report"
    ]
    shown = [node for one in functions for node in ast.walk(one) if isinstance(node, ast.Dict)]
    names = {key.value for one in shown for key in one.keys if isinstance(key, ast.Constant)}
    return {name for name in names if isinstance(name, str)}


def test_a_sweep_writes_one_line_per_run_and_epoch(sweep: Path) -> None:
    rows = [json.loads(line) for line in (sweep / "metrics.jsonl").read_text().splitlines()]
    assert sorted((row["run"], row["epoch"]) for row in rows) == sorted(
        (name, epoch)
        for name in (
            "reach_ddpg-her_cgm-cg0.1-kappa4_seed0",
            "reach_ddpg-her_cgm-cg0.6-kappa4_seed0",
            "reach_ddpg-her_full_seed0",
        )
        for epoch in (1, 2)
    )
    for row in rows:
        assert row["env"] == "reach"
        assert row["seed"] == 0
        assert row["her"] is True
        assert row["cgm"] is ("full" not in row["run"])
        assert row["env_steps"] == row["epoch"] * 2 * 4 * 50
        assert row["updates"] == row["epoch"] * 2 * 4
        assert row["wall_s"] > 0
        assert 0 <= row["success_rate"] <= 1
        assert len(row["subgoal_success"]) == 3
        assert row["curriculum"] == ("cgm" if row["cgm"] else "full")
        assert len(row["mask_rate_training"]) == len(row["mask_share"]) == 8
        assert 0 <= row["moved_share"] <= 1
        for name in ("mask_rate_estimated", "mask_probability"):
            assert len(row[name]) == 8 if row["cgm"] else row[name] is None
        assert not row["cgm"] or sum(row["mask_probability"]) == pytest.approx(1, abs=1e-4)
    full = next(row for row in rows if not row["cgm"])
    assert full["mask_rate_training"][:7] == [None] * 7
    first = next(row for row in rows if row["c_g"] == 0.6 and row["cgm"] and row["epoch"] == 1)
    assert first["mask_rate_estimated"][7] == pytest.approx(0.6, abs=1e-4)


def test_a_sweep_writes_its_config_policies_figures_and_checkpoint(sweep: Path) -> None:
    config = json.loads((sweep / "config.json").read_text())
    runs = [run for group in config["groups"] for run in group["runs"]]
    assert [run["curriculum"] for run in runs] == ["cgm", "cgm", "full"]
    assert {run["env"] for run in runs} == {"reach"}
    assert config["versions"]["mujoco"] == config["versions"]["mujoco-mjx"] == "3.17.0"
    for entry in runs:
        assert (sweep / "policies" / f"{entry['name']}.npz").is_file()
    for figure in ("learning_curves", "epochs_to_half", "mask_success"):
        header = (sweep / "figures" / f"{figure}.png").read_bytes()[:8]
        assert header == b"\x89PNG\r\n\x1a\n"
    checkpoints = list((sweep / "checkpoints").glob("*.npz"))
    # One per program, the last; on a slow machine also the one before an evaluation.
    last = {f"group{program}_epoch000002_cycle000000.npz" for program in (0, 1)}
    assert last <= {path.name for path in checkpoints}
    assert all(path.with_suffix(".json").is_file() for path in checkpoints)


def test_a_directory_that_holds_a_sweep_is_refused_and_left_alone(
    sweep: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (sweep / "metrics.jsonl").read_bytes()
    code, _, text = outcome(cgm_jax.sweep.main, [*SMOKE, "--out", str(sweep)], capsys)
    assert code == 2
    assert "already holds a sweep" in text
    assert (sweep / "metrics.jsonl").read_bytes() == before


def test_evaluate_reports_success_with_its_interval(
    sweep: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(sweep), "--episodes", "50"]
    code, out, errors = outcome(cgm_jax.evaluate.main, words, capsys)
    assert code == 0, errors
    lines = out.splitlines()
    assert len(lines) == 3
    assert all("95 %:" in line and "50 episodes" in line for line in lines)
    assert outcome(cgm_jax.evaluate.main, words, capsys)[:2] == (0, out)


def test_evaluate_refuses_damaged_policies(sweep: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = next((sweep / "policies").iterdir())
    intact = path.read_bytes()
    try:
        path.write_bytes(intact[: len(intact) // 2])
        code, _, text = outcome(cgm_jax.evaluate.main, [str(sweep)], capsys)
        assert code == 2
        assert path.name in text
        np.savez(path, something=np.zeros(3))
        code, _, text = outcome(cgm_jax.evaluate.main, [str(sweep)], capsys)
        assert code == 2
        assert "not a policy file" in text
        path.unlink()  # of a sweep that was stopped before its first policy
        words = [str(sweep), "--episodes", "5"]
        code, out, _ = outcome(cgm_jax.evaluate.main, words, capsys)
        assert code == 0
        assert len(out.splitlines()) == 2
    finally:
        path.write_bytes(intact)


def test_train_learns_on_an_environment_from_the_users_own_file(tmp_path: Path) -> None:
    settings = ["--epochs", "3", "--cycles-per-epoch", "20", "--environments", "16"]
    settings += ["--updates-per-cycle", "40", "--batch-size", "128", "--hidden-layers", "64", "64"]
    settings += ["--target-update-every", "1", "--replay-transitions", "50000"]
    settings += ["--evaluation-episodes", "50"]
    example = ROOT / "tests" / "examples" / "point_mass.py"
    result = run(
        "train",
        *("--preset", "smoke", "--env", f"{example}:PointMass", "--out", "out", *settings),
        cwd=tmp_path,
    )
    assert result.returncode == 0, result.stderr
    last = json.loads((tmp_path / "out" / "metrics.jsonl").read_text().splitlines()[-1])
    assert last["success_rate"] >= 0.9
    assert len(last["mask_probability"]) == 4


BAD_INPUT = {
    "--env slide": "choose from reach, push, pick_and_place, FILE.py:NAME of your own, or gymn",
    "--env nowhere.py:Thing": "nowhere.py:Thing' is not FILE.py:NAME",
    "--env push --air-probability 0.5": "air_probability: the object of push",
    "--engine bullet": "engine: unknown engine 'bullet'",
    "--c-g": "c_g: needs at least one value",
    "--c-g 1.5": "c_g: 1.5 is not within [0, 1]",
    "--c-g tiny": "--c-g",
    "--kappa nan": "kappa: nan is not a finite number",
    "--seeds 0": "seeds: 0 is not within",
    "--seeds 2 --seed 1": "seeds: give either",
    "--curriculum nothing": "curriculum: unknown curriculum 'nothing'; choose from",
    "--agent nowhere.py:Thing": "nowhere.py:Thing' is not FILE.py:NAME",
    "--curriculum full --c-g 0.5": "c_g: is no setting of curriculum full, agent ddpg, relabelling",
    "--set gain": "set: 'gain' is not NAME=VALUE",
    "--set curriculum=x.py:Y": "set: curriculum is an option of its own, --curriculum",
    "--set discount=0.9 discount=0.8": "set: discount is given twice; several values are discount=",
    "--her None": "None is no value here; leave the option out, or --set NAME=None",
    "--leave-at=None": "None is no value here; leave the option out, or --set NAME=None",
    "--set gain=3": "gain: is no setting of curriculum cgm",
    "--colour red": "--colour",
    "--preset huge": "preset: unknown",
    "--kappa 4 --kappa 7 --colour red": "--colour",
    "--kappa 4 --kappa nan": "kappa: nan",
    "--env reach --env slide": "choose from reach, push, pick_and_place",
    "--curriculum goid --neighbours 1": "neighbours: the success of 1 episode is 0 or 1, never",
    "--curriculum starts --practised-episodes 1": "practised_episodes: the success of 1 episode",
    "--her maybe": "invalid choice 'maybe' for argument '--her'. Expected one of ('o",
    "--hidden-layers 64.5": "hidden_layers: '64.5' is neither widths (256 256) nor several",
    "--out /proc/nowhere": "out: cannot write to /proc/nowhere",
}


def bad_words(arguments: str, tmp_path: Path) -> list[str]:
    """A command line that is to be refused."""
    options = arguments.split()
    if "--preset" not in options:
        options = [*SMOKE[:2], *options]
    return options if "--out" in options else [*options, "--out", str(tmp_path / "out")]


@pytest.mark.parametrize("arguments", BAD_INPUT)
def test_bad_input_ends_with_one_line_and_code_two_before_anything_compiles(
    arguments: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(Compiler, "programs", lambda *_, **__: pytest.fail("it compiles"))
    code, out, text = outcome(cgm_jax.sweep.main, bad_words(arguments, tmp_path), capsys)
    assert (code, out) == (2, "")
    (line,) = text.splitlines()
    assert line.startswith("error: ")
    assert BAD_INPUT[arguments] in line
    assert "'None'" not in line
    assert not (tmp_path / "out").exists()


EACH = """
import importlib, json, sys
from cgm_jax.host.command_line import run_program

program = importlib.import_module(f"cgm_jax.{sys.argv[1]}")
for words in json.loads(sys.argv[2]):
    try:
        run_program(lambda: program.main(words))
    except SystemExit as end:
        print(end.code)
"""


def run_each(
    program: str, command_lines: list[list[str]], **variables: str
) -> subprocess.CompletedProcess[str]:
    """A program in one process for several command lines, each of which prints its exit code."""
    return subprocess.run(
        [sys.executable, "-c", EACH, program, json.dumps(command_lines)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **variables},
        cwd=ROOT,
    )


def test_so_does_a_process(tmp_path: Path) -> None:
    refused = ("--env slide", "--kappa nan", "--colour red")
    result = run_each("sweep", [bad_words(arguments, tmp_path) for arguments in refused])
    assert result.stdout.split() == ["2"] * len(refused)
    for arguments, line in zip(refused, result.stderr.splitlines(), strict=True):
        assert line.startswith("error: ")
        assert BAD_INPUT[arguments] in line


def test_an_option_that_is_given_twice_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--kappa", "4", "--c_g", "0.1", "--kappa=7", "--c-g", "0.2"]
    groups = asked_for(parse(SweepOptions, [*SMOKE[:2], *words], "sweep")).groups
    assert capsys.readouterr().err == ""  # something may be refused yet
    remark_on_repeated()
    assert capsys.readouterr().err.splitlines() == [
        "--kappa is given twice: only the last counts",
        "--c-g is given twice: only the last counts",
    ]
    names = [run.name for group in groups or [] for run in group.runs]
    assert names
    assert all("cg0.2-kappa7" in name for name in names)


MISSPELT = {
    "--epcohs 2": "--epcohs, 2; perhaps --epochs",
    "--epoch 2": "--epoch, 2; perhaps --cycles-per-epoch or --epochs",
    "--xyzzy": "--xyzzy",
    "--out x stray words": "stray, words",
}


@pytest.mark.parametrize("encoding", ["ascii", "utf-8"])
def test_a_misspelt_option_is_told_what_it_may_be_meant_to_be(encoding: str) -> None:
    result = run_each("train", [words.split() for words in MISSPELT], PYTHONIOENCODING=encoding)
    assert result.stdout.split() == ["2"] * len(MISSPELT)
    assert result.stderr.splitlines() == [
        f"error: Unrecognized options: {meant}" for meant in MISSPELT.values()
    ]


@pytest.mark.parametrize("more", [[], ["--dry-run"]])
def test_a_directory_that_cannot_be_made_is_refused_at_once(
    more: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("mine")
    for out in (file, file / "below" / "it"):
        words = ["--preset", "smoke", "--out", str(out), *more]
        ended = outcome(cgm_jax.train.main, words, capsys)
        assert ended == (2, "", f"error: out: {file} is no directory\n")
    assert file.read_text() == "mine"


def test_train_refuses_a_grid(capsys: pytest.CaptureFixture[str]) -> None:
    line = "error: c_g: takes one value here; cgm_jax.sweep takes several\n"
    assert outcome(cgm_jax.train.main, ["--c-g", "0.1", "0.2"], capsys) == (2, "", line)


@pytest.mark.parametrize("option", ["--tyro-write-completion", "--tyro_write-completion"])
@pytest.mark.parametrize("before", [[], ["--preset", "smoke"]])
def test_no_option_writes_a_completion_script(
    option: str, before: list[str], tmp_path: Path
) -> None:
    words = [*before, option, "bash", str(tmp_path / "script")]
    with pytest.raises(SettingError, match=rf"^'{option}' is no option here$"):
        parse(SweepOptions, words, "sweep")
    assert not (tmp_path / "script").exists()


@pytest.mark.parametrize("word", ["-h", "--help"])
def test_a_file_cannot_ask_for_help(word: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SettingError, match=f"^'{word}' is no option here$"):
        parse(SweepOptions, ["--preset", "smoke", word], "sweep", from_file=True)
    assert not capsys.readouterr().out
