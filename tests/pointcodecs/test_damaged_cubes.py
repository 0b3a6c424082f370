"""Cubes of the codecs that end where their last point does, cut short or changed."""

from __future__ import annotations

import numpy as np
import pytest

from tests.pointcodecs.cubes import random_cubes
from workbench.errors import InputError
from workbench.pointcodecs.codecs import CODECS


@pytest.mark.parametrize(("codec", "seed", "flips"), [("ci", 5, 20), ("eci", 7, 40)])
def test_bytes_cut_short_or_changed_are_refused_or_other_points(codec, seed, flips):
    coder = CODECS[codec]
    points, starts = random_cubes(24, 3, 100, seed=seed)
    coded = coder.encoded(points, starts, 3)
    rng = np.random.default_rng(seed + 1)

    for begin, end, low, high in zip(
        starts[:-1], starts[1:], coded.bytes_at[:-1], coded.bytes_at[1:], strict=True
    ):
        whole = coded.data[low:high]
        count = np.array([0, end - begin])
        for length in range(len(whole)):
            with pytest.raises(InputError, match="damaged"):
                coder.decoded(whole[:length], np.array([0, length]), count, 3)
        for _ in range(flips):
            broken = whole.copy()
            broken[rng.integers(len(whole))] ^= 1 << rng.integers(8)
            try:
                back = coder.decoded(broken, np.array([0, len(broken)]), count, 3)
            except InputError:
                continue
            assert (back >= 0).all()
            assert (back < 8).all()
            assert len(np.unique(back, axis=0)) == end - begin
