from __future__ import annotations

import json

import numpy as np
import pytest

from workbench.cloud.schema import Attribute, Schema

RNG = np.random.default_rng(4)
MIXED = Schema(
    (
        Attribute("mark", "uint8"),
        Attribute("normal", "float32", 3),
        Attribute("flow", "int16", 2),
        Attribute("sum", "float64"),
        Attribute("color", "uint8", 3),
        Attribute("half", "float16"),
    )
)


def test_rows_give_back_every_bit_in_any_order():
    n = 200
    block = {
        a.name: np.frombuffer(RNG.bytes(n * a.bytes_per_sample), a.dtype).reshape(a.shape(n))
        for a in MIXED.all
    }
    rows = MIXED.rows(block, "here")
    assert rows.shape == (n, MIXED.row_bytes // 8)
    assert MIXED.row_bytes - MIXED.bytes_per_sample < 8
    assert rows[:, :3].tobytes() == block["points"].tobytes()
    order = RNG.permutation(n)[:150].astype(np.int32)
    for name, array in MIXED.arrays(rows, order).items():
        assert array.dtype == block[name].dtype
        assert array.tobytes() == block[name][order].tobytes()


def test_a_schema_comes_back_from_its_record():
    assert Schema.from_json(json.loads(json.dumps(MIXED.as_json()))) == MIXED
    assert MIXED.names[0] == "points"


@pytest.mark.parametrize(("fill", "dtype"), [(0.5, "float32"), (7, "uint8")])
def test_samples_never_written_have_the_fill(fill: float, dtype: str):
    filled = Attribute("a", dtype, 2, fill).filled(3)
    assert filled.dtype == dtype
    assert filled.shape == (3, 2)
    assert (filled == fill).all()
