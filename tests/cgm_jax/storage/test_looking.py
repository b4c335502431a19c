"""Looking at what a user names, where not even that is possible: one line, and nothing is made."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from cgm_jax import evaluate, export, launch, merge, report, sweep
from cgm_jax.config.fields import SettingError
from cgm_jax.host.warm_start import read_source
from cgm_jax.storage.looking import check_place, is_directory, is_ordinary_file, is_there
from tests.cgm_jax.refusing import refusing

LONG = "x" * 300


def test_what_is_there_is_told_apart(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "dangling").symlink_to("none")
    names = ("", "file", "pipe", "link", "dangling", "none", "file/below")
    found = {
        name: tuple(
            look("out", tmp_path / name) for look in (is_there, is_directory, is_ordinary_file)
        )
        for name in names
    }
    assert found == {
        "": (True, True, False),
        "file": (True, False, True),
        "pipe": (True, False, False),
        "link": (True, False, True),
        "dangling": (False, False, False),
        "none": (False, False, False),
        "file/below": (False, False, False),
    }


@pytest.mark.parametrize("look", [is_there, is_directory, is_ordinary_file])
def test_what_cannot_be_looked_at_is_refused(
    look: Callable[[str, Path], bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(SettingError, match=f"^out: cannot look at {LONG}: File name too long$"):
        look("out", Path(LONG))

    def denied(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "stat", denied)  # as of a private folder; root may look anywhere
    with pytest.raises(SettingError, match=r"^out: cannot look at run: Permission denied$"):
        look("out", Path("run"))


@pytest.mark.parametrize(
    ("main", "words", "setting"),
    [
        (evaluate.main, [LONG], "source"),
        (evaluate.main, [f"{LONG}.npz", "--env", "reach"], "source"),
        (evaluate.main, ["--random", "--env", "reach", "--video", f"{LONG}/a.mp4"], "video"),
        (export.main, [LONG, "--onnx"], "source"),
        (report.main, [LONG], "directories"),
        (report.main, [".", "--out", LONG], "out"),
        (report.main, [".", "--out", f"{LONG}/a"], "out"),
        (merge.main, [LONG, "--out", "y"], "directories"),
        (merge.main, [".", "--out", LONG], "out"),
        (launch.main, ["--jobs", "2", "--out", LONG, "--", "--preset", "smoke"], "out"),
        (launch.main, ["--resume", LONG], "resume"),
        (lambda words: read_source(Path(words[0])), [LONG], "from"),
        (sweep.main, ["--preset", "smoke", "--out", LONG], "out"),
    ],
)
def test_a_name_that_is_too_long_is_refused_in_one_line(
    main: Callable[[list[str]], int],
    words: list[str],
    setting: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    line = rf"^{setting}: cannot (look at|read|write to) .*{LONG}.*: File name too long$"
    with pytest.raises(SettingError, match=line):
        main(words)
    assert not list(tmp_path.iterdir())


def test_only_what_is_there_and_is_no_directory_is_in_the_way_of_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "file"
    file.touch()
    for place in (file, file / "below" / "it"):
        with pytest.raises(SettingError, match=f"^out: {file} is no directory$"):
            check_place("out", place)
    check_place("out", tmp_path)
    check_place("out", tmp_path / "new" / "one")
    monkeypatch.setattr(Path, "stat", refusing(errno.ESTALE))  # a disk that is away
    check_place("out", file)
