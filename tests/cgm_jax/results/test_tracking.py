"""What a tracker is sent: each epoch once, whatever happens in between."""

import json
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import pytest

from cgm_jax import sweep
from cgm_jax.config.components import TRACK, builtin
from cgm_jax.config.fields import SettingError
from cgm_jax.config.grid import Run, build_groups
from cgm_jax.host import session
from cgm_jax.results.trackers.protocol import Tracker
from cgm_jax.results.trackers.wandb import WeightsAndBiases
from cgm_jax.results.tracking import Tracking, find_tracker, scalars
from cgm_jax.storage.metrics import Row
from tests.cgm_jax.sweeps import POINT_MASS, ROOT, command, finish, rows, stop

TEXT_FILE = f"{ROOT / 'tests/examples/my_tracker.py'}:TextFile"
FAILING = f"{Path(__file__)}:Failing"
FOLDER = "tracking/my_tracker-TextFile"


class Failing(Tracker):
    """Remembers what it is asked for, and fails at what it is told to."""

    asked: ClassVar[list[str]] = []
    fails_at: ClassVar[str] = ""
    holds: ClassVar[int | None] = None

    def __init__(self, folder: Path, sweep: str) -> None:
        del folder, sweep
        self._do("init")

    def begin(self, run: str, settings: Mapping[str, Any], sent: int) -> int:
        del run, settings
        self._do(f"begin after {sent}")
        return self.holds if self.holds is not None else sent

    def metrics(self, run: str, epoch: int, values: Mapping[str, float]) -> None:
        del run, values
        self._do(f"epoch {epoch}")

    def files(self, run: str, epoch: int, paths: Mapping[str, Path]) -> None:
        del run, epoch
        self._do(f"files {' '.join(paths)}")

    def end(self, run: str) -> None:
        del run
        self._do("end")

    def _do(self, what: str) -> None:
        if what == self.fails_at:
            raise ConnectionError("no route to host\nand more")
        self.asked.append(what)


@pytest.fixture(scope="module")
def runs() -> tuple[Run, ...]:
    (group,) = build_groups("smoke", {"seed": [0, 1], "kappa": [4.0]})
    return group.runs


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> type:
    """The class of FAILING, which has been asked for nothing yet."""
    found = find_tracker(FAILING)
    monkeypatch.setattr(found, "asked", [])
    monkeypatch.setattr(found, "fails_at", "")
    monkeypatch.setattr(found, "holds", None)
    return found


def epoch_rows(runs: tuple[Run, ...], *epochs: int) -> list[Row]:
    return [
        {"run": run.name, "epoch": epoch, "success_rate": epoch / 10, "c_g": 0.1}
        for epoch in epochs
        for run in runs
    ]


def lines(directory: Path, run: str) -> list[str]:
    return (directory / FOLDER / f"{run}.txt").read_text().splitlines()


def test_each_epoch_comes_once_over_all_processes(tmp_path: Path, runs: tuple[Run, ...]) -> None:
    killed = Tracking(TEXT_FILE, tmp_path)
    killed.begin(runs, [])
    for epoch in (1, 2, 3):
        killed.send(epoch_rows(runs, epoch))
    with Tracking(TEXT_FILE, tmp_path) as resumed:  # from a checkpoint of the first epoch
        resumed.begin(runs, epoch_rows(runs, 1))
        for epoch in (2, 3, 4):
            resumed.send(epoch_rows(runs, epoch))
    for run in runs:
        first, *rest, last = lines(tmp_path, run.name)
        assert json.loads(first.removeprefix("settings "))["c_g"] == 0.1
        assert last == "end"
        assert rest == [f'epoch {n} {{"success_rate": {n / 10}}}' for n in (1, 2, 3, 4)]


def test_what_was_trained_before_there_was_a_tracker_is_sent_first(
    tmp_path: Path, runs: tuple[Run, ...]
) -> None:
    with Tracking() as none:
        none.begin(runs, epoch_rows(runs, 1))
        none.send(epoch_rows(runs, 2))
        none.show({"figure": tmp_path / "none.png"}, 2)
    with Tracking(TEXT_FILE, tmp_path) as tracking:
        tracking.begin(runs, epoch_rows(runs, 1, 2))
        tracking.send(epoch_rows(runs, 3))
    words = [line.split()[:2] for line in lines(tmp_path, runs[1].name)[1:-1]]
    assert words == [["epoch", "1"], ["epoch", "2"], ["epoch", "3"]]


