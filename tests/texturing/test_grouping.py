"""Grouped as NumPy's stable sort has it."""

import numpy as np

from workbench.kernels.grouping import grouped
from workbench.texturing.labelling import by_photo


def test_as_a_stable_sort():
    numbers = np.random.default_rng(0).integers(0, 9, 500).astype(np.int32)
    numbers[numbers == 4] = 5
    starts, places = grouped(numbers, 12)
    assert (places == np.argsort(numbers, kind="stable")).all()
    assert (np.diff(starts) == np.bincount(numbers, minlength=12)).all()
    found = by_photo(numbers)
    assert list(found) == [0, 1, 2, 3, 5, 6, 7, 8]
    assert (found[7] == np.flatnonzero(numbers == 7)).all()


def test_nothing():
    assert by_photo(np.zeros(0, np.int32)) == {}
    starts, places = grouped(np.zeros(0, np.int32), 3)
    assert starts.tolist() == [0, 0, 0, 0]
    assert len(places) == 0
