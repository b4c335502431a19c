"""Sweeps in the directory of a launch: its own, merged, and those that have no business there."""

import errno
import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from cgm_jax import launch as program
from cgm_jax import sweep, train
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.host import to_train
from cgm_jax.launching.directory import Launch, Resources
from cgm_jax.storage.checkpoints import write_manifest
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax.refusing import refusing
from tests.cgm_jax.results.figures import made

EPOCHS = 2


@pytest.fixture
def launched(folder: Path) -> Launch:
    """A launch that was stopped."""
    words = ("--preset", "smoke", "--kappa", "4", "--epochs", str(EPOCHS), "--seeds", "2")
    launch = Launch(folder / "out", "local", 2, "smoke", words, Resources())
    launch.path.mkdir()
    launch.write()
    return launch


@pytest.fixture(autouse=True)
def no_training(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(to_train, "plan", lambda *_, **__: pytest.fail("it was built"))
    monkeypatch.setattr(program, "supervise", lambda *_: pytest.fail("parts are trained"))


def hold_sweep(launch: Launch, until: int, **entries: Any) -> None:
    """Put a sweep with the launch's settings and rows of so many epochs in its directory."""
    (group,) = build_groups("smoke", {"kappa": [4.0], "epochs": [EPOCHS], "seed": [0, 1]})
    with RunDirectory.claimed(launch.path, fresh=False) as directory:
        directory.config.write([group], "smoke", "1 x cpu")
        directory.config.replace({**directory.config.read(), **entries})
        rates = [0.5] * until
        pairs = [(run, row) for run in group.runs for row in made.run(rates)]
        directory.append_metrics(
            [row | {"run": run.name, "physics_warnings": 0} for run, row in pairs]
        )


@pytest.mark.parametrize("main", [sweep.main, train.main])
def test_no_sweep_begins_in_the_directory_of_a_launch(main: Any, launched: Launch) -> None:
    before = sorted(launched.path.rglob("*"))
    with pytest.raises(SettingError, match=r"^out: out already holds a launch; name another dir"):
        main(["--preset", "smoke", "--out", "out"])
    assert sorted(launched.path.rglob("*")) == before


@pytest.mark.parametrize("until", [1, EPOCHS])
def test_a_sweep_that_began_there_all_the_same_is_not_taken_for_the_launchs(
    until: int, launched: Launch
) -> None:
    hold_sweep(launched, until)
    before = (launched.path / "launch.json").read_bytes()
    with pytest.raises(SettingError, match=r"^out: .*/out holds another sweep besides the launch"):
        program.main(["--resume", "out", "--memory", "2"])
    assert (launched.path / "launch.json").read_bytes() == before


def test_merged_parts_are_concluded_once_all_of_their_runs_are_at_their_end(
    launched: Launch, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cgm_jax.results.figures.draw_figures", lambda _: None)
    hold_sweep(launched, EPOCHS, parts=[{}, {}])
    assert program.main(["--resume", "out"]) == 0
    assert capsys.readouterr().out.endswith(f"2 runs; figures in {launched.path}/figures\n")
    config = json.loads((launched.path / "config.json").read_text())
    for run in config["groups"][0]["runs"]:  # as `sweep --resume out --epochs 3` does
        run["epochs"] = EPOCHS + 1
    (launched.path / "config.json").write_text(json.dumps(config))
    line = r"^resume: .* is merged, and trained for longer since; go on: .*sweep --resume .*/out$"
    with pytest.raises(SettingError, match=line):
        program.main(["--resume", "out"])


def test_a_merged_launch_whose_config_is_lost_gets_it_back_and_is_not_merged_again(
    launched: Launch, capsys: pytest.CaptureFixture[str]
) -> None:
    hold_sweep(launched, EPOCHS, parts=[{}, {}])
    config = launched.path / "config.json"
    longer = json.loads(config.read_text())
    for run in longer["groups"][0]["runs"]:
        run["epochs"] = EPOCHS + 1
    checkpoint = launched.path / "checkpoints/group0_epoch000003_cycle000000.npz"
    checkpoint.touch()
    content = json.dumps(longer).encode()
    write_manifest(checkpoint, hashlib.sha256(b"").hexdigest(), 0, content)
    config.unlink()
    with pytest.raises(SettingError, match="is merged, and trained for longer since"):
        program.main(["--resume", "out"])
    assert f"{config} was missing; restored from {checkpoint}" in capsys.readouterr().err
    assert (config.read_bytes(), checkpoint.exists()) == (content, True)


@pytest.mark.parametrize("stage", ["supervise", "read_parts", "write_merged"])
def test_what_the_system_refuses_while_a_launch_runs_ends_with_74_and_the_way_to_resume(
    stage: str,
    launched: Launch,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(program, "supervise", lambda *_: {1: 0, 2: 0})
    monkeypatch.setattr(program, "read_parts", lambda _: [])
    monkeypatch.setattr(program, "differences", lambda _: [])
    monkeypatch.setattr(program, stage, refusing(errno.ESTALE))
    assert program.main(["--resume", "out"]) == 74
    error, advice = capsys.readouterr().err.splitlines()[-2:]
    assert error.endswith(": Stale file handle")
    assert advice.endswith(f"cgm_jax.launch --resume {launched.path}")


def test_the_way_to_resume_names_an_address_only_where_it_is_rays() -> None:
    named = Resources(address="ray://there:1")
    for on, ending in (("ray", "/out --address ray://there:1"), ("local", "/out")):
        launch = Launch(Path("/out"), on, 2, "smoke", (), named)
        assert program._how_to_resume(launch).endswith(ending)