@pytest.mark.parametrize("fails_at", ["init", "begin after 0", "epoch 2", "end"])
def test_a_failure_is_said_once_and_what_is_lacking_is_sent_next_time(
    fails_at: str,
    tmp_path: Path,
    runs: tuple[Run, ...],
    failing: Any,
    capsys: pytest.CaptureFixture[str],
) -> None:
    failing.fails_at = fails_at
    with Tracking(FAILING, tmp_path) as tracking:
        tracking.begin(runs[:1], [])
        for epoch in (1, 2, 3):
            tracking.send(epoch_rows(runs[:1], epoch))
    said = capsys.readouterr().err.splitlines()
    assert said == [
        f"track: {FAILING} failed (ConnectionError: no route to host); training continues without "
        "it, and resuming with --track sends what it lacks"
    ]
    failing.fails_at = ""
    with Tracking(FAILING, tmp_path) as tracking:
        tracking.begin(runs[:1], epoch_rows(runs[:1], 1, 2, 3))
    assert capsys.readouterr().err == ""
    assert [word for word in failing.asked if "epoch" in word] == ["epoch 1", "epoch 2", "epoch 3"]
    held = {"init": 0, "begin after 0": 0, "epoch 2": 1, "end": 3}[fails_at]
    assert [word for word in failing.asked if "begin" in word][-1] == f"begin after {held}"


def test_an_epoch_that_was_sent_but_not_recorded_is_named_to_the_tracker(
    tmp_path: Path, runs: tuple[Run, ...], failing: Any
) -> None:
    record = tmp_path / "tracking/test_tracking-Failing.json"
    killed = Tracking(FAILING, tmp_path)
    killed.begin(runs[:1], epoch_rows(runs[:1], 1))
    before = record.read_bytes()
    killed.send(epoch_rows(runs[:1], 2))
    record.write_bytes(before)
    Tracking(FAILING, tmp_path).begin(runs[:1], epoch_rows(runs[:1], 1, 2))
    assert failing.asked[-2:] == ["begin after 1", "epoch 2"]


def test_a_run_that_is_whole_is_opened_again_only_for_more_epochs(
    tmp_path: Path, runs: tuple[Run, ...], failing: Any
) -> None:
    for last in (2, 2, 3):
        with Tracking(FAILING, tmp_path) as tracking:
            tracking.begin(runs[:1], epoch_rows(runs[:1], *range(1, last + 1)))
    whole = ["init", "begin after 0", "epoch 1", "epoch 2", "end"]
    assert failing.asked == [*whole, "init", "init", "begin after 2", "epoch 3", "end"]


@pytest.mark.parametrize(("holds", "sent"), [(0, [1, 2, 3]), (1, [2, 3]), (3, [])])
def test_a_tracker_that_says_what_it_holds_is_sent_the_rest(
    holds: int, sent: list[int], tmp_path: Path, runs: tuple[Run, ...], failing: Any
) -> None:
    Tracking(FAILING, tmp_path).begin(runs[:1], epoch_rows(runs[:1], 1, 2))
    failing.asked.clear()
    failing.holds = holds
    Tracking(FAILING, tmp_path).begin(runs[:1], epoch_rows(runs[:1], 1, 2, 3))
    assert failing.asked == ["init", "begin after 2", *(f"epoch {n}" for n in sent)]


def test_files_are_sent_when_they_are_new_or_have_changed(
    tmp_path: Path, runs: tuple[Run, ...], failing: Any
) -> None:
    one, other = tmp_path / "one.png", tmp_path / "other.gif"
    one.write_bytes(b"1")
    other.write_bytes(b"1")
    paths = {"one": one, "other": other}
    for _ in range(2):
        with Tracking(FAILING, tmp_path) as tracking:
            tracking.begin(runs[:1], [])
            tracking.show(paths, 5)
    other.write_bytes(b"2")
    with Tracking(FAILING, tmp_path) as tracking:
        tracking.show(paths, 7)
    asked = [word for word in failing.asked if word.startswith(("files", "begin"))]
    assert asked == [
        "begin after 0",
        "begin after 0",
        "files one other",
        "begin after 5",
        "files other",
    ]


