"""What files of a header, parts and an index behind them have in common: checks of their ends.

The header begins with the magic and the version and ends with the CRC-32 of the index, as it is
stored, and of the header before it. The index is the last part of the file; the header says where
it begins.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.whole_file import require_regular


@dataclass(frozen=True)
class IndexedFormat:
    """One kind of such files.

    Attributes
    ----------
    header : with ``magic`` S8 and ``version`` first, ``index_offset`` somewhere, and ``index_crc``
        and ``header_crc`` last; little-endian.
    magic, version : of the files.
    kind : what a file is called where it is refused, as in "a surfel file of the workbench".
    without : what is said of a file with another beginning.
    broken_index : what is said of an index with another checksum.
    """

    header: np.dtype[np.void]
    magic: bytes
    version: int
    kind: str
    without: str
    broken_index: str = "The index of the file is damaged."

    def sealed(self, fields: dict[str, Any], index: bytes) -> bytes:
        """The header with its own fields filled in and checksums of itself and an index."""
        header = np.zeros((), self.header)
        for name, value in fields.items():
            header[name] = value
        header["magic"], header["version"] = self.magic, self.version
        header["index_crc"] = zlib.crc32(index)
        header["header_crc"] = zlib.crc32(header.tobytes()[:-4])
        return header.tobytes()

    def opened(
        self,
        path: Path,
        check_header: Callable[[Path, Any], None],
        check_end: Callable[[Path, Any, int], None],
    ) -> tuple[Any, bytes]:
        """The checked header and the bytes of the index.

        Parameters
        ----------
        path
            The file.
        check_header
            Refuses a header of this version that makes no sense.
        check_end
            Refuses a header that does not fit a file of so many bytes, before the index is read.

        Raises
        ------
        InputError
            Not such a file, of another version, shorter than it says, or damaged.
        """
        require_regular(path)
        try:
            with open(path, "rb") as file:
                start = file.read(self.header.itemsize)
                if len(start) < self.header.itemsize or start[: len(self.magic)] != self.magic:
                    raise self.refused(path, self.without, "another header")
                header = np.frombuffer(start, self.header)[0]
                self._check_start(path, start, header)
                check_header(path, header)
                check_end(path, header, file.seek(0, 2))
                file.seek(int(header["index_offset"]))
                index = file.read()
        except OSError as error:
            raise self.refused(path, "The file cannot be read.", str(error)) from error
        if zlib.crc32(index) != int(header["index_crc"]):
            raise self.refused(path, self.broken_index, "a wrong checksum")
        return header, index

    def refused(self, path: Path, message: str, found: str) -> InputError:
        """The error of a file that cannot be used."""
        return InputError(
            message,
            file=path,
            expected=self.kind,
            found=found,
            fix="Copy the file again, or export it anew.",
        )

    def check_nodes_end(self, path: Path, header: Any, end: int, record_bytes: int) -> None:
        """Refuse a file whose end is not that of an index of ``header["nodes"]`` plain records."""
        index_end = int(header["index_offset"]) + int(header["nodes"]) * record_bytes
        if index_end != end:
            raise self.refused(path, "The file is cut short.", f"{end} bytes of {index_end}")

    def check_children(
        self, path: Path, first: NDArray[np.integer], counts: NDArray[np.integer]
    ) -> None:
        """Refuse an index in which a node's children do not follow it inside the index.

        Parameters
        ----------
        path
            The file.
        first, counts
            (n,) rows of the first child of each node, and how many it has.
        """
        parents = np.flatnonzero(counts)
        last = first[parents].astype(np.int64) + counts[parents]
        if (first[parents] <= parents).any() or (last > len(first)).any():
            raise self.refused(path, "The index names children that are not there.", "a wrong link")

    def _check_start(self, path: Path, start: bytes, header: Any) -> None:
        if zlib.crc32(start[:-4]) != int(header["header_crc"]):
            raise self.refused(path, "The header of the file is damaged.", "a wrong checksum")
        if int(header["version"]) != self.version:
            raise InputError(
                "The file is of another version.",
                file=path,
                expected=str(self.version),
                found=str(int(header["version"])),
                fix="Export it again with this program, or read it with the one that wrote it.",
            )
