from __future__ import annotations

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.geometry.neighbours import k_nearest, tree_of

PLACES = np.random.default_rng(0).uniform(size=(50, 3))


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_points_without_a_place_are_refused_not_answered(value) -> None:
    broken = PLACES.copy()
    broken[7, 1] = value
    with pytest.raises(InputError, match="point 7"):
        tree_of(broken)
    with pytest.raises(InputError):
        k_nearest(tree_of(PLACES), broken, 3)


def test_the_nearest_of_a_point_is_itself_and_then_what_a_plain_search_says() -> None:
    distance, index = k_nearest(tree_of(PLACES), PLACES, 2)
    plain = np.linalg.norm(PLACES[:, None] - PLACES, axis=2)
    assert (index[:, 0] == np.arange(50)).all()
    np.fill_diagonal(plain, np.inf)
    assert (index[:, 1] == plain.argmin(axis=1)).all()
    assert np.allclose(distance[:, 1], plain.min(axis=1))