def test_scalars_are_all_numbers_of_a_row_but_its_settings() -> None:
    row = {
        "run": "a",
        "c_g": 0.1,
        "epoch": 3,
        "env_steps": 400,
        "success_rate": None,
        "failure": None,
        "subgoal_success": [0.5, None, 1],
        "swept": ["c_g"],
        "far": True,
    }
    assert scalars(row, {"c_g", "epoch"}) == {
        "env_steps": 400.0,
        "subgoal_success/0": 0.5,
        "subgoal_success/2": 1.0,
        "far": 1.0,
    }


def test_trackers_are_found_by_their_files_names() -> None:
    assert sorted(builtin(TRACK)) == ["tensorboard", "trackio", "wandb"]
    assert builtin(TRACK)["tensorboard"].__name__ == "TensorBoard"
    assert find_tracker(TEXT_FILE).__name__ == "TextFile"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "mlflow",
            "track: unknown track 'mlflow'; choose from tensorboard, trackio, wandb, or FILE.py",
        ),
        ("wandb", r"track: wandb needs .* not installed: pip install '\.\[tracking\]'$"),
        (POINT_MASS, "is not derived from Tracker$"),
    ],
)
def test_what_cannot_track_is_refused_before_anything_is_made(
    name: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(WeightsAndBiases, "PACKAGE", "no_such_package")
    out = tmp_path / "out"
    with pytest.raises(SettingError, match=message):
        sweep.main(["--preset", "smoke", "--out", str(out), "--track", name])
    assert not out.exists()


def test_a_tracker_that_misspells_a_function_is_refused(tmp_path: Path) -> None:
    source = Path(TEXT_FILE.rpartition(":")[0]).read_text()
    (tmp_path / "mine.py").write_text(source.replace("def metrics(", "def metric("))
    with pytest.raises(SettingError, match=r"has metric, which .* does not know; write metrics, "):
        find_tracker(f"{tmp_path / 'mine.py'}:TextFile")


@pytest.mark.parametrize(
    "record",
    [
        *("", "[]", "{}", "[" * 10**5),
        '{"sweep": "a", "sent": {"b": "1"}, "closed": [], "files": {}}',
        '{"sweep": "a", "sent": {}, "closed": [1, "a"], "files": {}}',
        '{"sweep": "a", "sent": [[1, 2]], "closed": [], "files": {}}',
    ],
)
def test_a_damaged_record_is_refused(record: str, tmp_path: Path) -> None:
    path = tmp_path / f"{FOLDER}.json"
    path.parent.mkdir()
    path.write_text(record)
    with pytest.raises(SettingError, match=r"^track: .*my_tracker-TextFile\.json is damaged"):
        Tracking(TEXT_FILE, tmp_path)


def test_the_printed_command_continues_to_track() -> None:
    assert session._how_to_resume(ROOT, TEXT_FILE).endswith(f"--resume {ROOT} --track {TEXT_FILE}")
    assert session._how_to_resume(ROOT, None).endswith(f"--resume {ROOT}")


@pytest.mark.slow
def test_a_sweep_that_is_killed_and_resumed_is_tracked_whole(tmp_path: Path) -> None:
    out = tmp_path / "out"
    grid = ["--env", POINT_MASS, "--epochs", "5", "--checkpoint-seconds", "0"]
    tracked = command(*grid, "--out", str(out), "--track", TEXT_FILE)
    assert stop(tracked, after="epoch 2:", number=signal.SIGKILL)[0] == -signal.SIGKILL
    assert stop(tracked, after="epoch 4:")[0] == 75
    finish(tracked)
    recorded = rows(out)
    for run in {row["run"] for row in recorded}:
        sent = [line for line in lines(out, run) if line.startswith("epoch ")]
        own = [row for row in recorded if row["run"] == run]
        assert [int(line.split()[1]) for line in sent] == [row["epoch"] for row in own]
        for line, row in zip(sent, own, strict=True):
            values = json.loads(line.split(maxsplit=2)[2])
            assert values["success_rate"] == row["success_rate"]
            assert values["env_steps"] == row["env_steps"]
    figures = [line for line in lines(out, "sweep") if line.startswith("file ")]
    assert "file figures/learning_curves" in figures
