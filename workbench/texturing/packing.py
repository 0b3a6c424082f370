"""Rectangles packed on as few and as small pages as it goes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.kernels.skyline import packed_on_page

Sides = Literal["tight", "power-of-two"]
_STEP = 64
_GROWTH = 1.03


@dataclass(frozen=True)
class Packing:
    """Where rectangles are.

    Attributes
    ----------
    pages : (p,) int32.
    places : (p, 2) int32 column and row of the upper left corner.
    sizes : width and height of each page.
    """

    pages: NDArray[np.int32]
    places: NDArray[np.int32]
    sizes: tuple[tuple[int, int], ...]


def packed(sizes: NDArray[np.int32], largest: int = 8192, sides: Sides = "tight") -> Packing:
    """Pack rectangles (p, 2) of width and height, none turned.

    Parameters
    ----------
    largest : longest side of a page.
    sides : pages as small as they can be, or with powers of two as old graphics cards need.

    Raises
    ------
    InputError : a rectangle is larger than a page.
    """
    if len(sizes) and int(sizes.max()) > largest:
        raise InputError(
            "a patch of the texture is larger than a page",
            expected=f"{largest} pixels", found=f"{int(sizes.max())} pixels",
            fix="allow larger pages",
        )  # fmt: skip
    # Tall ones first: what comes later fills what they leave.
    order = np.lexsort((np.arange(len(sizes)), -sizes[:, 0], -sizes[:, 1]))
    pages = np.zeros(len(sizes), np.int32)
    places = np.zeros((len(sizes), 2), np.int32)
    page_sizes: list[tuple[int, int]] = []
    while len(order):
        width, height, at = _one_page(sizes[order], largest, sides)
        there = at[:, 0] >= 0
        pages[order[there]], places[order[there]] = len(page_sizes), at[there]
        page_sizes.append((width, height))
        order = order[~there]
    return Packing(pages, places, tuple(page_sizes))


def _one_page(
    sizes: NDArray[np.int32], largest: int, sides: Sides
) -> tuple[int, int, NDArray[np.int32]]:
    """Width, height and places of the smallest page tried that has room for all, or the largest."""
    area = float((sizes[:, 0].astype(np.int64) * sizes[:, 1]).sum())
    for width, height in _tried(area, int(sizes[:, 0].max()), largest, sides):
        last = (width, height) == (largest, largest)
        if not last and (width * height < area or height < sizes[:, 1].max()):
            continue
        at = packed_on_page(sizes, width, height)
        if last or (at[:, 0] >= 0).all():
            if sides == "tight":
                there = at[:, 0] >= 0
                used = int((at[there, 1] + sizes[there, 1]).max())
                height = min(height, -(-used // 4) * 4)
            return width, height, at
    raise AssertionError("the largest page is the last that is tried")


def _tried(area: float, widest: int, largest: int, sides: Sides) -> list[tuple[int, int]]:
    """Widths and heights, smaller ones first, and at last the largest."""
    tried: list[tuple[int, int]] = []
    if sides == "power-of-two":
        side = 1
        while side <= largest // 2:
            tried += [(side, side), (2 * side, side)]
            side *= 2
        return [size for size in tried if size[0] >= widest] + [(largest, largest)]
    side_px = max(area**0.5, widest)
    while side_px < largest:
        width = min(-(-int(side_px) // _STEP) * _STEP, largest)
        # A page may become longer than wide: only what is used of it is kept.
        if (width, width) not in tried:
            tried.append((width, width))
        side_px *= _GROWTH
    return [*tried, (largest, largest)]
