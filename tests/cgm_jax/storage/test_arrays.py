"""Arrays are written to npz files as numpy writes them, also row by row."""

import io

import numpy as np
import pytest

from cgm_jax.storage.arrays import write_arrays


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
