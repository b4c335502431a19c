"""What a sweep says and returns at its end, whatever becomes of its figures."""

from pathlib import Path
from typing import Any

import pytest

from cgm_jax import sweep
from cgm_jax.config import named
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import build_groups
from cgm_jax.host import conclusion
from cgm_jax.results import figures
from cgm_jax.storage.run_directory import RunDirectory
from tests.cgm_jax import own_environments
from tests.cgm_jax.sweeps import rows

DIVERGED = {"failure": "critic", "success_rate": 0.5}
DROPPED = {"failure": None, "success_rate": None}
HEALTHY = {"failure": None, "success_rate": 0.0}


@pytest.mark.parametrize(
    ("last", "code", "said"),
    [
        ([HEALTHY, HEALTHY], 0, []),
        ([HEALTHY, DIVERGED], 3, ["1 of 2 runs diverged"]),
        ([DROPPED, HEALTHY], 3, ["1 of 2 runs had no valid episode in their last evaluation"]),
        (
            [DROPPED, DIVERGED, DROPPED],
            3,
            ["1 of 3 runs diverged", "2 of 3 runs had no valid episode in their last evaluation"],
        ),
    ],
)
def test_runs_that_are_not_as_they_should_be_are_told(
    last: list[dict[str, Any]], code: int, said: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert conclusion.exit_code_of(last) == code
    assert capsys.readouterr().err.splitlines() == said


@pytest.fixture
def directory(tmp_path: Path) -> RunDirectory:
    """A sweep with one epoch of one run."""
    with RunDirectory.claimed(tmp_path / "out", fresh=True) as directory:
        directory.config.write(build_groups("smoke", {}), "smoke", "cpu")
    row = {
        **{"run": "reach_ddpg-her_cgm-cg0.1-kappa4_seed0", "env": "reach", "seed": 0, "epoch": 1},
        **{"curriculum": "cgm", "agent": "ddpg", "cgm": True, "her": True, "c_g": 0.1, "kappa": 4},
        **{"env_steps": 200, "success_rate": 0.5, "failed_epoch": None, "failure": None},
        **{"mask_rate_estimated": [0.5] * 8, "mask_rate_training": [0.5] * 8},
    }
    directory.append_metrics([row])
    return directory


def test_a_figure_that_cannot_be_drawn_is_one_line_and_the_others_are(
    directory: RunDirectory, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def epochs_to_half(rows: object) -> None:
        raise ValueError("first\nsecond")

    monkeypatch.setattr(figures, "epochs_to_half", epochs_to_half)
    conclusion.try_to_draw_figures(directory)
    drawn = sorted(path.name for path in (directory.path / "figures").iterdir())
    assert drawn == ["learning_curves.png", "mask_success.png"]
    path = directory.path / "figures" / "epochs_to_half.png"
    line = f"{path} is not drawn: ValueError: first\n"
    assert capsys.readouterr().err == line


def test_metrics_that_cannot_be_read_cost_figures_and_nothing_else(
    directory: RunDirectory, capsys: pytest.CaptureFixture[str]
) -> None:
    (directory.path / "metrics.jsonl").write_bytes(b"\xff\n")
    conclusion.try_to_draw_figures(directory)
    assert capsys.readouterr().err.startswith("no figures drawn: UnicodeDecodeError: ")


def test_without_any_epoch_there_is_nothing_to_draw(directory: RunDirectory) -> None:
    (directory.path / "metrics.jsonl").write_text("")
    conclusion.try_to_draw_figures(directory)
    assert not list((directory.path / "figures").iterdir())


@pytest.mark.slow
def test_a_sweep_whose_episodes_are_all_dropped_ends_with_a_summary_that_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(directory: object) -> None:
        raise RuntimeError("no display")

    monkeypatch.setattr(figures, "draw_figures", fails)
    out, file = tmp_path / "out", own_environments.__file__
    envs = [f"{file}:{name}" for name in ("NeverValid", "Base")]
    options = ["--preset", "smoke", "--kappa", "4", "--epochs", "1", "--out", str(out)]
    assert sweep.main([*options, "--env", *envs]) == 3
    captured = capsys.readouterr()
    never, base = sorted(captured.out.splitlines()[:2], reverse=True)
    assert never.startswith("own_environments-NeverValid_")
    assert never.endswith("  no valid episode")
    assert base.startswith("own_environments-Base_")
    assert base.endswith(" %")
    assert "observation is not finite after reset of " in captured.err
    assert "1 of 2 runs had no valid episode in their last evaluation" in captured.err
    assert "no figures drawn: RuntimeError: no display" in captured.err


@pytest.mark.slow
def test_an_edited_or_moved_file_is_refused_until_it_is_named_again_and_then_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(figures, "draw_figures", lambda _: None)
    for names in ("_named_now", "_from_config"):
        monkeypatch.setattr(named, names, set())
    file, out = tmp_path / "mine" / "env.py", tmp_path / "out"
    file.parent.mkdir()
    file.write_text(Path(own_environments.__file__).read_text())
    options = ["--preset", "smoke", "--kappa", "4", "--epochs", "1", "--out", str(out)]
    assert sweep.main([*options, "--env", f"{file}:Base"]) == 0
    named._named_now.clear()
    assert sweep.main(["--resume", str(out)]) == 0  # as it was named
    assert "bits may differ" not in capsys.readouterr().err
    with file.open("a") as end:
        end.write("# edited\n")
    with pytest.raises(SettingError, match="has changed since you named it on this machine"):
        sweep.main(["--resume", str(out)])
    assert sweep.main(["--resume", str(out), "--env", f"{file}:Base"]) == 0
    said = capsys.readouterr().err
    assert f"bits may differ, since it was begun with {file} with SHA-256 " in said

    moved = tmp_path / "elsewhere.py"
    file.rename(moved)
    named._named_now.clear()
    assert sweep.main(["--resume", str(out), "--env", f"{moved}:Base"]) == 0
    assert f"begun with {file}:Base (now {moved}:Base), {moved} with SHA-256" in (
        capsys.readouterr().err
    )
    assert {row["env"] for row in rows(out)} == {f"{moved}:Base"}
    named._named_now.clear()
    assert sweep.main(["--resume", str(out)]) == 0
