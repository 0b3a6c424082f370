"""Small pictures of photographs, for people to find their way by; never for measuring."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.formats.photo_reading import (
    PLAIN_SUFFIXES,
    QUARTER_TURNS,
    in_three_channels,
    opened_raw,
    readable,
)
from workbench.formats.picture_file import opened_picture

if TYPE_CHECKING:
    from PIL.Image import Image


def read_preview(path: Path, long_side_px: int) -> NDArray[np.uint8]:
    """A photograph as the camera shows it, small and upright.

    Of RAW files the picture the camera put in is taken where it is large enough, else a quick
    development with the camera's white balance and one brightness for all.

    Parameters
    ----------
    path : RAW, JPEG, PNG or TIFF.
    long_side_px : of the result; smaller photographs stay as they are.

    Returns
    -------
    (h, w, 3) uint8 sRGB.

    Raises
    ------
    InputError
        When the file cannot be read, with its name.
    """
    from PIL import ImageOps

    with readable(path):
        if path.suffix.lower() in PLAIN_SUFFIXES:
            with opened_picture(path) as opened:
                opened.draft("RGB", (2 * long_side_px, 2 * long_side_px))
                picture = ImageOps.exif_transpose(opened)
                return _reduced(picture.convert("RGB"), long_side_px)
        return _reduced(_raw_preview(path, long_side_px), long_side_px)


def _raw_preview(path: Path, long_side_px: int) -> Image:
    from PIL import Image

    with opened_raw(path) as raw:
        inside = _picture_inside(raw)
        if inside is not None and max(inside.size) >= long_side_px:
            turns = QUARTER_TURNS.get(raw.sizes.flip, 0)
            return Image.fromarray(np.rot90(np.asarray(inside.convert("RGB")), turns))
        half = raw.postprocess(half_size=True, use_camera_wb=True, no_auto_bright=True)
        return Image.fromarray(in_three_channels(half))


def _picture_inside(raw: Any) -> Image | None:
    """The picture the camera put into its file, lying as the sensor lies; None without."""
    import rawpy
    from PIL import Image

    try:
        thumb = raw.extract_thumb()
    except (rawpy.LibRawNoThumbnailError, rawpy.LibRawUnsupportedThumbnailError):
        return None
    if thumb.format == rawpy.ThumbFormat.JPEG:
        return Image.open(io.BytesIO(thumb.data))
    return Image.fromarray(in_three_channels(thumb.data))


def _reduced(picture: Image, long_side_px: int) -> NDArray[np.uint8]:
    share = min(1.0, long_side_px / max(picture.size))
    width, height = (max(1, math.floor(side * share + 0.5)) for side in picture.size)
    return np.asarray(picture.resize((width, height)), np.uint8)
