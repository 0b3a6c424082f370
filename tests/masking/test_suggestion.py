from __future__ import annotations

import numpy as np
import pytest

from tests.masking.scenes import photograph, range_map
from workbench.errors import InputError
from workbench.masking.suggestion import suggested


def test_one_of_each_appearance_is_named_first() -> None:
    red = [photograph(seed)[0] for seed in range(3)]
    swapped = [image[..., ::-1].copy() for image in red[:2]]
    dark = [(red[0] // 4).astype(np.uint8)]
    kinds = [0, 0, 0, 1, 1, 2]
    named = suggested([*red, *swapped, *dark], 3)
    assert kinds[named[0]] == 0
    assert {kinds[n] for n in named} == {0, 1, 2}


def test_no_image_is_named_twice_and_never_more_than_there_are() -> None:
    maps = [range_map(1)[0]] * 3
    assert sorted(suggested(maps, 9)) == [0, 1, 2]
    with pytest.raises(InputError, match="at least one"):
        suggested([], 1)
