import contextlib
import errno
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any, BinaryIO

import pytest

from cgm_jax import report
from cgm_jax.config.fields import SettingError
from cgm_jax.host.exit_codes import ExitCode
from cgm_jax.machine.commands import shell_command
from cgm_jax.results.page import page as page_module
from cgm_jax.results.page.page import unpacked
from cgm_jax.storage import checkpoints
from cgm_jax.storage.checkpoints import write_manifest
from tests.cgm_jax.refusing import refusing
from tests.cgm_jax.results.page.made import directory, follow_on, grid, timed_run
from tests.cgm_jax.sweeps import ROOT


def epochs_in(page: Path) -> list[int]:
    return [run["columns"]["epoch"][-1] for run in unpacked(page.read_text())["runs"]]


def test_a_page_is_written_beside_the_metrics_or_where_one_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = grid(tmp_path / "run", seeds=1, epochs=3)
    assert report.main([str(path)]) == ExitCode.DONE
    out = tmp_path / "page.html"
    assert report.main([str(path), "--out", str(out)]) == ExitCode.DONE
    assert capsys.readouterr().out.split() == [str(path / "report.html"), str(out)]
    for page in (path / "report.html", out):
        assert epochs_in(page) == [3] * 7
        assert unpacked(page.read_text())["reload"] is None


def _torn(path: Path) -> None:
    (path / "config.json").write_text('{"groups": [')


def _newer(path: Path) -> None:
    (path / "config.json").write_text('{"format": 99, "groups": []}')


def _without_env(path: Path) -> None:
    row = timed_run([0.5])[0]
    del row["env"]
    (path / "metrics.jsonl").write_text(json.dumps(row) + "\n")


def _backwards(path: Path) -> None:
    rows = timed_run([0.5, 0.6])
    (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows[::-1]))


def _words(path: Path) -> None:
    (path / "metrics.jsonl").write_text(json.dumps(timed_run(["much"])[0]) + "\n")  # pyright: ignore


def _more_than_all(path: Path) -> None:
    (path / "metrics.jsonl").write_text(json.dumps(timed_run([1.5])[0]) + "\n")


def _beyond_floats(path: Path) -> None:
    row = timed_run([0.5])[0] | {"env_steps": 10**400}
    (path / "metrics.jsonl").write_text(json.dumps(row) + "\n")


def _too_many_in_all(path: Path) -> None:
    rows = [timed_run([0.5], seed, run=f"seed{seed}")[0] | {"env_steps": 1e308} for seed in (0, 1)]
    (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))


def _nested(path: Path) -> None:
    config = json.loads((path / "config.json").read_text()) | {"x": 0}
    nested = json.dumps(config).replace('"x": 0', f'"x": {"[" * 600}{"]" * 600}')
    (path / "config.json").write_text(nested)


def _no_json(path: Path) -> None:
    (path / "metrics.jsonl").write_text("epoch 1\n")


def _empty(path: Path) -> None:
    (path / "metrics.jsonl").write_text("")


def _not_there(path: Path) -> None:
    (path / "config.json").unlink()


def _link(path: Path) -> None:
    (path / "figures").symlink_to("/etc")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_not_there, "holds no sweep"),
        (_torn, "config.json is damaged"),
        (_newer, "format: 99"),
        (_without_env, "metrics.jsonl is damaged: KeyError: 'env'"),
        (_backwards, "not in order"),
        (_words, "success_rate: 'much'"),
        (_more_than_all, "success_rate: 1.5"),
        (_beyond_floats, "env_steps: 1000"),
        (_too_many_in_all, "metrics.jsonl is damaged: ValueError: env_steps: too many in all"),
        (_nested, "config.json is damaged: RecursionError"),
        (_no_json, "metrics.jsonl is damaged"),
        (_empty, "no finished epoch yet; try --follow"),
        (_link, "symbolic link"),
    ],
)
def test_bad_directories_are_refused_with_one_line(
    tmp_path: Path, spoil: Callable[[Path], None], message: str
) -> None:
    path = directory(tmp_path / "run", timed_run([0.0, 0.5]))
    spoil(path)
    with pytest.raises(SettingError) as refused:
        report.main([str(path)])
    assert message in str(refused.value)
    assert not (path / "report.html").exists()


