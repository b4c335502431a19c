"""Files of named arrays (npz), read as untrusted input."""

import contextlib
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np

Shape = tuple[int, ...]
SUFFIX = ".npy"


def write_arrays(
    file: BinaryIO, arrays: Iterable[tuple[str, np.ndarray | list[np.ndarray]]]
) -> None:
    """Write an npz file, uncompressed, one array after the other.

    Unlike `numpy.savez` it takes an iterator, so that the arrays need not exist all at once; and an
    array may be a list of its rows, at least one, so that it need not exist in one piece.
    """
    with zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays:
            with archive.open(name + SUFFIX, "w", force_zip64=True) as member:
                if isinstance(array, list):
                    _write_rows(member, array)
                else:
                    np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)


def _write_rows(file: IO[bytes], rows: Sequence[np.ndarray]) -> None:
    """What `numpy.stack` of rows would be in a file, without making it."""
    shape = (len(rows), *rows[0].shape)
    description = np.lib.format.dtype_to_descr(rows[0].dtype)
    header = {"descr": description, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, header)
    for row in rows:
        file.write(np.ascontiguousarray(row).reshape(-1).view(np.uint8).data)


def read_shapes(path: Path) -> dict[str, tuple[Shape, np.dtype[Any]]]:
    """Shapes and types of all arrays of an npz file, without reading the arrays.

    Raises:
        ValueError: the file cannot be read, holds pickled objects, or an array's size in the
            archive is not what its shape says.
    """
    with _naming(path), zipfile.ZipFile(path) as archive:
        return {_name(info): _read_header(archive, info) for info in archive.infolist()}


def read_arrays(path: Path, most_bytes: int) -> dict[str, np.ndarray]:
    """All arrays of an npz file. Never runs code from it, nor fills the memory with it.

    Args:
        path: the file.
        most_bytes: refuse more than this, unpacked.

    Raises:
        ValueError: as `read_shapes`, or the arrays are larger than `most_bytes`.
    """
    shapes = read_shapes(path)
    total = sum(_bytes(*entry) for entry in shapes.values())
    if total > most_bytes:
        raise ValueError(f"{path} holds {total:,} bytes of arrays, more than {most_bytes:,}")
    with _naming(path), open_arrays(path, packed=True) as arrays:
        return dict(arrays)


@contextlib.contextmanager
def open_arrays(path: Path, *, packed: bool = False) -> Iterator[Mapping[str, np.ndarray]]:
    """The arrays of an npz file by name, each read whenever it is asked for. Never runs its code.

    Args:
        path: the file.
        packed: whether arrays may be compressed. They may then be a thousand times as large as the
            file; `write_arrays` does not compress them.

    Raises:
        ValueError: as `read_shapes`, or an array is compressed; in the block also if an array's
            bytes are damaged.
        OSError: in the block, if the system cannot read them just now.
    """
    names = list(read_shapes(path))
    with contextlib.ExitStack() as stack:
        with _naming(path):
            archive = stack.enter_context(zipfile.ZipFile(path))
            stored = all(info.compress_type == zipfile.ZIP_STORED for info in archive.infolist())
            if not (stored or packed):
                raise ValueError("its arrays are compressed")
        yield _Arrays(path, archive, names)


class _Arrays(Mapping[str, np.ndarray]):
    """See `open_arrays`."""

    def __init__(self, path: Path, archive: zipfile.ZipFile, names: Sequence[str]) -> None:
        self._path, self._archive, self._names = path, archive, dict.fromkeys(names)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names  # without reading it

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self._names:
            raise KeyError(name)
        try:
            with self._archive.open(name + SUFFIX) as member:
                return np.lib.format.read_array(member, allow_pickle=False)
        except Exception as error:
            if isinstance(error, MemoryError) or getattr(error, "errno", None) is not None:
                raise  # the bytes are not to blame
            raise _no_arrays(self._path, error) from None


@contextlib.contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Have whatever is wrong with a file's bytes name the file: there are many kinds of that.

    Raises:
        ValueError: anything was.
    """
    try:
        yield
    except Exception as error:
        raise _no_arrays(path, error) from None


def _no_arrays(path: Path, error: Exception) -> ValueError:
    return ValueError(f"{path} is no file of arrays ({_line(error)})")


def _name(info: zipfile.ZipInfo) -> str:
    if not info.filename.endswith(SUFFIX):
        raise ValueError(f"{info.filename!r} is no array")
    return info.filename.removesuffix(SUFFIX)


def _read_header(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> tuple[Shape, np.dtype[Any]]:
    """An array's shape and type, checked against the size that the archive gives it."""
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        if version != (1, 0):  # later ones have headers of up to 4 GiB, which are read whole
            raise ValueError(f"array format {version} is not read")
        shape, _, dtype = np.lib.format.read_array_header_1_0(member)
        if dtype.hasobject:
            raise ValueError(f"{info.filename} holds pickled objects")
        if (
            any(side < 0 for side in shape)
            or member.tell() + _bytes(shape, dtype) != info.file_size
        ):
            raise ValueError(f"{info.filename} has not the size that its shape {shape} needs")
    return shape, dtype


def _bytes(shape: Shape, dtype: np.dtype[Any]) -> int:
    count = dtype.itemsize
    for side in shape:  # Python's integers do not overflow
        count *= side
    return count


def _line(error: Exception) -> str:
    return (str(error) or type(error).__name__).partition("\n")[0]
