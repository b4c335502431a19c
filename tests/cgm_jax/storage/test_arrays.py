"""Arrays are written to npz files as numpy writes them, also row by row."""

import errno
import io
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cgm_jax.storage.arrays import open_arrays, read_arrays, write_arrays
from tests.cgm_jax.archives import spoil


@pytest.mark.parametrize(
    "array", [np.arange(24.0).reshape(3, 4, 2), np.array([1, 2], np.int32), np.ones((2, 0)) > 0]
)
def test_an_array_by_its_rows_is_written_as_numpy_writes_the_whole(array: np.ndarray) -> None:
    whole, by_rows = io.BytesIO(), io.BytesIO()
    write_arrays(whole, [("x", array)])
    write_arrays(by_rows, [("x", list(array))])
    by_rows.seek(0)
    read = np.load(by_rows)["x"]
    np.testing.assert_array_equal(read, array)
    assert read.dtype == array.dtype
    assert by_rows.getbuffer().nbytes == whole.getbuffer().nbytes


def test_arrays_are_read_by_their_names(tmp_path: Path) -> None:
    whole = {"a": np.arange(6000.0).reshape(2, -1), "b.c": np.array(True)}
    path = tmp_path / "a.npz"
    np.savez(path, **whole)
    with open_arrays(path) as arrays:
        assert list(arrays) == ["a", "b.c"]
        for name, array in whole.items():
            np.testing.assert_array_equal(arrays[name], array)
            assert arrays[name].dtype == array.dtype
        with pytest.raises(KeyError, match="b"):
            arrays["b"]


def test_small_files_do_not_become_large_arrays(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, a=np.zeros(10**6))
    with pytest.raises(ValueError, match="compressed"), open_arrays(path):
        pass
    assert read_arrays(path, most_bytes=8 * 10**6)["a"].shape == (10**6,)
    with pytest.raises(ValueError, match="more than 7,999,999"):
        read_arrays(path, most_bytes=8 * 10**6 - 1)


def test_headers_of_any_length_are_not_read(tmp_path: Path) -> None:
    path, length = tmp_path / "a.npz", 2**26
    header = np.lib.format.magic(2, 0) + length.to_bytes(4, "little")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", header + b" " * length)
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"array format \(2, 0\) is not read"):
        read_arrays(path, most_bytes=2**30)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 2**22


def test_to_ask_for_a_name_reads_no_array(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, read = tmp_path / "a.npz", []
    np.savez(path, a=np.arange(3))
    with open_arrays(path) as arrays, monkeypatch.context() as patch:
        patch.setattr(zipfile.ZipFile, "open", lambda *_: read.append(1))
        assert "a" in arrays
        assert "b" not in arrays
    assert not read


def test_what_the_system_cannot_read_just_now_is_not_called_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, a=np.arange(3))

    def fail(*_: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    with open_arrays(path) as arrays, monkeypatch.context() as patch:
        patch.setattr(zipfile.ZipFile, "open", fail)
        with pytest.raises(OSError, match="Input/output error"):
            arrays["a"]


@pytest.mark.parametrize(
    "kind", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA]
)
def test_damaged_bytes_are_told_by_the_name_of_their_file(kind: int, tmp_path: Path) -> None:
    path, member = tmp_path / "a.npz", io.BytesIO()
    np.save(member, np.random.default_rng(0).integers(0, 9, 9000))
    with zipfile.ZipFile(path, "w", kind) as archive:
        archive.writestr("a.npy", member.getvalue())
    spoil(path)
    with pytest.raises(ValueError, match=rf"^{path} is no file of arrays \(.+\)$"):
        read_arrays(path, 10**6)
