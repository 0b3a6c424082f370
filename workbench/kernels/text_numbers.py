"""Decimal numbers in text, read without leaving the array.

A number of at most 2⁵³ in its digits and with a power of ten up to 22 is exactly one
division or product of two exact doubles, hence correctly rounded (Clinger 1990, *How to
read floating point numbers accurately*, PLDI). Everything else is handed back as a span.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

TOKEN, SEPARATOR, NEWLINE, COMMENT = 0, 1, 2, 3

FULL, END, SPANS_FULL, RAGGED = 0, 1, 2, 3

_POWERS = 10.0 ** np.arange(23)


@njit(cache=True, nogil=True)
def _parse_token(
    text: NDArray[np.uint8], kinds: NDArray[np.uint8], position: int
) -> tuple[float, int, bool]:
    """Value (NaN unless exact), the byte after the token, and whether the value is exact."""
    size = text.size
    negative = text[position] == 45  # -
    if negative or text[position] == 43:  # +
        position += 1
    mantissa = np.int64(0)
    digits, significant, power = 0, 0, 0
    fraction = False
    while position < size:
        byte = text[position]
        if byte == 46 and not fraction:  # .
            fraction = True
        elif 48 <= byte <= 57:
            digits += 1
            power -= int(fraction)
            significant += int(significant > 0 or byte != 48)
            if significant <= 17:
                mantissa = mantissa * 10 + np.int64(byte - 48)
        else:
            break
        position += 1
    plain = bool(digits > 0 and significant <= 17 and mantissa <= 9007199254740992)
    if plain and position < size and (text[position] == 101 or text[position] == 69):  # e E
        position += 1
        below = position < size and text[position] == 45
        if below or (position < size and text[position] == 43):
            position += 1
        exponent, exponent_digits = 0, 0
        while position < size and 48 <= text[position] <= 57:
            exponent = min(exponent * 10 + int(text[position] - 48), 10000)
            exponent_digits += 1
            position += 1
        plain = exponent_digits > 0
        power += -exponent if below else exponent
    while position < size and kinds[text[position]] == TOKEN:
        plain = False
        position += 1
    if not plain or power < -22 or power > 22:
        return np.nan, position, False
    number = float(mantissa)
    number = number * _POWERS[power] if power >= 0 else number / _POWERS[-power]
    return -number if negative else number, position, True


@njit(cache=True, nogil=True)
def parse_numbers(
    text: NDArray[np.uint8],
    kinds: NDArray[np.uint8],
    position: int,
    columns: int,
    in_line: int,
    values: NDArray[np.float64],
    filled: int,
    spans: NDArray[np.int64],
) -> tuple[int, int, int, int, int]:
    """Read numbers from ``text[position:]`` into ``values[filled:]``.

    Parameters
    ----------
    text
        (b,) uint8.
    kinds
        (256,) uint8: ``TOKEN``, ``SEPARATOR``, ``NEWLINE`` or ``COMMENT`` (from the
        start of a token to the end of its line) for every byte value.
    position, in_line, filled
        where an earlier call stopped: the byte, the numbers already
        read in its line, the numbers read so far; 0 at the start.
    columns
        numbers every line that is not blank must hold; 0 takes the text as one stream.
    values
        (n,) float64, written; NaN where a span is to be read by other means.
    spans
        (s, 3) int64, written: index into ``values``, first byte, byte after the last.

    Returns
    -------
    status : ``FULL`` (all values read; with columns the rest of the line was blank),
        ``END`` (the text ended), ``SPANS_FULL`` (resolve them and call again) or ``RAGGED``
        (``position`` is the byte where a line was too short or too long).
    position, in_line, filled, used_spans : where it stopped.
    """
    size = text.size
    used = 0
    while True:
        while position < size and kinds[text[position]] != TOKEN:
            kind = kinds[text[position]]
            if kind == COMMENT:
                while position < size and kinds[text[position]] != NEWLINE:
                    position += 1
                continue
            if kind == NEWLINE:
                if columns > 0 and in_line != 0 and in_line != columns:
                    return RAGGED, position, in_line, filled, used
                in_line = 0
                if columns > 0 and filled == values.size:
                    return FULL, position + 1, 0, filled, used
            position += 1
        if position == size:
            if columns > 0 and in_line != 0 and in_line != columns:
                return RAGGED, position, in_line, filled, used
            status = FULL if filled == values.size else END
            return status, position, in_line, filled, used
        if columns > 0 and in_line == columns:
            return RAGGED, position, in_line + 1, filled, used
        if filled == values.size:
            return FULL, position, in_line, filled, used
        if used == spans.shape[0]:
            return SPANS_FULL, position, in_line, filled, used

        begin = position
        values[filled], position, plain = _parse_token(text, kinds, position)
        if not plain:
            spans[used, 0] = filled
            spans[used, 1] = begin
            spans[used, 2] = position
            used += 1
        filled += 1
        in_line += 1
