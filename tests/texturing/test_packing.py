"""Rectangles on pages: none overlaps, none is lost, pages are small."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.texturing.packing import packed


def sizes(count, seed=0, most=400) -> np.ndarray:
    rng = np.random.default_rng(seed)
    wide = 8 + rng.pareto(1.3, (count, 1)) * 8 * rng.uniform(0.5, 2.0, (count, 2))
    return np.minimum(wide, most).astype(np.int32)


def taken(packing, rectangles) -> list[np.ndarray]:
    pages = [np.zeros((height, width), np.int32) for width, height in packing.sizes]
    for (x, y), (w, h), page in zip(packing.places, rectangles, packing.pages, strict=True):
        assert x >= 0
        assert y >= 0
        assert y + h <= pages[page].shape[0]
        assert x + w <= pages[page].shape[1]
        pages[page][y : y + h, x : x + w] += 1
    return pages


@pytest.mark.parametrize("sides", ["tight", "power-of-two"])
@pytest.mark.parametrize(("count", "largest"), [(1, 512), (7, 1024), (600, 1024), (3000, 512)])
def test_every_rectangle_has_its_own_place(count, largest, sides):
    rectangles = sizes(count, seed=count)
    packing = packed(rectangles, largest, sides)
    pages = taken(packing, rectangles)
    assert max(page.max() for page in pages) == 1
    area = int((rectangles[:, 0].astype(int) * rectangles[:, 1]).sum())
    assert sum(int(page.sum()) for page in pages) == area
    assert all(max(size) <= largest for size in packing.sizes)
    if sides == "power-of-two":
        assert all(np.log2(side) % 1 == 0 for size in packing.sizes for side in size)


def test_pages_are_nearly_full_of_many_rectangles():
    rectangles = sizes(3000)
    full = [page.mean() for page in taken(packed(rectangles), rectangles)]
    assert len(full) == 1
    assert full[0] > 0.9


def test_same_again_and_nothing_of_nothing():
    rectangles = sizes(200)
    first, again = packed(rectangles), packed(rectangles)
    np.testing.assert_array_equal(first.places, again.places)
    assert packed(np.zeros((0, 2), np.int32)).sizes == ()


def test_what_fits_no_page_is_refused():
    with pytest.raises(InputError, match="larger than a page"):
        packed(np.array([[10, 10], [700, 3]], np.int32), 512)
