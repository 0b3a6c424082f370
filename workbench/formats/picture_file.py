"""Pictures opened with care: what a few bytes declare is believed only as far as they can hold it.

A decoder makes room for all pixels that a header declares before it sees the first of them, so
that a file of a hundred bytes can ask for gigabytes.
"""

from __future__ import annotations

import io
import os
import stat
import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.Image import Image

# Deflate packs 1032 bytes into one at best, LZW some 1400; beyond this no compression goes.
_MOST_BYTES_PER_BYTE, _ALWAYS_BYTES = 2048, 1 << 16
# The fewest bits a pixel of these modes takes in a file; palettes and greys may take one.
_FEWEST_BITS = {"1": 1, "L": 1, "P": 1, "LA": 16, "RGB": 24, "RGBA": 32, "CMYK": 32}

# In damaged files, besides what they document.
_WHAT_PARSERS_MEET = (
    *(TypeError, KeyError, IndexError, AttributeError, ZeroDivisionError, OverflowError),
    *(EOFError, MemoryError, RuntimeError, struct.error, zlib.error),
)


def require_pixels_fit(pixels: int, bits_per_pixel: int, file_bytes: int) -> None:
    """Refuse a picture of more pixels than so many bytes can hold, however well compressed.

    Parameters
    ----------
    pixels : width times height, as declared.
    bits_per_pixel : before compression.
    file_bytes : of the whole file.

    Raises
    ------
    OSError
        They do not fit.
    """
    if pixels * bits_per_pixel > 8 * (_MOST_BYTES_PER_BYTE * file_bytes + _ALWAYS_BYTES):
        raise OSError(f"{file_bytes} bytes cannot hold the {pixels} pixels that they declare")


def require_whole_chunks(data: bytes) -> None:
    """Refuse a PNG file with a chunk that ends behind the file: OpenCV makes room for it.

    Raises
    ------
    OSError
        There is one.
    """
    at = 8
    while data[:4] == b"\x89PNG" and at + 8 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        at += 12 + length
        if at > len(data):
            raise OSError(f"its chunk {kind!r} of {length} bytes ends behind the file")


@contextmanager
def opened_picture(path: Path) -> Iterator[Image]:
    """A JPEG, PNG or TIFF file as Pillow opens it, nothing of it unpacked yet.

    Raises
    ------
    OSError, ValueError, SyntaxError
        The file is no picture, or declares more pixels than it can hold; also from the block.
    """
    from PIL import Image

    with _WithinFile(path) as file, warnings.catch_warnings():
        # The bound below goes by the file; the library's own would warn of good cameras.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            with Image.open(file) as opened:
                width, height = opened.size
                bits = _FEWEST_BITS.get(opened.mode, 16)
                require_pixels_fit(width * height, bits, file.size)
                yield opened
        except (Image.DecompressionBombError, *_WHAT_PARSERS_MEET) as error:
            raise OSError(f"{type(error).__name__}: {error}"[:200]) from error


class _WithinFile(io.BufferedReader):
    """A file of which no more is asked for than there is: a chunk's length makes no room."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)))
        told = os.fstat(self.fileno())
        self.size = told.st_size
        if not stat.S_ISREG(told.st_mode):
            raise OSError("a pipe or a device, not a file")

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > 0:
            size = min(size, max(self.size - self.tell(), 0))
        return super().read(size)
