"""A process of its own in which damaged points may end: `workbench.formats.laz_decompression`.

Each line of its input is an order, one JSON object: to open a file (``path``, ``start``,
``laszip``), to decompress so many ``bytes`` more of it, or, empty, to close it. An answer is
whether that went wrong (one byte), a count (int64, little endian), and so many bytes: what was
asked for, or why not. It knows nothing of the workbench, so that it starts in no time.
"""

import json
import struct
import sys
from typing import Any, BinaryIO

import lazrs

CLOSE: dict[str, Any] = {}
ANSWER = struct.Struct("<?q")


class _Opened:
    def __init__(self, path: str, start: int, laszip: str) -> None:
        self.file: BinaryIO = open(path, "rb")  # noqa: SIM115  # closed by `_done`
        self.file.seek(start)
        self.points = lazrs.LasZipDecompressor(self.file, bytes.fromhex(laszip))


def _done(order: dict[str, Any], opened: list[_Opened]) -> bytes | bytearray:
    if "bytes" in order:
        data = bytearray(order["bytes"])
        opened[0].points.decompress_many(data)
        return data
    while opened:
        opened.pop().file.close()
    if order != CLOSE:
        opened.append(_Opened(**order))
    return b""


def main() -> None:
    """Follow orders until there are none."""
    answers = sys.stdout.buffer
    opened: list[_Opened] = []
    for line in sys.stdin.buffer:
        failed = False
        try:
            data = _done(json.loads(line), opened)
        except BaseException as error:  # panics of the library are no Exceptions
            failed, data = True, f"{type(error).__name__}: {error}".encode()
        answers.write(ANSWER.pack(failed, len(data)))
        answers.write(data)
        answers.flush()


if __name__ == "__main__":
    main()
