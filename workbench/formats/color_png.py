"""Pictures of 8 bits with transparency, as PNG files that any viewer shows."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.formats.picture_file import opened_picture, require_whole_chunks

# Deflate at its fastest: slower settings save a tenth of the bytes of a photograph.
_SETTINGS = (cv2.IMWRITE_PNG_COMPRESSION, 1)


def read_color_png(path: Path) -> NDArray[np.uint8]:
    """A picture (h, w, 4) uint8, sRGB-encoded with alpha; opaque where the file has none.

    Raises
    ------
    OSError
        When the file is no picture of 8 bits.
    """
    try:
        with opened_picture(path):
            pass  # OpenCV would make room for whatever the header declares.
        data = path.read_bytes()
        require_whole_chunks(data)
        stored = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except (OSError, ValueError, SyntaxError, cv2.error) as error:
        raise OSError(f"no picture of 8 bits: {error}") from error
    if stored is None or stored.dtype != np.uint8:
        raise OSError("no picture of 8 bits")
    turned = {2: cv2.COLOR_GRAY2RGBA}.get(
        stored.ndim, cv2.COLOR_BGRA2RGBA if stored.shape[-1] == 4 else cv2.COLOR_BGR2RGBA
    )
    return np.asarray(cv2.cvtColor(stored, turned), np.uint8)


def write_color_png(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write a picture (h, w, 4) uint8; the same picture gives the same bytes."""
    done, encoded = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGBA2BGRA), _SETTINGS)
    if not done:
        raise OSError("the picture cannot be written as PNG")
    path.write_bytes(encoded.tobytes())
