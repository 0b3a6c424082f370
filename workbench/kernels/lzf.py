"""LZF decompression (Lehmann's liblzf format), as in compressed PCD files."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def decompress_lzf(packed: NDArray[np.uint8], out: NDArray[np.uint8]) -> int:
    """Unpack ``packed`` into ``out``.

    A control byte below 32 says how many literal bytes follow, less one. A larger one holds
    the length in its upper three bits (7: another byte is added) and, with the next byte, the
    distance to copy from.

    Returns
    -------
    Bytes written; −1 when ``packed`` refers outside what was written, ends inside an
    instruction, or does not fit ``out``.
    """
    read, written = 0, 0
    while read < packed.size:
        control = int(packed[read])
        read += 1
        if control < 32:
            length = control + 1
            if length > packed.size - read or length > out.size - written:
                return -1
            for k in range(length):
                out[written + k] = packed[read + k]
            read += length
        else:
            length = control >> 5
            if length == 7:
                if read >= packed.size:
                    return -1
                length += int(packed[read])
                read += 1
            if read >= packed.size:
                return -1
            source = written - ((control & 31) << 8) - int(packed[read]) - 1
            read += 1
            length += 2
            if source < 0 or length > out.size - written:
                return -1
            # Source and target may overlap on purpose: that is how runs are packed.
            for k in range(length):
                out[written + k] = out[source + k]
        written += length
    return written
