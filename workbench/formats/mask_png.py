"""Masks as PNG files: 255 = keep, 0 = clutter."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from workbench.formats.picture_file import opened_picture


def read_mask_png(path: Path) -> NDArray[np.uint8]:
    """A mask, (h, w) uint8 of 0 and 255.

    Any picture will do: colour and transparency are looked through, and what is brighter
    than half is kept, so a mask that was scaled or blurred is still one.

    Raises
    ------
    OSError, ValueError, SyntaxError
        When the file is no picture, or declares more pixels than it can hold.
    """
    with opened_picture(path) as opened:
        grey = np.asarray(opened.convert("RGB").convert("L"), np.uint8)
    return np.where(grey > 127, 255, 0).astype(np.uint8)


def write_mask_png(path: Path, mask: NDArray[np.uint8]) -> None:
    """Write a mask (h, w) uint8; the same mask gives the same bytes."""
    clean = np.where(mask > 127, 255, 0).astype(np.uint8)
    # One bit a pixel: a mask of 24 million pixels takes some ten kilobytes.
    Image.fromarray(clean).convert("1", dither=Image.Dither.NONE).save(path, format="PNG")
