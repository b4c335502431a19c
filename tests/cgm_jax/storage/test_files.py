"""Files that several processes write, that killed ones have left, and that cannot be read."""

import errno
import os
import secrets
from pathlib import Path

import pytest

from cgm_jax.storage.files import (
    ABANDONED_SECONDS,
    PARTIAL,
    ReadError,
    reading,
    refusal,
    remove_abandoned,
    replacing,
)


def test_of_two_that_write_a_file_at_once_each_writes_it_whole(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    with replacing(path) as first:
        first.write(b"first, ")
        with replacing(path) as second:
            second.write(b"second")
        assert path.read_bytes() == b"second"
        first.write(b"whole")
    assert path.read_bytes() == b"first, whole"
    assert list(tmp_path.iterdir()) == [path]


def test_what_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"old")

    def write_to_a_full_disk() -> None:
        with replacing(path) as file:
            file.write(b"ne")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.raises(OSError, match="No space"):
        write_to_a_full_disk()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_lies_in_place_of_a_half_written_file_is_neither_followed_nor_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(secrets, "token_hex", lambda _: "0f")  # or else nobody could foresee it
    link = tmp_path / f"a.0f{PARTIAL}"
    (tmp_path / "target").write_text("kept")
    link.symlink_to(tmp_path / "target")
    with pytest.raises(FileExistsError), replacing(tmp_path / "a"):
        pass
    assert link.is_symlink()
    assert (tmp_path / "target").read_text() == "kept"


def test_only_what_nobody_writes_any_more_is_removed(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    old, new = (tmp_path / f"page.html.{name}{PARTIAL}" for name in ("old", "new"))
    another = tmp_path / f"other.html.old{PARTIAL}"
    for file in (path, old, new, another):
        file.touch()
        age = 0.0 if file == new else ABANDONED_SECONDS + 1
        os.utime(file, (file.stat().st_atime, file.stat().st_mtime - age))
    remove_abandoned(path)
    assert {*tmp_path.iterdir()} == {path, new, another}


def test_what_the_system_refuses_tells_what_was_read_or_where_was_written(tmp_path: Path) -> None:
    path = tmp_path / "a"
    with pytest.raises(ReadError) as caught, reading(path):
        raise OSError(errno.EIO, os.strerror(errno.EIO))
    assert caught.value.errno == errno.EIO
    assert refusal(caught.value, tmp_path) == f"cannot read {path}: Input/output error"
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert refusal(full, tmp_path) == f"cannot write to {tmp_path}: No space left on device"


def test_a_file_that_is_not_there_was_not_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for name, kind in (("none", FileNotFoundError), ("file/none", NotADirectoryError)):
        with pytest.raises(kind), reading(tmp_path / name):
            (tmp_path / name).read_bytes()
