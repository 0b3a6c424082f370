from __future__ import annotations

import numpy as np
import pytest

from workbench.kernels.packed_rows import picked_columns, put_columns

RNG = np.random.default_rng(2)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32, np.uint64])
def test_columns_go_where_plain_slicing_puts_them(dtype: type):
    rows, expected = np.zeros((50, 16), dtype), np.zeros((50, 16), dtype)
    values = RNG.integers(0, np.iinfo(dtype).max, (50, 5), dtype=dtype)
    put_columns(rows, 9, values)
    expected[:, 9:14] = values
    assert np.array_equal(rows, expected)
    order = RNG.permutation(50)[:30].astype(np.int32)
    assert np.array_equal(picked_columns(rows, order, 9, 5), values[order])
