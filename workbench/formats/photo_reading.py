"""Photographs as pictures of their full size, upright: what masks are drawn on and found in.

No colorimetry: the camera's white balance, sRGB, one brightness for all.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.picture_file import opened_picture, require_pixels_fit
from workbench.formats.whole_file import require_regular

PLAIN_SUFFIXES = frozenset((".jpg", ".jpeg", ".png", ".tif", ".tiff"))
# LibRaw's word for how the camera was held → counter-clockwise turns by 90°.
QUARTER_TURNS = {3: 2, 5: 1, 6: 3}
_EXIF_ORIENTATION = 0x0112
_LIES_ON_ITS_SIDE = (5, 6, 7, 8)


def read_photo(path: Path) -> NDArray[np.uint8]:
    """A photograph at its full size, as it is shown.

    Parameters
    ----------
    path : RAW, JPEG, PNG or TIFF.

    Returns
    -------
    (h, w, 3) uint8 sRGB; ``photo_size`` is (w, h).

    Raises
    ------
    InputError
        When the file cannot be read, with its name.
    """
    with readable(path):
        if path.suffix.lower() in PLAIN_SUFFIXES:
            from PIL import ImageOps

            with opened_picture(path) as opened:
                return np.asarray(ImageOps.exif_transpose(opened).convert("RGB"), np.uint8)
        with opened_raw(path) as raw:
            import rawpy

            # Linear interpolation of the mosaic: a mask needs no better, and it is quick.
            developed = raw.postprocess(
                demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
                use_camera_wb=True,
                no_auto_bright=True,
            )
            return in_three_channels(developed)


def in_three_channels(pixels: NDArray[Any]) -> NDArray[Any]:
    """(h, w, 3) of what LibRaw made: of cameras without colour that is (h, w, 1) or (h, w)."""
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    return np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels


def photo_size(path: Path) -> tuple[int, int]:
    """Width and height of a photograph as it is shown, without reading its pixels.

    Raises
    ------
    InputError
        When the file cannot be read, with its name.
    """
    with readable(path):
        if path.suffix.lower() in PLAIN_SUFFIXES:
            with opened_picture(path) as opened:
                width, height = opened.size
                on_its_side = opened.getexif().get(_EXIF_ORIENTATION, 1) in _LIES_ON_ITS_SIDE
        else:
            with opened_raw(path) as raw:
                width, height = raw.sizes.width, raw.sizes.height
                on_its_side = QUARTER_TURNS.get(raw.sizes.flip, 0) % 2 == 1
    return (height, width) if on_its_side else (width, height)


@contextmanager
def opened_raw(path: Path) -> Iterator[Any]:
    """A RAW file as LibRaw opens it, none of its photosites read yet.

    Raises
    ------
    OSError, rawpy.LibRawError
        The file is none, or declares more photosites than it can hold.
    """
    import rawpy

    require_regular(path)
    with rawpy.imread(str(path)) as raw:
        sizes = raw.sizes
        require_pixels_fit(sizes.raw_width * sizes.raw_height, 16, path.stat().st_size)
        yield raw


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Whatever the readers of photographs raise in the block becomes one error for people."""
    import rawpy

    try:
        yield
    except (OSError, ValueError, SyntaxError, rawpy.LibRawError) as error:
        raise InputError(
            "The photograph cannot be read",
            file=path,
            found=str(error) or type(error).__name__,
            fix="copy it from the card again, or leave it out",
        ) from error
