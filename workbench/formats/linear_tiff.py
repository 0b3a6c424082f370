"""Linear pictures as 16-bit TIFF files, each of which says what its largest value means."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.picture_file import require_pixels_fit

_FULL = 65535
_STRIP_ROWS = 64
_CLEARLY = 0.005


@dataclass(frozen=True)
class LinearPicture:
    """A picture whose values are proportional to light.

    Attributes
    ----------
    values : (h, w, 3) float32 linear RGB in the working space; 1 is a perfect white diffuser
        where the colour chart stood, or the sensor's white where there was no chart.
    space : name of the working space, ``rec709`` or ``prophoto``.
    scale : the value that 65535 in the file stands for.
    profile : ICC profile of the working space, so that viewers show the picture right.
    """

    values: NDArray[np.float32]
    space: str
    scale: float
    profile: bytes

    @property
    def share_beyond(self) -> float:
        """Share of the values clearly beyond [0, ``scale``], more than by the noise of black."""
        clear = _CLEARLY * self.scale
        return float(np.mean((self.values < -clear) | (self.values > self.scale + clear)))


def write_linear_tiff(path: Path, picture: LinearPicture) -> None:
    """Write a linear picture; what is beyond its range is clipped.

    The same picture gives the same bytes.
    """
    import tifffile

    scaled = picture.values * np.float32(_FULL / picture.scale)
    digital = np.rint(np.clip(scaled, 0, _FULL, out=scaled)).astype(np.uint16)
    tifffile.imwrite(
        path,
        digital,
        photometric="rgb",
        compression="zlib",
        compressionargs={"level": 1},
        predictor=True,
        rowsperstrip=_STRIP_ROWS,
        metadata=None,
        description=json.dumps({"scale": picture.scale, "space": picture.space}),
        software="scan-workbench",
        iccprofile=picture.profile,
    )


def read_linear_tiff(path: Path) -> LinearPicture:
    """Read what `write_linear_tiff` wrote.

    Raises
    ------
    InputError
        When the file is damaged or does not say what its values mean.
    """
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first
            told = json.loads(page.tags["ImageDescription"].value)
            size = path.stat().st_size
            require_pixels_fit(page.nbytes, 8, size)
            if sum(page.databytecounts) > size:
                raise ValueError("its pixels are missing")
            digital = page.asarray()
            scale, space = float(told["scale"]), str(told["space"])
            profile = page.tags["InterColorProfile"].value
        if digital.dtype != np.uint16 or digital.ndim != 3:
            raise ValueError("not 16-bit RGB")
    except Exception as error:  # whatever the TIFF library meets in a damaged file
        raise InputError(
            "The developed photograph cannot be read",
            file=path,
            found=str(error) or type(error).__name__,
            fix="workbench develop --force makes it again",
        ) from error
    return LinearPicture(digital * np.float32(scale / _FULL), space, scale, profile)
