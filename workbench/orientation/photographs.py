"""A photograph whose camera is sought, with what is known of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.mask_png import read_mask_png
from workbench.formats.photo_reading import read_photo, readable


@dataclass(frozen=True)
class PhotoToOrient:
    """A photograph whose camera is sought.

    Attributes
    ----------
    name : unique; what the model will call it.
    picture : a file, or (h, w, 3) uint8 sRGB-encoded, upright.
    camera_key : photographs of one key and one size share their intrinsics: body, lens and
        focal length as one text.
    focal_px : prior focal length in pixels of the full picture; None where it is unknown.
    mask : a file, or (h, w) uint8 of the picture's size, 255 = keep; None keeps all.
    """

    name: str
    picture: Path | NDArray[np.uint8]
    camera_key: str = ""
    focal_px: float | None = None
    mask: Path | NDArray[np.uint8] | None = None

    def pixels(self) -> NDArray[np.uint8]:
        """The picture, (h, w, 3) uint8 sRGB-encoded.

        Raises
        ------
        InputError
            The file cannot be read, or the array is no picture.
        """
        if isinstance(self.picture, Path):
            return read_photo(self.picture)
        if self.picture.dtype != np.uint8 or self.picture.ndim != 3 or self.picture.shape[2] != 3:
            raise InputError(
                "This is no picture.",
                where=self.name,
                expected="(h, w, 3) uint8",
                found=f"{self.picture.shape} {self.picture.dtype}",
            )
        return self.picture

    def kept(self, height: int, width: int) -> NDArray[np.bool_] | None:
        """The mask (h, w) as truth values, True = keep; None where all is kept.

        Raises
        ------
        InputError
            The mask cannot be read or is not of the picture's size.
        """
        if self.mask is None:
            return None
        if isinstance(self.mask, Path):
            with readable(self.mask):
                mask = read_mask_png(self.mask)
        else:
            mask = self.mask
        if mask.shape != (height, width):
            raise InputError(
                "The mask is not of the photograph's size.",
                file=self.mask if isinstance(self.mask, Path) else None,
                where=self.name,
                expected=f"{width} × {height}",
                found=" × ".join(map(str, mask.shape[::-1])),
                fix="Make the mask on the upright photograph at its full size.",
            )
        return np.asarray(mask > 127)
