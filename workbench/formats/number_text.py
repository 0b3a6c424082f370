"""Numbers in text files, with the place of the first thing that is not one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.kernels import text_numbers as kernel

_SPANS_AT_ONCE = 1 << 15


def byte_kinds(separators: bytes = b" \t\f\v", comments: bytes = b"") -> NDArray[np.uint8]:
    """(256,) uint8: what every byte means to `numbers_in_text`."""
    kinds = np.full(256, kernel.TOKEN, np.uint8)
    kinds[list(separators)] = kernel.SEPARATOR
    kinds[list(b"\r\n")] = kernel.NEWLINE
    kinds[list(comments)] = kernel.COMMENT
    return kinds


BLANK_SEPARATED = byte_kinds()


@dataclass(frozen=True)
class NumberText:
    """The numbers of a piece of text.

    Attributes
    ----------
    values : (n,) float64, those before the first problem.
    end : the byte after what was read.
    problem : why there are no more, or None when all that were asked for are there.
    """

    values: NDArray[np.float64]
    end: int
    problem: str | None


def as_bytes_array(data: bytes) -> NDArray[np.uint8]:
    """(n,) uint8 view of a file's bytes."""
    return np.frombuffer(data, np.uint8)


def line_number(text: NDArray[np.uint8], position: int) -> int:
    """Line of a byte, counted from 1; lines end in LF, CR LF or CR."""
    before = text[:position].tobytes()
    return 1 + before.count(b"\n") + before.count(b"\r") - before.count(b"\r\n")


def numbers_in_text(
    text: NDArray[np.uint8],
    position: int,
    count: int,
    *,
    columns: int = 0,
    kinds: NDArray[np.uint8] = BLANK_SEPARATED,
) -> NumberText:
    """Read up to ``count`` numbers from ``text[position:]``, correctly rounded.

    Parameters
    ----------
    text
        (b,) uint8.
    position
        byte to start from; the start of a line when ``columns`` is given.
    count
        how many numbers are wanted; memory is bounded by the length of the text.
    columns
        how many every line that is not blank must hold; 0: lines do not matter.
    kinds
        from `byte_kinds`.
    """
    # A number takes a byte and a separator.
    room = min(count, (len(text) - position + 1) // 2)
    values = np.empty(room, np.float64)
    spans = np.empty((_SPANS_AT_ONCE, 3), np.int64)
    filled = in_line = 0
    while True:
        status, position, in_line, filled, used = kernel.parse_numbers(
            text, kinds, position, columns, in_line, values, filled, spans
        )
        for index, begin, end in spans[:used].tolist():
            token = text[begin:end].tobytes()
            try:
                # Python takes 1_000 for a number; no file format does.
                values[index] = float(token.replace(b"_", b"?"))
            except ValueError:
                shown = token[:40].decode("ascii", "backslashreplace")
                return NumberText(values[:index], begin, f"{shown!r} is not a number")
        if status == kernel.RAGGED:
            whole = filled - min(in_line, columns)
            return NumberText(
                values[:whole],
                position,
                f"a line with {in_line}{'+' if in_line > columns else ''} numbers where "
                f"there should be {columns}",
            )
        if status != kernel.SPANS_FULL:
            problem = None if filled == count else "the text ends"
            return NumberText(values[:filled], position, problem)
