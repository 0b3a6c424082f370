"""Points as plain text: XYZ, PTS, TXT, ASC.

There is no standard. What occurs: one point a line, ``x y z``, ``x y z i``, ``x y z r g b``
or ``x y z i r g b``, set apart by blanks, tabs, commas or semicolons; comment lines; a line
of column names; Leica's PTS starts with the number of points.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.number_text import (
    as_bytes_array,
    byte_kinds,
    line_number,
    numbers_in_text,
)
from workbench.formats.scan_reading import ScanReading, eight_bit_color, scan_reading
from workbench.formats.whole_file import whole_file
from workbench.geometry.rangemap import RangeMap

_MOST_HEADER_LINES = 20
_LONGEST_LINE = 4096
_FIX = "Give one point per line: x y z [intensity] [red green blue], numbers with a point."


class _Body(NamedTuple):
    start: int
    width: int
    names: list[str]
    declared: int | None
    separators: bytes


def read_xyz(path: Path) -> RangeMap:
    """Read a text file of points as one scan; see `xyz_reading`.

    Raises
    ------
    InputError
        No line of three or more numbers, lines of different length, a decimal comma.
    """
    return xyz_reading(path).range_map


def xyz_reading(path: Path) -> ScanReading:
    """Read a text file of points as one scan.

    Where the line before the points names as many columns as there are, those names count.
    Else three columns are x y z (scan frame, unit of the file, float64), four add an
    intensity, six a colour, seven both; of other counts only x y z is used. Colours are
    0…255, 0…65535 or 0…1; what is none of these (normals, say) is left out with a note.

    Raises
    ------
    InputError
        No line of three or more numbers, lines of different length, a decimal comma.
    """
    path = Path(path)
    data = whole_file(path)
    text = as_bytes_array(data)
    body = _body(data, path)
    kinds = byte_kinds(body.separators, b"#/%")
    read = numbers_in_text(text, body.start, len(data), columns=body.width, kinds=kinds)
    if read.problem != "the text ends":
        raise InputError(
            "A line of the text file does not fit the others.",
            file=path,
            where=f"line {line_number(text, read.end)}",
            expected=f"{body.width} numbers, as in the first line of points",
            found=read.problem,
            fix=_FIX,
        )
    table = read.values.reshape(-1, body.width)
    if body.declared is not None and body.declared != len(table):
        raise InputError(
            "The text file does not hold as many points as its first line says.",
            file=path,
            expected=f"{body.declared} points",
            found=f"{len(table)} points",
            fix="The file was cut short: copy or export it again.",
        )
    xyz, intensity, rgb, notes = _roles(body, table)
    return scan_reading(
        path,
        path.stem,
        table[:, xyz],
        reflectance=None if intensity is None else table[:, intensity],
        color=None if rgb is None else eight_bit_color(*table[:, rgb].T),
        notes=notes,
    )


def holds_points(path: Path) -> bool:
    """Whether the first lines of a text file look like points; reads some kilobytes at most."""
    try:
        with open(path, "rb") as file:
            start = file.read(_LONGEST_LINE)
        return bool(_body(start, path))
    except (OSError, InputError):
        return False


def _body(data: bytes, path: Path) -> _Body:
    """Where the points start, the numbers per line, and what the lines before said."""
    position, declared = 0, None
    names: list[str] = []
    for _ in range(_MOST_HEADER_LINES):
        line, after = _line_at(data, position)
        is_comment = line.lstrip().startswith(("#", "/", "%"))
        line = line.lstrip("#/% \t") if is_comment else re.split("[#/%]", line)[0]
        words = [word for word in re.split(r"[\s,;\"']+", line) if word]
        if is_comment or (words and not _is_number(words[0])):
            names = [word.lower() for word in words]
        elif not all(_is_number(word) for word in words):
            break
        elif len(words) >= 3:
            return _Body(position, len(words), names, declared, _separators(line, path))
        elif len(words) == 1 and declared is None and re.fullmatch("[0-9]{1,12}", words[0]):
            declared = int(words[0])
        elif words:
            break
        if after >= len(data):
            break
        position = after
    raise InputError(
        "No line of points was found at the start of the text file.",
        file=path,
        where=f"line {line_number(as_bytes_array(data), position)}",
        expected="x y z, three numbers or more",
        fix=_FIX,
    )


def _separators(line: str, path: Path) -> bytes:
    """What sets numbers apart in this file: blanks, and of comma and semicolon what occurs."""
    if re.search(r"\d,\d", line) and re.search(r"[^\s,;][ \t]*[ \t;][ \t]*[^\s,;]", line):
        raise InputError(
            "The text file seems to have a decimal comma.",
            file=path,
            found=line[:80],
            fix="Replace the decimal commas with points; or part all numbers in one way.",
        )
    return b" \t\f\v" + bytes(mark for mark in b",;" if chr(mark) in line)


def _line_at(data: bytes, position: int) -> tuple[str, int]:
    end = re.compile(rb"\r\n|\n|\r").search(data, position, position + _LONGEST_LINE)
    stop, after = (end.start(), end.end()) if end else (position + _LONGEST_LINE, len(data))
    return data[position:stop].decode("ascii", "replace"), after


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return "_" not in word


def _roles(
    body: _Body, table: NDArray[np.float64]
) -> tuple[list[int], int | None, list[int] | None, list[str]]:
    """Columns of x y z, of the intensity, of the colour, and what to tell the user."""
    intensity: int | None = None
    rgb: list[int] | None = None
    xyz = [0, 1, 2]
    if len(body.names) == body.width and {"x", "y", "z"} <= set(body.names):
        xyz = [body.names.index(name) for name in "xyz"]
        for name in ("intensity", "reflectance", "i", "scalar_field"):
            if intensity is None and name in body.names:
                intensity = body.names.index(name)
        for names in (("red", "green", "blue"), ("r", "g", "b")):
            if rgb is None and set(names) <= set(body.names):
                rgb = [body.names.index(name) for name in names]
    elif body.width in (4, 6, 7):
        intensity = None if body.width == 6 else 3
        rgb = None if body.width == 4 else [body.width - 3, body.width - 2, body.width - 1]
    elif body.width > 3:
        note = f"{body.width} columns without known names: only the first three were used"
        return xyz, None, None, [note]
    if rgb is not None and not _is_color(table[:, rgb]):
        return xyz, intensity, None, ["the columns after the coordinates are no colours"]
    return xyz, intensity, rgb, []


def _is_color(values: NDArray[np.float64]) -> bool:
    if not (values >= 0).all() or values.max(initial=0) > 65535:
        return False
    return bool(values.max(initial=0) <= 1 or (values == np.floor(values)).all())