def test_a_torn_config_comes_back_from_a_checkpoint(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = directory(tmp_path / "run", timed_run([0.0, 0.5]))
    config = (path / "config.json").read_bytes()
    checkpoint = checkpointed(path, 0, 1)
    (path / "config.json").write_bytes(config[:50])
    assert report.main([str(path)]) == 0
    assert f"restored from {checkpoint}" in capsys.readouterr().err
    assert (path / "config.json").read_bytes() == config
    (path / "config.json").write_text("{}")  # somebody may have edited it
    with pytest.raises(SettingError, match=r"damaged: .*; without this file it comes back from a"):
        report.main([str(path)])


def checkpointed(path: Path, group: int, epoch: int) -> Path:
    """A whole checkpoint in a made-up directory."""
    file = path / f"checkpoints/group{group}_epoch{epoch:06d}_cycle000000.npz"
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(b"whole")
    config = (path / "config.json").read_bytes()
    write_manifest(file, sha256(b"whole").hexdigest(), len(b"whole"), config)
    return file


def test_epochs_that_checkpoints_hold_but_metrics_lack_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [row for seed in (0, 1) for row in timed_run([0.0, 0.5, 0.6], seed, run=f"seed{seed}")]
    path, metrics = directory(tmp_path / "run", rows), tmp_path / "run/metrics.jsonl"
    for group in (0, 1):
        checkpointed(path, group, 2)
    latest = checkpointed(path, 1, 3)
    assert report.main([str(path)]) == 0
    assert capsys.readouterr().err == ""
    remark = f"{metrics} lacks epochs that a checkpoint has; to restore them: "
    command = shell_command("cgm_jax.sweep", "--resume", path)

    lines = metrics.read_text().splitlines(keepends=True)
    metrics.write_text("".join(lines[:-1]))
    assert report.main([str(path)]) == 0
    assert capsys.readouterr().err == f"{remark}{command}\n"
    latest.write_bytes(b"damaged")  # so that it would restore nothing
    assert report.main([str(path)]) == 0
    assert capsys.readouterr().err == ""

    metrics.unlink()
    with pytest.raises(SettingError) as refused:
        report.main([str(path)])
    assert str(refused.value) == remark + command


def test_a_config_that_cannot_be_read_just_now_is_refused_and_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = directory(tmp_path / "run", timed_run([0.0, 0.5]))

    stale = refusing(errno.ESTALE)

    monkeypatch.setattr(checkpoints, "read_json", stale)
    line = f"^cannot read {path / 'config.json'}: Stale file handle$"
    with pytest.raises(SettingError, match=line):
        report.main([str(path)])
    assert {file.name for file in path.iterdir()} == {"config.json", "metrics.jsonl"}


def test_two_at_once_both_write_a_whole_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = grid(tmp_path / "run", seeds=1, epochs=3)
    replacing, codes = page_module.replacing, []

    @contextlib.contextmanager
    def interrupted(out: Path) -> Iterator[BinaryIO]:
        with replacing(out) as file:
            if not codes:
                codes.append(None)
                codes.append(report.main([str(path)]))
            yield file

    monkeypatch.setattr(page_module, "replacing", interrupted)
    assert report.main([str(path)]) == ExitCode.DONE
    assert codes == [None, ExitCode.DONE]
    assert epochs_in(path / "report.html") == [3] * 7
    assert not list(path.glob("*.partial"))


def test_a_page_is_made_before_its_file_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = grid(tmp_path / "run", seeds=1, epochs=3)
    before = sorted(path.iterdir())

    def made(*_: Any) -> str:
        assert sorted(path.iterdir()) == before
        return "text"

    monkeypatch.setattr(page_module, "page_text", made)
    assert report.main([str(path)]) == ExitCode.DONE
    assert (path / "report.html").read_text() == "text"


def test_bad_options_are_refused(tmp_path: Path) -> None:
    path = directory(tmp_path / "run", timed_run([0.0, 0.5]))
    for arguments, message in (
        ([], "name at least one"),
        ([str(path), f"{path}/../run"], "named twice"),
        ([str(path), "--out", str(tmp_path)], "is a directory"),
        ([str(path), "--out", str(tmp_path / "none/page.html")], "is no directory"),
    ):
        with pytest.raises(SettingError, match=message):
            report.main(arguments)


def test_a_followed_sweep_is_written_again_until_it_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "LOOK_SECONDS", 0.02)
    path = directory(tmp_path / "run", timed_run([0.0, 0.5]), epochs=4)
    out, codes = tmp_path / "page.html", []
    arguments = [str(path), "--follow", "--out", str(out)]
    thread = threading.Thread(target=lambda: codes.append(report.main(arguments)))
    thread.start()
    _await(lambda: out.exists())
    assert epochs_in(out) == [2]
    assert unpacked(out.read_text())["reload"] == report.RELOAD_SECONDS
    follow_on(path, 1)
    _await(lambda: epochs_in(out) == [3])
    follow_on(path, 1)
    thread.join(timeout=30)
    assert codes == [ExitCode.DONE]
    assert epochs_in(out) == [4]
    assert unpacked(out.read_text())["reload"] is None


@pytest.mark.slow
def test_ctrl_c_ends_following(tmp_path: Path) -> None:
    path = directory(tmp_path / "run", timed_run([0.0, 0.5]), epochs=4)
    command = [sys.executable, "-m", "cgm_jax.report", str(path), "--follow"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stderr is not None
        assert process.stderr.readline() == "following; Ctrl-C ends it\n"
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
        assert process.wait(timeout=30) == ExitCode.STOPPED
    assert rest == "stopping\n"
    assert unpacked((path / "report.html").read_text())["reload"] is None


def _await(happened: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 30
    while not happened():
        assert time.monotonic() < deadline
        time.sleep(0.01)
