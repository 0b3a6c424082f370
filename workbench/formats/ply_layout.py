"""What a PLY file holds: elements, properties, comments, and the header that declares them.

Source: G. Turk, *The PLY Polygon File Format* (Stanford, 1994).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError

ByteOrder = Literal["<", ">"]

LONGEST_HEADER = 1 << 20

SCALAR_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "int64": "i8", "uint64": "u8",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
"""PLY type name → NumPy type without byte order. The 64-bit integers are an extension."""


@dataclass(frozen=True)
class ListColumn:
    """A list property: one list per row.

    Attributes
    ----------
    values : (k,) the values of all rows, one after the other.
    lengths : (rows,) int64, how many belong to each row.
    """

    values: NDArray[np.generic]
    lengths: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.lengths)

    @property
    def offsets(self) -> NDArray[np.int64]:
        """(rows + 1,) int64: row ``i`` is ``values[offsets[i]:offsets[i + 1]]``."""
        return np.concatenate([[0], np.cumsum(self.lengths)]).astype(np.int64)


Column = NDArray[np.generic] | ListColumn


@dataclass(frozen=True)
class PlyElement:
    """One element: ``count`` rows, its properties as columns in the order of the file."""

    name: str
    count: int
    columns: Mapping[str, Column]

    def scalar(self, name: str) -> NDArray[np.generic] | None:
        """The column (count,) of a single-valued property, or None."""
        column = self.columns.get(name)
        return None if isinstance(column, ListColumn) else column


@dataclass(frozen=True)
class PlyFile:
    """The whole file, in the order of the file."""

    elements: Mapping[str, PlyElement]
    comments: tuple[str, ...] = ()
    obj_info: tuple[str, ...] = ()

    def info(self, key: str) -> list[str] | None:
        """The words after ``key`` in the first ``obj_info`` line that starts with it, or None."""
        for line in self.obj_info:
            words = line.split()
            if words and words[0] == key:
                return words[1:]
        return None


@dataclass(frozen=True)
class PropertyLayout:
    """A declared property; ``count_type`` is None for a single value."""

    name: str
    value_type: np.dtype[np.generic]
    count_type: np.dtype[np.generic] | None


@dataclass(frozen=True)
class ElementLayout:
    """A declared element."""

    name: str
    count: int
    properties: tuple[PropertyLayout, ...]


@dataclass(frozen=True)
class PlyHeader:
    """What the header declares; ``byte_order`` is ``<``, ``>`` or None for text."""

    byte_order: ByteOrder | None
    elements: tuple[ElementLayout, ...]
    comments: tuple[str, ...]
    obj_info: tuple[str, ...]
    body_start: int


@dataclass
class _Draft:
    byte_order: ByteOrder | None = None
    format_seen: bool = False
    elements: list[tuple[str, int, list[PropertyLayout]]] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)
    obj_info: list[str] = field(default_factory=list)


def parse_header(data: bytes, path: Path) -> PlyHeader:
    """Read the header of a PLY file.

    Raises
    ------
    InputError
        No PLY, no ``end_header``, or a line that is not of the format.
    """
    if re.match(rb"ply[ \t]*[\r\n]", data[:64]) is None:
        raise InputError(
            "This is not a PLY file.",
            file=path,
            where="byte 0",
            expected="'ply' on the first line",
            found=repr(data[:8]),
            fix="Check the file; perhaps its extension is wrong.",
        )
    end = re.search(rb"[\r\n]end_header[ \t]*", data[:LONGEST_HEADER])
    if end is None:
        raise InputError(
            "The PLY header does not end.",
            file=path,
            where=f"byte {min(len(data), LONGEST_HEADER)}",
            expected="end_header",
            fix="The file was cut short: copy or export it again.",
        )
    body = end.end()
    lines = re.split(r"\r\n|\n|\r", data[: end.start()].decode("utf-8", "replace"))
    # A lone CR is a line end only where the header uses it: the first byte of a binary body
    # may well be 0x0A.
    carriage_return_only = b"\n" not in data[: end.start()]
    if data[body : body + 1] == b"\r":
        body += 1
        if not carriage_return_only and data[body : body + 1] == b"\n":
            body += 1
    elif data[body : body + 1] == b"\n":
        body += 1
    draft = _Draft()
    for number, line in enumerate(lines[1:], start=2):
        _take_line(draft, line, path, f"header line {number}")
    if not draft.format_seen:
        raise InputError(
            "The PLY header names no format.",
            file=path,
            expected="format ascii, binary_little_endian or binary_big_endian",
            fix="Export the file again.",
        )
    return PlyHeader(
        draft.byte_order,
        tuple(ElementLayout(name, count, tuple(props)) for name, count, props in draft.elements),
        tuple(draft.comments),
        tuple(draft.obj_info),
        body,
    )


def _take_line(draft: _Draft, line: str, path: Path, where: str) -> None:
    words = line.split()
    match words:
        case []:
            pass
        case ["comment", *_]:
            draft.comments.append(line.strip()[len("comment") :].strip())
        case ["obj_info", *_]:
            draft.obj_info.append(line.strip()[len("obj_info") :].strip())
        case ["format", name, *_]:
            orders: dict[str, ByteOrder | None] = {
                "ascii": None,
                "binary_little_endian": "<",
                "binary_big_endian": ">",
            }
            if name not in orders:
                raise _header_error("Unknown PLY format.", path, where, ", ".join(orders), name)
            draft.byte_order, draft.format_seen = orders[name], True
        case ["element", name, count]:
            if re.fullmatch(r"[0-9]{1,18}", count) is None:
                raise _header_error(
                    f"The number of rows of element '{name}' cannot be used.",
                    path, where, "a number from 0 to 10^18", count[:40],
                )  # fmt: skip
            if any(name == known for known, _, _ in draft.elements):
                raise _header_error(
                    f"Element '{name}' is declared twice.", path, where, "unique names", name
                )
            draft.elements.append((name, int(count), []))
        case ["property", "list", count_name, value_name, name]:
            count_type = _scalar_type(count_name, path, where)
            if count_type.kind == "f" or count_type.itemsize > 4:
                raise _header_error(
                    f"The list '{name}' is counted with a type that cannot be used.",
                    path, where, "an integer type of at most 32 bits", count_name,
                )  # fmt: skip
            _add_property(
                draft, name, _scalar_type(value_name, path, where), count_type, path, where
            )
        case ["property", value_name, name]:
            _add_property(draft, name, _scalar_type(value_name, path, where), None, path, where)
        case _:
            raise _header_error(
                "A line of the PLY header is not understood.",
                path, where, "format, element, property, comment or obj_info", line[:80],
            )  # fmt: skip


def _add_property(
    draft: _Draft,
    name: str,
    value_type: np.dtype[np.generic],
    count_type: np.dtype[np.generic] | None,
    path: Path,
    where: str,
) -> None:
    if not draft.elements:
        raise _header_error(
            f"Property '{name}' belongs to no element.", path, where, "an element line first", name
        )
    element, _, properties = draft.elements[-1]
    if any(name == known.name for known in properties):
        raise _header_error(
            f"Property '{name}' of element '{element}' is declared twice.",
            path, where, "unique names", name,
        )  # fmt: skip
    properties.append(PropertyLayout(name, value_type, count_type))


def _scalar_type(name: str, path: Path, where: str) -> np.dtype[np.generic]:
    if name not in SCALAR_TYPES:
        raise _header_error("Unknown PLY type.", path, where, ", ".join(SCALAR_TYPES), name)
    return np.dtype(SCALAR_TYPES[name])


def _header_error(message: str, path: Path, where: str, expected: str, found: str) -> InputError:
    return InputError(
        message,
        file=path,
        where=where,
        expected=expected,
        found=found,
        fix="Export the file again, or correct the header.",
    )
