"""Pictures stay within the budget, the one asked for longest ago goes first."""

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.texturing.picture_cache import PictureCache


def picture_of(label):
    return np.full((10, 10, 4), label, np.uint8)


def test_the_one_asked_for_longest_ago_goes():
    loaded = []
    cache = PictureCache(lambda label: loaded.append(label) or picture_of(label), 2 * 400 + 100)
    for label in (1, 2, 1, 3, 1, 2):
        assert (cache.get(label) == label).all()
    # 3 pushes 2 out, for 1 was asked for again; then 2 pushes 3 out.
    assert loaded == [1, 2, 3, 2]
    assert (cache.loads, cache.hits) == (4, 2)
    assert cache.peak_bytes == 800


def test_a_picture_larger_than_the_budget_is_given_all_the_same():
    cache = PictureCache(picture_of, 100)
    assert cache.get(5).shape == (10, 10, 4)
    assert cache.get(6)[0, 0, 0] == 6
    assert cache.peak_bytes == 400
    assert cache.load_seconds >= 0.0


def test_pictures_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        PictureCache(picture_of, 1000).get(1)[0, 0] = 0


def test_what_is_no_picture_is_refused():
    with pytest.raises(InputError, match="photograph 3"):
        PictureCache(lambda label: np.zeros((4, 4, 3), np.uint8), 1000).get(3)
    with pytest.raises(InputError, match="no room"):
        PictureCache(picture_of, 0)
