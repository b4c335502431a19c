"""Run directories from anybody: hostile names, links and files, and what is no sweep at all."""

import json
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.launching.directory import read_launch
from cgm_jax.storage.layout import CONFIG
from cgm_jax.storage.run_directory import RunDirectory

NAMES = [
    *("../../../escape", "/escape", "a/b", "a\\b", "a\0b", "a\nb", "", "x" * 300, "\ud800"),
    *("\x1b[31m", 5, None, ["a"], {"a": 1}),
]


@pytest.mark.parametrize("name", NAMES)
def test_names_of_runs_never_leave_the_directory(name: Any, tmp_path: Path) -> None:
    with RunDirectory.claimed(tmp_path, fresh=True) as directory:
        directory.config.write(build_groups("smoke", {}), "smoke", "cpu")
    config = json.loads((tmp_path / CONFIG).read_text())
    config["groups"][0]["runs"][0]["name"] = name
    (tmp_path / CONFIG).write_text(json.dumps(config))
    with pytest.raises(SettingError, match=r"config.json is damaged: run: .* is no name for a"):
        directory.config.groups()


LINKS = [
    *("policies", "policies/x.npz", "policies/x.npz.partial", "checkpoints/x.npz"),
    *("metrics.jsonl", "lock", "holder", CONFIG),
]


@pytest.mark.parametrize("link", LINKS)
def test_a_directory_with_a_link_is_neither_read_nor_written(link: str, tmp_path: Path) -> None:
    out, target = tmp_path / "out", tmp_path / "target"
    with RunDirectory.claimed(out, fresh=True) as directory:
        directory.config.write(build_groups("smoke", {}), "smoke", "cpu")
    target.write_bytes((out / CONFIG).read_bytes())
    if link == "policies":
        shutil.rmtree(out / link)
    (out / link).unlink(missing_ok=True)
    (out / link).symlink_to(target)
    before = target.read_bytes()
    complaint = f"{out / link} is a symbolic link, which a run directory may not hold"
    with pytest.raises(SettingError, match=re.escape(complaint)):
        RunDirectory.open(out)
    with pytest.raises(SettingError, match=re.escape(complaint)):
        RunDirectory(out).config.restore()
    with (
        pytest.raises(SettingError, match=re.escape(complaint)),
        RunDirectory.claimed(out, fresh=False),
    ):
        pass
    assert target.read_bytes() == before


NO_SWEEP = {
    "nowhere": "there is no directory {path}",
    "sweep/config.json": "{path} is no directory",
    "sweep/config.json/x": "there is no directory {path}",
    "x" * 300: "cannot look at {path}: File name too long",
    "empty": "{path} holds no sweep: config.json is missing",
    "launch": "{path} holds no sweep, but a launch, whose parts are in {path}/parts; to resume it: "
    "{python} -m cgm_jax.launch --resume {path}",
}
NO_LAUNCH = {
    "nowhere": "resume: there is no directory {path}",
    "empty": "resume: {path} holds no launch: launch.json is missing",
    "sweep": "resume: {path} holds no launch, but a sweep; to resume it: "
    "{python} -m cgm_jax.sweep --resume {path}",
}


@pytest.mark.parametrize(
    ("opened", "name", "line"),
    [
        *((RunDirectory.open, *item) for item in NO_SWEEP.items()),
        *((read_launch, *item) for item in NO_LAUNCH.items()),
    ],
)
def test_what_is_there_instead_of_a_sweep_or_a_launch_is_said(
    opened: Callable[[Path], object], name: str, line: str, tmp_path: Path
) -> None:
    for file in ("launch/launch.json", "sweep/config.json", "empty/other"):
        (tmp_path / file).parent.mkdir()
        (tmp_path / file).write_text("{}")
    with pytest.raises(SettingError) as refused:
        opened(tmp_path / name)
    assert str(refused.value) == line.format(path=tmp_path / name, python=sys.executable)


def test_a_link_to_a_run_directory_is_fine(tmp_path: Path) -> None:
    with RunDirectory.claimed(tmp_path / "out", fresh=True) as directory:
        directory.config.write(build_groups("smoke", {}), "smoke", "cpu")
    (tmp_path / "link").symlink_to(tmp_path / "out")
    assert len(RunDirectory.open(tmp_path / "link").config.groups()[0].runs) == 2


def test_of_a_trackers_files_only_the_link_beside_wandbs_log_may_be_one(tmp_path: Path) -> None:
    with RunDirectory.claimed(tmp_path / "out", fresh=True) as directory:
        directory.config.write(build_groups("smoke", {}), "smoke", "cpu")
    logs = tmp_path / "out/tracking/wandb/wandb/offline-run-1/logs"
    logs.mkdir(parents=True)
    (logs / "debug-core.log").symlink_to(tmp_path / "log")
    RunDirectory.open(tmp_path / "out")
    for link in ("tracking/debug-core.log", "tracking/tensorboard"):
        (tmp_path / "out" / link).symlink_to(tmp_path)
        with pytest.raises(SettingError, match=f"{link} is a symbolic link"):
            RunDirectory.open(tmp_path / "out")
        (tmp_path / "out" / link).unlink()


CONFIGS = {
    "{}": "KeyError",
    "[]": "AttributeError",
    "5": "AttributeError",
    '{"format": 2, "groups": []}': "it needs runs",
    '{"format": 2, "groups": [{"runs": []}]}': "ValueError",
    '{"format": 2, "groups": {"a": 1}}': "TypeError",
    '{"format": 2, "groups": [{"runs": [5]}]}': "TypeError",
    '{"format": 2, "groups": [{"runs": [{"name": "a", "env": 5}]}]}': "env: 5 is not of type str",
    '{"format": 2, "groups": [{"runs": [{"name": "a", "epochs": 1e999}]}]}': "epochs: inf",
    '{"format": 2, "groups": [{"runs": [{"name": "a", "agent": ["b"]}]}]}': "agent: ",
    '{"format": 2, "groups": [{"runs": [{"name": "a"}, {"name": "a"}]}]}': "name of its own",
    "[" * 100_000: "RecursionError",
    '{"format": 2, "groups": ' + "[" * 900 + "]" * 900 + "}": "Error",
    '{"x": ' + "[" * 400 + "]" * 400 + "}": "RecursionError",
    "9" * 5000: "ValueError",
    "\xff": "Error",
}


@pytest.mark.parametrize("text", CONFIGS, ids=range(len(CONFIGS)))
def test_hostile_configs_are_refused_in_one_line(text: str, tmp_path: Path) -> None:
    (tmp_path / CONFIG).write_bytes(text.encode("latin-1"))
    directory = RunDirectory.open(tmp_path)
    for read in (
        directory.config.groups,
        lambda: directory.config.moved({"env": ["a.py:B"]}) or directory.config.groups(),
    ):
        with pytest.raises(SettingError) as caught:
            read()
        assert "\n" not in str(caught.value)
    with pytest.raises(SettingError, match=f"config.json is damaged: .*{CONFIGS[text]}"):
        directory.config.groups()


def test_a_config_beyond_all_measure_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / CONFIG).open("wb") as file:
        file.truncate(2**30)
    with pytest.raises(SettingError, match="it has more than 268,435,456 bytes"):
        RunDirectory.open(tmp_path).config.groups()
