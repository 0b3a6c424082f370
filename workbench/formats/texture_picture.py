"""Pages of a texture as JPEG or PNG."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError

PictureKind = Literal["jpeg", "png"]

SUFFIX: dict[PictureKind, str] = {"jpeg": ".jpg", "png": ".png"}


def mime_type(kind: PictureKind) -> str:
    """As glTF calls it."""
    return f"image/{kind}"


def encoded_picture(picture: NDArray[np.uint8], kind: PictureKind, quality: int = 95) -> bytes:
    """The file of a picture (h, w, 3) uint8 sRGB; JPEG keeps the colour of every pixel.

    Raises
    ------
    InputError
        The picture cannot be encoded.
    """
    if kind == "jpeg":
        # Half as many colours as pixels would bleed at the borders of patches.
        how = [
            cv2.IMWRITE_JPEG_QUALITY, quality,
            cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
        ]  # fmt: skip
    else:
        # Higher levels take several times as long for a few per cent.
        how = [cv2.IMWRITE_PNG_COMPRESSION, 3]
    done, content = cv2.imencode(SUFFIX[kind], np.ascontiguousarray(picture[..., ::-1]), how)
    if not done:
        raise InputError(
            "A page of the texture cannot be encoded.",
            found=f"{picture.shape[1]} × {picture.shape[0]} pixels",
            fix="Allow smaller pages only, or choose the other kind of picture.",
        )
    return content.tobytes()
